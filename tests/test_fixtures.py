"""The fixture logs: today's code reads, understands and replays what earlier releases recorded."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from coordlog.record.dataset import open as open_logs
from coordlog.record.reader import read_episode
from coordlog.verify.levels import check_files

DATA = Path(__file__).parent / "data"
EPISODES = sorted(DATA.glob("v*/*/*.mcap"))
DIGESTS = {
    line.split("  ")[1]: line.split("  ")[0]
    for line in (DATA / "SHA256SUMS").read_text(encoding="utf-8").splitlines()
}


def test_the_set_is_as_it_was_committed() -> None:
    found = {
        str(path.relative_to(DATA)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in EPISODES
    }
    assert found == DIGESTS
    assert sum(path.stat().st_size for path in EPISODES) < 1_000_000


def test_every_scene_is_there_with_success_and_failure() -> None:
    for scene in ("free", "spheres", "table", "shelf"):
        results = [episode.result for episode in open_logs(DATA / "v1" / scene)]
        assert len(results) >= 3
        assert {result.clean for result in results} == {True, False}


@pytest.mark.parametrize(
    "folder", sorted(DATA.glob("v*/*")), ids=lambda folder: f"{folder.parent.name}-{folder.name}"
)
def test_every_episode_is_sound_down_to_the_last_bit_of_its_physics(folder: Path) -> None:
    checked = check_files(sorted(folder.glob("*.mcap")), level="replay")
    assert checked.findings == []
    assert checked.steps == sum(len(episode) for episode in open_logs(folder))


def test_one_episode_says_what_it_said() -> None:
    episode = read_episode(DATA / "v1" / "free" / "free-train-s11-000000-08b8060e.mcap")
    assert len(episode) == episode.result.length == 98
    assert episode.header.episode["start_time"] == 1_700_000_000_000_000_000
    assert episode.header.arms == ("left", "right")
    assert episode.header.policy["noise"] == {"kind": "gaussian", "sigma": 0.1, "correlation": 0.0}
    assert episode.result.returns == pytest.approx(episode.reward.sum(axis=0))
    assert episode.goal[-1].all()
    assert (episode.distance[-1] < 0.03).all()
