"""Sliding past spheres: what is far changes nothing, what is near is not come closer to, and the rest of the motion stays."""

import numpy as np
import pytest

from coordlog.sim.avoid import CLOSING, LINK_RADIUS, NEAR, SAFE, slide
from coordlog.sim.config import EnvConfig
from coordlog.sim.env import BatchEnv
from coordlog.sim.ik import Reach
from coordlog.sim.scene import SCENES

FAR = 5.0
"""Further away than anything here [m]."""
EFFORT = np.where(np.arange(13) < 5, 0.012, 0.04)


@pytest.fixture(scope="module")
def reach() -> Reach:
    env = BatchEnv(SCENES["spheres"], EnvConfig(), n=1, threads=1)
    env.reset(np.array([0]), [env.problem(seed=0, split="train", index=0)])
    return Reach(SCENES["spheres"].robot, env.task.model, margin=0.01, standing=env.physics.qpos[0])


def home(reach: Reach) -> np.ndarray:
    return reach.angles_of(SCENES["spheres"].robot, "home")


def beside(reach: Reach, angles: np.ndarray, offset: tuple[float, float, float], *, radius: float = 0.04) -> np.ndarray:
    """A sphere near the left palm."""
    return np.array([[*(reach.palms(angles)[0] + offset), radius]])


def distance(reach: Reach, angles: np.ndarray, spheres: np.ndarray) -> float:
    return min(found.gap for found in reach.approaches(angles, spheres, within=FAR))


def test_what_is_far_changes_nothing(reach: Reach) -> None:
    rng, angles = np.random.default_rng(0), home(reach)
    spheres = beside(reach, angles, (0.0, 0.04 + LINK_RADIUS + NEAR + 0.01, 0.0))
    move = rng.uniform(-1, 1, 13) * EFFORT
    np.testing.assert_array_equal(slide(reach, angles, move, spheres=spheres, effort=EFFORT), move)
    np.testing.assert_array_equal(slide(reach, angles, move, spheres=np.zeros((0, 4)), effort=EFFORT), move)


def test_a_link_comes_no_closer_than_it_may(reach: Reach) -> None:
    rng, angles, turned = np.random.default_rng(1), home(reach), 0
    for _ in range(100):
        offset = rng.normal(size=3)
        offset *= (0.04 + LINK_RADIUS + rng.uniform(0.0, NEAR)) / np.linalg.norm(offset)
        spheres, move = beside(reach, angles, tuple(offset)), rng.uniform(-1, 1, 13) * EFFORT
        before, found = distance(reach, angles, spheres), slide(reach, angles, move, spheres=spheres, effort=EFFORT)
        may = CLOSING * (before - LINK_RADIUS - SAFE)
        after = distance(reach, angles + found, spheres)
        assert before - after < max(may, 0.0) + 1e-3, "to first order in the motion"
        turned += int(not np.array_equal(found, move))
    assert turned > 20


def test_a_motion_away_or_along_is_left_alone(reach: Reach) -> None:
    angles = reach.standing_angles  # the other arm is far
    spheres = beside(reach, angles, (0.0, 0.04 + LINK_RADIUS + 0.04, 0.0))
    row = min(reach.approaches(angles, spheres, within=FAR), key=lambda found: found.gap).closing
    away = -0.02 * row / np.abs(row).max()
    np.testing.assert_array_equal(slide(reach, angles, away, spheres=spheres, effort=EFFORT), away)
    move = np.random.default_rng(2).uniform(-0.02, 0.02, 13)
    along = move - row * (row @ move) / (row @ row)
    np.testing.assert_allclose(slide(reach, angles, along, spheres=spheres, effort=EFFORT), along, atol=1e-12)


def test_joints_that_can_do_more_give_way_more(reach: Reach) -> None:
    angles = reach.standing_angles  # the other arm is far
    spheres = beside(reach, angles, (0.0, 0.04 + LINK_RADIUS + 0.01, 0.0))
    row = min(reach.approaches(angles, spheres, within=FAR), key=lambda found: found.gap).closing
    towards = 0.02 * row / np.abs(row).max()
    given = towards - slide(reach, angles, towards, spheres=spheres, effort=EFFORT)
    moved = np.abs(row) > 1e-3
    np.testing.assert_allclose(given[moved] / (EFFORT**2 * row)[moved], (given[moved] / (EFFORT**2 * row)[moved])[0])
    assert np.abs(given).max() > 0.001
