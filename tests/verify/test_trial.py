"""Tests for trial.py: a model that hurts is named, and the check goes on."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import zstandard

from coordlog.episode import MODEL_XML
from coordlog.record.reader import read_attachments, read_episode
from coordlog.record.writer import write_episode
from coordlog.verify import trial
from coordlog.verify.levels import check_files

GOOD = next((Path(__file__).parents[1] / "data" / "v1" / "planar").glob("*.mcap"))


def with_model(folder: Path, name: str, add: str) -> Path:
    """The good episode with more in its world."""
    attached = read_attachments(GOOD)
    text = zstandard.ZstdDecompressor().decompressobj().decompress(attached[MODEL_XML]).decode()
    text = text.replace("</worldbody>", f"{add}</worldbody>", 1)
    path = folder / name
    write_episode(
        path,
        read_episode(GOOD),
        attachments={**attached, MODEL_XML: zstandard.compress(text.encode())},
        display=False,
    )
    return path


def test_a_bomb_is_named_and_the_others_are_checked(tmp_path: Path) -> None:
    shutil.copy(GOOD, tmp_path / "good.mcap")
    bomb = with_model(
        tmp_path, "bomb.mcap", '<replicate count="2000000"><geom size="1"/></replicate>'
    )
    checked = check_files(sorted(tmp_path.glob("*.mcap")), level="replay")
    assert [(item.path, item.field) for item in checked.findings] == [(str(bomb), "model")]
    assert "20,000" in checked.findings[0].got
    assert checked.steps == len(read_episode(GOOD))


def test_a_model_that_is_not_plain_is_tried_in_a_process_of_its_own(tmp_path: Path) -> None:
    fine = with_model(
        tmp_path,
        "fine.mcap",
        '<replicate count="3" offset="0 0 9"><geom size=".1" contype="0" conaffinity="0"/>'
        "</replicate>",
    )
    assert trial.runnable([fine]) == []


def test_one_that_takes_too_long_or_crashes_is_a_finding(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = with_model(tmp_path, "a.mcap", '<replicate count="3"><geom size="1"/></replicate>')
    monkeypatch.setattr(trial, "_tried_before", {})
    monkeypatch.setattr(trial, "_in_a_child", lambda _: (1e-5, 1.0))
    assert "to replay" in trial.runnable([path])[0].got
    monkeypatch.setattr(trial, "_tried_before", {})
    monkeypatch.setattr(trial, "_in_a_child", lambda _: "one that crashes MuJoCo (signal 11)")
    assert "crashes" in trial.runnable([path])[0].got


def test_the_child_keeps_to_its_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    text = (
        '<mujoco><worldbody><body><freejoint/><geom size=".1"/>'
        '<replicate count="100"><site size=".1"/></replicate></body></worldbody></mujoco>'
    )
    attached = {MODEL_XML: zstandard.compress(text.encode())}
    assert isinstance(trial._in_a_child(attached), tuple)
    monkeypatch.setattr(trial, "COMMAND", ["-c", "import os; os.kill(os.getpid(), 11)"])
    assert trial._in_a_child(attached) == "one that crashes MuJoCo (signal 11)"
