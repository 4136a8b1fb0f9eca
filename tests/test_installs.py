"""What each install does: extras that are missing are missed only by what needs them."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

EXTRAS = {
    "gym": ("gymnasium",),
    "train": ("torch", "safetensors", "duckdb"),
    "view": ("rerun", "rerun_cli", "matplotlib", "PIL"),
    "tensorboard": ("tensorboard",),
    "exchange": ("rosbags", "h5py", "av"),
    "cloud": ("obstore",),
    "cluster": ("ray",),
}
"""The libraries that an extra brings, by its name."""

SESSION = """
import contextlib, io, json, sys


class Missing:  # finds nothing of what an extra would have brought
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {names!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)


sys.meta_path.insert(0, Missing())
from coordlog.cli import main
for words in {commands!r}:
    sys.argv, said = ["coordlog", *words], io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            main()
    except SystemExit as ended:
        print(json.dumps([ended.code, said.getvalue()]))
"""


def session(*commands: str, without: tuple[str, ...], cwd: Path) -> dict[str, tuple[int, str]]:
    """Exit codes and all that was said by commands, one after the other in a process in which the
    libraries of some extras cannot be imported.
    """
    names = [library for extra in without for library in EXTRAS[extra]]
    code = SESSION.format(names=names, commands=[words.split() for words in commands])
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=cwd, check=False
    )
    assert done.returncode == 0, done.stderr
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    return dict(zip(commands, answers, strict=True))


RECORD = "record --scene planar --episodes 2 --out logs"
NEEDED = {
    "train --from logs --updates 1": "train",
    "view logs --save x.rrd": "view",
    "plot logs": "view",
}
"""Commands that need an extra, and which one."""
PLAIN = ("check logs --jobs 1", "info logs", "smooth logs --out smoothed --jobs 1")


Plain = tuple[Path, dict[str, tuple[int, str]]]


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Plain:
    """What each command ends with where no extra is installed, and the folder they worked in."""
    folder = tmp_path_factory.mktemp("plain")
    return folder, session(RECORD, *PLAIN, *NEEDED, without=tuple(EXTRAS), cwd=folder)


@pytest.mark.parametrize("command", [RECORD, *PLAIN])
def test_the_plain_install_records_checks_and_smooths(plain: Plain, command: str) -> None:
    code, said = plain[1][command]
    assert code == 0, said


@pytest.mark.parametrize("command", NEEDED)
def test_what_needs_an_extra_says_which_one(plain: Plain, command: str) -> None:
    code, said = plain[1][command]
    assert code == 2
    assert "Traceback" not in said
    assert f"coordlog[{NEEDED[command]}]" in said


def test_learning_needs_no_viewer(plain: Plain) -> None:
    others = tuple(extra for extra in EXTRAS if extra != "train")
    command = "train --from logs --updates 2 --eval-every 0 --jobs 1 --out run"
    ((code, said),) = session(command, without=others, cwd=plain[0]).values()
    assert code == 0, said
