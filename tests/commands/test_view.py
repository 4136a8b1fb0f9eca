"""Tests for `coordlog view`, as a person runs it.

Pictures need software Vulkan, recordings do not.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.spoken import Said, sound

DATA = Path(__file__).parents[1] / "data" / "v1"
TABLE = sorted((DATA / "table").glob("*.mcap"))


def view(*args: str | Path, wanted: int = 0) -> Said:
    return sound("view", *args, code=wanted)


def test_an_episode_two_episodes_and_a_folder_become_recordings(tmp_path: Path) -> None:
    for name, args in (("one", [TABLE[0]]), ("two", [*TABLE[:2], "--ghosts"]), ("folder", [DATA])):
        done = view(*args, "--save", tmp_path / f"{name}.rrd")
        assert (tmp_path / f"{name}.rrd").stat().st_size > 50_000
        assert "rerun" in done.stdout


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "taken.rrd").write_text("mine")
    assert "not overwritten" in view(TABLE[0], "--save", tmp_path / "taken.rrd", wanted=2).stderr
    assert (tmp_path / "taken.rrd").read_text() == "mine"


def test_an_unfinished_episode_is_shown_as_far_as_it_goes(tmp_path: Path) -> None:
    whole = TABLE[0].read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) * 3 // 4])
    assert "as far as it goes" in view(tmp_path / "cut.mcap", "--no-open", wanted=3).stderr


def test_what_is_no_episode_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty.mcap").write_bytes(b"")
    assert "empty" in view(tmp_path / "empty.mcap", "--no-open", wanted=2).stderr
    assert "No such file" in view(tmp_path / "none.mcap", "--no-open", wanted=2).stderr


def test_a_sibling_is_found_by_lineage_either_way(tmp_path: Path) -> None:
    from dataclasses import replace

    from coordlog.record.addresses import sha256
    from coordlog.record.reader import read_attachments, read_episode
    from coordlog.record.siblings import sibling
    from coordlog.record.writer import write_episode

    raw, smoothed = tmp_path / "logs" / "a.mcap", tmp_path / "smoothed" / "a.mcap"
    for folder in (raw.parent, smoothed.parent):
        folder.mkdir()
    shutil.copy(TABLE[0], raw)
    episode = read_episode(raw)
    lineage = {"parents": [sha256(raw)], "transform": "smooth", "parameters": {}}
    made = replace(episode, header=replace(episode.header, lineage=lineage))
    write_episode(smoothed, made, attachments=read_attachments(raw), display=False)
    assert sibling(raw) == (raw, smoothed)
    assert sibling(smoothed) == (raw, smoothed)
    assert sibling(TABLE[1]) is None
    assert "with its sibling" in view(raw, "--no-open").stderr


@pytest.mark.skipif(
    not list(Path("/usr/share/vulkan/icd.d").glob("*.json")),
    reason="no Vulkan driver: install mesa-vulkan-drivers",
)
def test_a_picture_needs_no_display(tmp_path: Path) -> None:
    view(TABLE[0], "--screenshot", tmp_path / "table.png", "--at", "1.5")
    assert (tmp_path / "table.png").stat().st_size > 50_000
