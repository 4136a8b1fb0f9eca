"""Tests for `coordlog recover`: all are tried, each is told of, nothing is left behind."""

from __future__ import annotations

import json
import os
import resource
from pathlib import Path

import pytest

from coordlog.errors import StorageError
from coordlog.record.reader import read_episode
from coordlog.verify.repair import recover
from tests.spoken import said, sound

GOOD = next((Path(__file__).parents[1] / "data" / "v1" / "planar").glob("*.mcap"))
WHOLE = GOOD.read_bytes()


@pytest.fixture
def parts(tmp_path: Path) -> Path:
    """A folder of parts: a sealed one, one that is cut, one without a step, an empty one, a text."""
    folder = tmp_path / "logs"
    folder.mkdir()
    for name, content in {
        "a": WHOLE,
        "b": WHOLE[:-300],
        "c": WHOLE[:5000],
        "d": b"",
        "e": b"a text\n",
    }.items():
        (folder / f"{name}.mcap.part").write_bytes(content)
    return folder


def test_all_are_tried_and_each_is_told_of(parts: Path) -> None:
    done = said("recover", *sorted(parts.iterdir()), parts / "nowhere.mcap.part")
    assert (done.exit_code, done.unforeseen) == (3, None)
    lines = done.stdout.splitlines()
    assert len(lines) == 6
    assert "a.mcap: " in lines[0]
    assert "b.mcap: " in lines[1]
    assert "nothing in it" in lines[2]
    assert "nothing in it" in lines[3]
    assert "not recovered: not an MCAP file" in lines[4]
    assert "No such file" in lines[5]
    assert len(read_episode(parts / "a.mcap")) == len(read_episode(GOOD))


def test_a_folder_is_taken_and_what_is_done_is_not_unfinished(parts: Path) -> None:
    sound("recover", parts, code=3)
    done = sound("info", parts, code=0)
    assert "unfinished: " in done.stderr  # c, d and e
    assert "a.mcap.part" not in done.stderr
    again = sound("recover", parts / "a.mcap.part", parts / "b.mcap.part")
    assert again.stdout.count("recovered before, as") == 2
    sound("recover", parts, "--discard-empty", code=3)  # the text is nobody's to delete
    assert sorted(path.name for path in parts.glob("*.part")) == [
        "a.mcap.part",
        "b.mcap.part",
        "e.mcap.part",
    ]


def test_json_says_the_same(parts: Path) -> None:
    rows = json.loads(said("recover", parts, "--json").stdout)
    assert [row["status"] for row in rows] == [
        "recovered",
        "recovered",
        "nothing",
        "nothing",
        "failed",
    ]


@pytest.mark.parametrize("left", [".recovering.part", ".recovering"])
def test_what_a_killed_recover_left_blocks_no_later_one(parts: Path, left: str) -> None:
    (parts / f"b.mcap{left}").write_bytes(WHOLE[:2000])
    sound("recover", parts / "b.mcap.part")
    assert (parts / "b.mcap").exists()
    assert not list(parts.glob("*recovering*"))


def test_a_full_disk_leaves_nothing_behind(parts: Path) -> None:
    before = sorted(parts.iterdir())
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, limits[1]))
    try:
        with pytest.raises(StorageError, match=r"cannot write the recovered.*is as it was"):
            recover(parts / "b.mcap.part")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert sorted(parts.iterdir()) == before
    sound("recover", parts / "b.mcap.part")


def test_a_cut_episode_in_a_folder_is_recovered_beside_itself(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(WHOLE[:-300])
    sound("recover", tmp_path)
    assert (tmp_path / "a.recovered.mcap").exists()
    assert os.path.getsize(tmp_path / "a.mcap") == len(WHOLE) - 300
    assert sound("recover", GOOD.parent).stdout == "nothing is unfinished\n"
