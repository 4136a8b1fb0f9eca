"""Tests for what commands say: names as they are, in any terminal, to whoever still listens."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import warnings
from io import BytesIO, TextIOWrapper
from pathlib import Path

import pytest

from coordlog.cli import app
from coordlog.commands import terminal
from tests.spoken import sound

GOOD = next((Path(__file__).parents[1] / "data" / "v1" / "planar").glob("*.mcap"))
ODD = [
    "[old] one.mcap",
    "[bold red]a.mcap",
    "a\x1b[31mb\x07.mcap",
    "e\u202ee.mcap",
    ":x:.mcap",
]


def test_names_are_printed_as_they_are_and_never_obeyed(tmp_path: Path) -> None:
    for name in ODD:
        shutil.copy(GOOD, tmp_path / name)
        (tmp_path / f"text {name}").write_text("a text")
    done = sound("info", tmp_path, code=3)
    for text in (done.stdout, done.stderr):
        for shown in ("[old] one.mcap", "[bold red]a.mcap", r"a\x1b[31mb\x07.mcap"):
            assert shown in text
        assert r"e\u202ee.mcap" in text
        assert "\x1b" not in text
    done = sound("check", "--level", "file", "--jobs", "1", tmp_path, code=3)
    assert r"text a\x1b[31mb\x07.mcap" in done.stderr
    assert {
        Path(row["path"]).name
        for row in json.loads(sound("info", GOOD, "--json").stdout)["episodes"]
    } == {GOOD.name}


def test_every_way_of_saying_something_shows_markup_and_controls(
    capsys: pytest.CaptureFixture[str],
) -> None:
    odd = "[red]x[/red] [/y] \x1b]0;title\x07 \ud800 \u202e\r\n"
    terminal.say(odd)
    terminal.table(["name", odd], [[odd, 1]], title=odd)
    terminal.facts([(odd, odd)], title=odd)
    terminal.note(odd)
    terminal.complain(odd)
    said = capsys.readouterr()
    for text in (said.out, said.err):
        assert r"[red]x[/red] [/y] \x1b]0;title\x07 \ud800 \u202e\r\n" in text
        assert "\x1b" not in text


@pytest.mark.parametrize("encoding", ["ascii", "cp1252"])
def test_what_an_encoding_lacks_is_written_plainly(
    encoding: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = Path(shutil.copy(GOOD, tmp_path / "ε 機 µ.mcap"))
    for words in (("info", path), ("info", path, "--json")):
        heard = BytesIO()
        monkeypatch.setattr(sys, "stdout", TextIOWrapper(heard, encoding=encoding))
        terminal.prepare_streams()
        app([str(word) for word in words], standalone_mode=False)
        sys.stdout.flush()
    assert json.loads(heard.getvalue().decode(encoding))["episodes"][0]["path"] == str(path)


def test_a_terminal_of_ascii_is_met_by_a_process_as_well(tmp_path: Path) -> None:
    path = Path(shutil.copy(GOOD, tmp_path / "ε 機 µ.mcap"))
    done = subprocess.run(
        [sys.executable, "-m", "coordlog.cli", "info", path, path.parent],
        capture_output=True,
        timeout=120,
        check=False,
        env={**os.environ, "PYTHONIOENCODING": "ascii", "LC_ALL": "C"},
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.decode("ascii")


def test_the_error_handler_writes_our_letters_in_ascii() -> None:
    terminal.prepare_streams()
    assert "-ln(e₁ + e₂) 3 µs ×ε".encode("ascii", "coordlog.plain") == b"-ln(e1 + e2) 3 us x\\u03b5"


@pytest.mark.parametrize("closed", [">&-", "> /dev/full", "2>&1 | true"])
def test_whoever_stops_listening_gets_no_traceback(closed: str, tmp_path: Path) -> None:
    command = f"{sys.executable} -m coordlog.cli info {GOOD} {GOOD.parent}"
    done = subprocess.run(
        ["bash", "-c", f"set -o pipefail; {command} {closed}"],
        capture_output=True,
        timeout=120,
        check=False,
    )
    assert b"Traceback" not in done.stderr
    assert done.returncode == (2 if "full" in closed else 0), done.stderr


def test_twenty_columns_are_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(terminal.out, "_width", 20)
    done = sound("info", GOOD)
    assert max(map(len, done.stdout.splitlines()[:3])) <= 20


def test_json_has_no_numbers_that_json_lacks(capsys: pytest.CaptureFixture[str]) -> None:
    terminal.print_json({"a": float("nan"), "b": [float("inf"), 1.5], "c": (Path("x").name,)})
    assert json.loads(capsys.readouterr().out, parse_constant=pytest.fail) == {
        "a": None,
        "b": [None, 1.5],
        "c": ["x"],
    }


def test_what_a_library_warns_of_is_said_once_and_without_its_code(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    noted: list[object] = []
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    monkeypatch.setattr(terminal, "note", noted.append)
    terminal.hear_warnings()
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        for _ in range(2):
            warnings.warn("two\n  lines", UserWarning, stacklevel=1)
    assert noted == ["two lines"]
    assert capsys.readouterr().err == ""
