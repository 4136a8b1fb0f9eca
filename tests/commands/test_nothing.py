"""Tests that a command that looked at nothing says so, and that one bad file stops none."""

from __future__ import annotations

import os
import resource
import shutil
from pathlib import Path

import pytest

from tests.spoken import said, sound

GOOD = next((Path(__file__).parents[1] / "data" / "v1" / "planar").glob("*.mcap"))
NEW = next((Path(__file__).parents[1] / "data" / "v2" / "planar").glob("*.mcap"))
COMMANDS = {
    "check": ("--jobs", "1"),
    "info": (),
    "smooth": ("--jobs", "1", "--out", "OUT"),
    "migrate": ("--jobs", "1", "--out", "OUT"),
    "export": ("--jobs", "1", "--skip-broken", "--to", "csv", "--out", "OUT"),
    "train": (
        "--updates",
        "1",
        "--eval-every",
        "0",
        "--skip-broken",
        "--from",
        "IN",
        "--out",
        "OUT",
    ),
    "view": ("--no-open",),
    "select": ("--out", "OUT.manifest"),
    "pack": ("--out", "OUT.pack"),
    "index": (),
}


def words(name: str, folder: Path, out: Path) -> list[object]:
    rest = [word.replace("OUT", str(out)).replace("IN", str(folder)) for word in COMMANDS[name]]
    return [name, *rest] if "IN" in COMMANDS[name] else [name, folder, *rest]


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("what", ["empty", "part", "foreign", "bag", "dangling"])
def test_a_folder_without_episodes_is_no_proof(name: str, what: str, tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    folder.mkdir()
    if what == "part":
        (folder / "a.mcap.part").write_bytes(GOOD.read_bytes()[:9000])
    if what == "foreign":
        (folder / "a.mcap").write_bytes(b"#ROSBAG V2.0\n")
    if what == "bag":
        (folder / "a.db3").write_bytes(b"SQLite format 3\0")
    if what == "dangling":
        (folder / "a.mcap").symlink_to("/nowhere/a.mcap")
    done = said(*words(name, folder, tmp_path / "out"))
    assert (done.exit_code, done.unforeseen) == (2, None)
    if what == "foreign":
        assert "a ROS 1 bag" in done.stderr
        return
    assert "sound" not in done.stdout
    assert f"no episodes (.mcap) under {folder}" in done.stderr


@pytest.mark.parametrize("name", sorted({*COMMANDS} - {"index", "pack"}))
def test_a_foreign_file_that_is_named_ends_every_command_alike(name: str, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"PAR1" + bytes(50))
    done = said(*words(name, path, tmp_path / "out"))
    assert (done.exit_code, done.unforeseen) == (2, None)
    assert "a Parquet file" in done.stderr


@pytest.mark.parametrize("kind", ["dangling", "pipe", "junk"])
def test_one_bad_file_is_named_and_stops_no_command(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    logs = tmp_path / "logs"
    logs.mkdir()
    shutil.copy(GOOD, logs)
    bad = logs / "zz.mcap"
    if kind == "dangling":
        bad.symlink_to("/nowhere/gone.mcap")
    elif kind == "pipe":
        os.mkfifo(bad)
    else:
        bad.write_bytes(b"junk")
    for args in (
        ("info", logs),
        ("check", "--level", "file", "--jobs", "1", logs),
        ("info", logs / GOOD.name, bad),
        ("check", "--level", "file", "--jobs", "1", bad, logs / GOOD.name),
    ):
        done = sound(*args, code=3)
        assert f"skipped: {bad}: " in done.stderr
    sound("view", logs / GOOD.name, "--no-open")
    train = ("train", "--from", logs, "--updates", "1", "--eval-every", "0", "--jobs", "1", "--out")
    done = said(*train, tmp_path / "run1")
    assert (done.exit_code, done.unforeseen) == (2, None)
    assert "--skip-broken learns from the others" in done.stderr
    done = sound(*train, tmp_path / "run2", "--skip-broken", code=3)
    assert f"skipped: {bad}: " in done.stderr


def test_named_twice_is_checked_once(tmp_path: Path) -> None:
    (tmp_path / "link.mcap").symlink_to(GOOD)
    done = sound("check", "--level", "file", "--jobs", "1", GOOD, GOOD, tmp_path)
    assert done.stdout.startswith("1 episodes, ")


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_a_name_that_is_no_text_is_said_to_be_none(name: str, tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    folder.mkdir()
    shutil.copy(NEW, folder / os.fsdecode(b"\xff\xfe.mcap"))
    done = said(*words(name, folder, tmp_path / "out"))
    assert (done.exit_code, done.unforeseen) == (2, None)
    assert "its name is not UTF-8" in done.stderr


def harmed(how: str) -> bytes:
    """An episode of which a few bytes are not as they were written."""
    data = bytearray(NEW.read_bytes())
    if how == "magic":
        data[2] ^= 4
    elif how == "library":
        data[data.index(b"coordlog/")] ^= 1
    elif how == "version":
        data[data.index(b"schema_version") + len("schema_version") + 4] ^= 1
    elif how == "key":
        data[data.index(b"control_period")] ^= 1
    elif how == "start":
        data[:64] = bytes(64)
    else:
        data[-8:] = bytes(8)
    return bytes(data)


@pytest.mark.parametrize("how", ["magic", "library", "version", "key", "start", "end"])
def test_an_episode_with_a_damaged_start_or_end_is_a_finding_and_no_stranger(
    how: str, tmp_path: Path
) -> None:
    shutil.copy(NEW, tmp_path)
    (tmp_path / "harmed.mcap").write_bytes(harmed(how))
    done = sound("check", "--level", "file", "--jobs", "1", tmp_path, code=1)
    assert f"{tmp_path / 'harmed.mcap'}: " in done.stdout
    assert "skipped" not in done.stderr


@pytest.mark.parametrize(
    "words",
    [
        ("robot",),
        ("robot", "--explain"),
        ("scenes",),
        ("record", "--scene"),
        ("record", "--config"),
        ("record", "--policy"),
        ("train", "--config"),
        ("train", "--scene"),
    ],
)
@pytest.mark.parametrize("name", ["a.mcap", "a.toml", "a.xml", "a.py:x"])
def test_a_file_of_another_kind_is_named_for_what_it_is(
    words: tuple[str, ...], name: str, tmp_path: Path
) -> None:
    shutil.copy(NEW, tmp_path / name.partition(":")[0])
    if ":" in name and words[-1] in ("--config", "--policy"):
        pytest.skip("no name in a file is a configuration; a policy of one's own is run")
    out = () if words[0] in ("robot", "scenes") else ("--out", tmp_path / "out")
    done = said(*words, tmp_path / name, *out)
    assert (done.exit_code, done.unforeseen) == (2, None)
    assert "a recorded episode (MCAP)" in done.stderr
    assert "\n" not in done.stderr.strip()


@pytest.mark.parametrize("name", ["plot", "migrate"])
def test_a_full_disk_leaves_nothing_under_a_name_and_the_same_command_goes_on(
    name: str, tmp_path: Path
) -> None:
    words = {
        "plot": ("plot", NEW, "--out", tmp_path / "out" / "a.png"),
        "migrate": ("migrate", GOOD, "--jobs", "1", "--out", tmp_path / "out"),
    }[name]
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (8192, limits[1]))
    try:
        done = said(*words)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert (done.exit_code, done.unforeseen) == (2, None)
    assert "File too large" in done.stderr
    assert not list((tmp_path / "out").iterdir())
    if name == "migrate":  # as a kill would leave it
        (tmp_path / "out" / f"{GOOD.name}.part").write_bytes(b"")
    sound(*words)
    assert len(list((tmp_path / "out").glob("*.[mp]*"))) == 1
