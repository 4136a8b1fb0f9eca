"""The planar arm of the first DiGrad paper: eight joints, three end effectors, and nothing written
for two arms."""

import mujoco
import numpy as np
import pytest

from coordlog.robots.planar import BRANCHES, FAN, LENGTH, PLANAR
from coordlog.sim.env import BatchEnv
from coordlog.tasks.scene import find


@pytest.fixture(scope="module")
def env():
    return BatchEnv(find("planar"), n=4, threads=1)


def fingertip(angles, branch):
    """End of one branch by adding up four links in the plane."""
    names = ("base_1", "base_2", f"{branch}_1", f"{branch}_2")
    turned = {f"{name}_1": FAN * (1 - i) for i, name in enumerate(BRANCHES)}
    heading = np.cumsum([angles[name] + turned.get(name, 0.0) for name in names])
    return LENGTH * np.array([np.cos(heading).sum(), np.sin(heading).sum(), 0.0])


def test_has_eight_joints_and_three_arms_that_share_two(env):
    model = env.task.model
    assert (model.nq, model.nv, model.nu) == (8, 8, 8)
    assert len(PLANAR.arms) == 3
    assert [len(served) for served in PLANAR.served.values()] == [4, 4, 4]
    assert set.intersection(*(set(served) for served in PLANAR.served.values())) == {0, 1}


def test_fingertips_are_where_trigonometry_puts_them(env):
    rng, limits = np.random.default_rng(0), env.task.limits
    for _ in range(20):
        angles = rng.uniform(*limits.T)
        by_name = dict(zip(PLANAR.action_joints, angles, strict=True))
        wanted = [fingertip(by_name, branch) for branch in BRANCHES]
        assert env.draw.reach.palms(angles) == pytest.approx(np.array(wanted), abs=1e-12)


def test_goals_are_reachable_and_inverse_kinematics_finds_them_again(env):
    found = 0
    for index in range(20):
        goals = env.problem(seed=0, split="train", index=index).goals
        assert goals.shape == (3, 3)
        assert (np.linalg.norm(goals, axis=1) <= 4 * LENGTH).all()
        angles = env.draw.reach.solve(goals)
        if angles is not None:
            found += 1
            assert env.draw.reach.palms(angles) == pytest.approx(goals, abs=3e-3)
    assert (
        found >= 10
    )  # the search is local and the arm has few joints; every goal is some posture's palms by construction


def test_never_falls_never_collides_and_moves_where_it_is_told(env):
    ids = np.arange(4)
    env.reset(ids, [env.problem(seed=0, split="train", index=int(i)) for i in ids])
    before = env.physics.qpos.copy()
    action = np.zeros((4, 8), dtype=np.float32)
    action[:, 0] = 1.0
    for _ in range(10):
        outcome = env.step(action, ids)
        assert not outcome.collision.any()
        assert not outcome.instability.any()
    moved = env.physics.qpos - before
    assert (moved[:, env.task.qpos_index[0]] > 0.15).all()
    assert np.abs(np.delete(moved, env.task.qpos_index[0], axis=1)).max() < 0.1


def test_its_model_has_no_contacts_in_any_posture(env):
    rng, data = np.random.default_rng(0), mujoco.MjData(env.task.model)
    for _ in range(20):
        data.qpos[env.task.qpos_index] = rng.uniform(*env.task.limits.T)
        mujoco.mj_forward(env.task.model, data)
        assert data.ncon == 0
