"""Sliding past what is near: what is far changes nothing, what is near is not come closer to, and
the rest of the motion stays."""

import mujoco
import numpy as np
import pytest

from coordlog.kinematics.ik import FAR, Approach, Reach
from coordlog.policies.avoidance import DamperConfig, slide
from coordlog.sim.env import BatchEnv
from coordlog.tasks.config import EnvConfig
from coordlog.tasks.scene import SCENES

DAMPER = DamperConfig()
EFFORT = np.where(np.arange(13) < 5, 0.012, 0.04)
ELSEWHERE = [[2.0, 2.0, 2.0, 0.03]] * 2
"""The other spheres, out of the way."""
FOREARM = 0.018
"""Radius of the capsule that ends in the palm [m]."""


@pytest.fixture
def reach() -> Reach:
    env = BatchEnv(SCENES["spheres"], EnvConfig(), n=1, threads=1)
    env.reset(np.array([0]), [env.problem(seed=0, split="train", index=0)])
    return Reach(
        SCENES["spheres"].robot, env.task.model, margin=0.01, tilt=1.2, standing=env.physics.qpos[0]
    )


def home(reach: Reach) -> np.ndarray:
    return reach.angles_of(SCENES["spheres"].robot, "home")


def put_beside(
    reach: Reach, angles: np.ndarray, offset: tuple[float, float, float], *, radius: float = 0.04
) -> None:
    """A sphere near the left palm, the others elsewhere."""
    reach.place(np.array([[*(reach.palms(angles)[0] + offset), radius], *ELSEWHERE]))


def nearest(reach: Reach, angles: np.ndarray) -> Approach:
    """The last link that is nearest to an obstacle."""
    return min(
        (found for found in reach.approaches(angles) if found.tip and found.solid),
        key=lambda found: found.gap,
    )


def test_what_is_far_changes_nothing(reach: Reach) -> None:
    angles = reach.standing_angles
    put_beside(reach, angles, (0.3, 0.3, 0.0))
    move = np.random.default_rng(0).uniform(-1, 1, 13) * EFFORT
    assert not any(found.solid for found in reach.approaches(angles))
    np.testing.assert_array_equal(slide(reach, angles, move, effort=EFFORT, config=DAMPER), move)


def test_gaps_close_as_they_are_said_to(reach: Reach) -> None:
    rng, angles, step = np.random.default_rng(1), home(reach), 1e-5
    put_beside(reach, angles, (0.03, 0.05, 0.05))
    before, seen = reach.approaches(angles), 0
    for _ in range(10):
        move = rng.normal(size=13) * step
        for was, found in zip(before, reach.approaches(angles + move), strict=True):
            np.testing.assert_allclose(was.gap - found.gap, was.closing @ move, atol=2e-3 * step)
            seen += 1
    assert seen >= 20


def test_a_link_comes_no_closer_than_it_may(reach: Reach) -> None:
    rng, angles, turned = np.random.default_rng(1), home(reach), 0
    for _ in range(100):
        offset = rng.normal(size=3)
        put_beside(
            reach,
            angles,
            tuple(offset * (0.04 + FOREARM + rng.uniform(0.0, 0.7 * FAR)) / np.linalg.norm(offset)),
        )
        move = rng.uniform(-1, 1, 13) * EFFORT
        found = slide(reach, angles, move, effort=EFFORT, config=DAMPER)
        for near in reach.approaches(angles):
            assert (
                near.closing @ found
                < max(DAMPER.allowed(near, DAMPER.safe), near.closing @ move * 0.15) + 1e-3
            ), "after a few rounds"
        turned += int(not np.array_equal(found, move))
    assert turned > 20


def test_an_arm_does_not_run_into_its_own_body(reach: Reach) -> None:
    angles = home(reach)
    reach.place(np.array([[2.0, 2.0, 2.0, 0.03], *ELSEWHERE]))
    inwards = np.zeros(13)
    names = SCENES["spheres"].robot.action_joints
    inwards[[names.index("l_arm_z"), names.index("l_shoulder_x")]] = [-0.04, -0.02]
    free, kept = angles.copy(), angles.copy()
    for _ in range(60):
        free = free + inwards
        kept = kept + slide(reach, kept, inwards, effort=EFFORT, config=DAMPER)
    assert reach.touches(free), "else there is nothing to avoid"
    assert not reach.touches(kept)
    assert not reach.touches(kept, own=DAMPER.own / 2)


def test_a_motion_that_closes_no_gap_is_left_alone(reach: Reach) -> None:
    angles = reach.standing_angles
    put_beside(reach, angles, (0.0, 0.04 + FOREARM + 0.04, 0.0))
    rows = np.array([found.closing for found in reach.approaches(angles)])
    away = -0.02 * rows.sum(axis=0) / np.abs(rows.sum(axis=0)).max()
    assert (rows @ away <= 0).all()
    np.testing.assert_array_equal(slide(reach, angles, away, effort=EFFORT, config=DAMPER), away)
    move = np.random.default_rng(2).uniform(-0.02, 0.02, 13)
    rows = np.array([*rows, reach.leaning().closing])
    along = move - np.linalg.pinv(rows) @ (rows @ move)
    np.testing.assert_allclose(
        slide(reach, angles, along, effort=EFFORT, config=DAMPER), along, atol=1e-12
    )


def test_joints_that_can_do_more_give_way_more(reach: Reach) -> None:
    angles = reach.standing_angles
    put_beside(reach, angles, (0.0, 0.0, -0.04 - FOREARM - 0.02))
    near = nearest(reach, angles).closing
    towards = 0.02 * near / np.abs(near).max()
    given = towards - slide(reach, angles, towards, effort=EFFORT, config=DAMPER)
    moved = np.abs(near) > 1e-3
    share = given[moved] / (EFFORT**2 * near)[moved]
    np.testing.assert_allclose(share, share[0])
    assert np.abs(given).max() > 0.001


def test_the_gap_to_keep_shrinks_as_the_palms_arrive() -> None:
    gaps = [DAMPER.gap_at(distance) for distance in np.linspace(0.0, 2 * DAMPER.on_the_way, 50)]
    assert gaps == sorted(gaps)
    assert gaps[0] == DAMPER.close
    assert gaps[-1] == DAMPER.safe


def test_spheres_that_are_placed_are_where_a_compiled_model_has_them(reach: Reach) -> None:
    rng, angles = np.random.default_rng(3), home(reach)
    for _ in range(20):
        centres = reach.palms(angles)[rng.integers(2, size=3)] + rng.normal(size=(3, 3)) * 0.1
        reach.place(np.column_stack([centres, rng.uniform(0.02, 0.08, 3)]))
        placed = reach.approaches(angles)
        mujoco.mj_setConst(reach._wide, mujoco.MjData(reach._wide))
        assert [(found.gap, found.closing.tobytes()) for found in placed] == [
            (found.gap, found.closing.tobytes()) for found in reach.approaches(angles)
        ]
        assert placed


def test_the_torso_leans_as_it_is_said_to(reach: Reach) -> None:
    rng, angles = np.random.default_rng(5), home(reach)
    angles[:5] += 0.3
    reach.place(np.array([[2.0, 2.0, 2.0, 0.03], *ELSEWHERE]))
    for _ in range(10):
        move = rng.normal(size=13) * 1e-5
        reach.approaches(angles)
        before = reach.leaning()
        reach.approaches(angles + move)
        np.testing.assert_allclose(
            before.gap - reach.leaning().gap, before.closing @ move, atol=1e-8
        )


def test_a_robot_that_leans_as_far_as_it_can_stops_before_it_counts_as_tipped(reach: Reach) -> None:
    reach.place(np.array([[2.0, 2.0, 2.0, 0.03], *ELSEWHERE]))

    def leant(*, damped: bool) -> float:
        angles = home(reach)
        for _ in range(80):
            reach.approaches(angles)
            move = EFFORT * np.sign(reach.leaning().closing)
            angles = angles + (
                slide(reach, angles, move, effort=EFFORT, config=DAMPER) if damped else move
            )
        reach.approaches(angles)
        return reach.leaning().gap

    assert leant(damped=False) < 0.0, "else there is nothing to avoid"
    assert leant(damped=True) > 0.5 * DAMPER.lean
