"""What an episode in memory says of itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import coordlog
from coordlog.errors import SpecError

LOGS = Path(__file__).parent / "data"
FILES = [sorted(LOGS.glob(f"v1/{scene}/*.mcap"))[0] for scene in ("table", "spheres", "planar")]


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.parent.name)
def test_parts_of_the_state_come_back_in_physical_units(file: Path) -> None:
    (episode,) = coordlog.open(file)
    env = episode.header.env
    index = {joint["name"]: joint["qpos"] for joint in env["joints"]}
    angles = episode.qpos[:, [index[name] for name in env["action_joints"]]]
    assert np.abs(episode.physical("angles") - angles).max() < 1e-6
    goals = np.ravel(episode.header.episode["goals"])
    assert np.abs(episode.physical("goals") - goals).max() < 1e-6
    distance = np.linalg.norm(
        (episode.physical("palms") - episode.physical("goals")).reshape(len(episode) + 1, -1, 3),
        axis=2,
    )
    assert np.abs(distance[1:] - episode.distance).max() < 1e-6


def test_an_unknown_part_lists_those_there_are() -> None:
    (episode,) = coordlog.open(FILES[0])
    with pytest.raises(SpecError, match=r"expected a part of the state \(angles, .*got 'hands'"):
        episode.physical("hands")
