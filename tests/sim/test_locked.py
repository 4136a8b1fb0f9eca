"""Joints that are locked stay where they start, whatever the action, and the expert and the inverse
kinematics know it."""

from __future__ import annotations

import numpy as np
import pytest

from coordlog.errors import ConfigError
from coordlog.policies.scripted import scripted
from coordlog.sim.env import BatchEnv
from coordlog.sim.rollout import policy_rng
from coordlog.sim.tracking import Drive
from coordlog.tasks.config import EnvConfig
from coordlog.tasks.scene import find

SPINE = ("abs_y", "abs_x", "abs_z", "bust_y", "bust_x")


@pytest.fixture(scope="module")
def env() -> BatchEnv:
    return BatchEnv(find("table"), EnvConfig(locked=SPINE), n=2, threads=1)


def problems(env: BatchEnv) -> list:
    return [env.problem(seed=0, split="train", index=index) for index in range(env.n)]


def test_locked_joints_stay_and_the_others_move(env: BatchEnv) -> None:
    ids = np.arange(2)
    env.reset(ids, problems(env))
    before = env.physics.ctrl[:, env.task.servos].copy()
    for _ in range(5):
        env.step(np.ones((2, env.layout.n_u), dtype=np.float32), ids)
    moved = env.physics.ctrl[:, env.task.servos] - before
    assert (moved[:, :5] == 0.0).all()
    assert (moved[:, 5:] > 0.05).any(axis=0).all()


def test_problems_state_and_layout_are_those_of_the_free_robot(env: BatchEnv) -> None:
    free = BatchEnv(find("table"), n=2, threads=1)
    for locked, other in zip(problems(env), problems(free), strict=True):
        assert locked.goals.tobytes() == other.goals.tobytes()
        assert locked.angles.tobytes() == other.angles.tobytes()
    assert env.layout == free.layout
    assert env.describe()["config"]["locked"] == list(SPINE)
    assert env.describe()["state"] == free.describe()["state"]


def test_an_unknown_joint_is_refused() -> None:
    with pytest.raises(ConfigError, match="unknown locked joint 'spine'; choose one of: abs_x"):
        BatchEnv(find("table"), EnvConfig(locked=("spine",)), n=1)


def test_inverse_kinematics_leaves_held_joints_alone(env: BatchEnv) -> None:
    reach, locked = env.draw.reach, env.task.locked
    start = problems(env)[0].angles
    home = reach.angles_of(env.scene.robot, "home")
    goals = reach.palms(np.where(locked, start, home))
    held = np.where(locked, start, np.nan)
    found = reach.solve(goals, held=held)
    assert found is not None
    assert (found[locked] == start[locked]).all()
    assert np.abs(reach.palms(found) - goals).max() < 0.002
    lean = np.where(locked, start + 0.2, home)
    assert (
        reach.descend(reach.palms(lean), home, held=np.where(locked, start + 0.2, np.nan))
        is not None
    )
    far = np.array([[0.36, 0.06, 0.5], [0.36, -0.06, 0.5]])
    assert reach.descend(far, home) is not None, "with the spine it is within reach"
    assert reach.descend(far, home, held=held) is None


def test_the_expert_never_asks_a_locked_joint_to_move(env: BatchEnv) -> None:
    ids = np.arange(2)
    env.reset(ids, problems(env))
    expert = scripted("expert", env)
    expert.begin(ids, env.state, [policy_rng(0, "train", index) for index in range(2)])
    for _ in range(60):
        action = expert.act(ids, env.state)
        assert (action[:, env.task.locked] == 0.0).all()
        assert np.isfinite(action).all()
        env.step(action, ids)
    assert np.abs(env.state[:, 5:13]).max() > 0.1


def test_a_drive_asks_nothing_of_a_locked_joint(env: BatchEnv) -> None:
    env.reset(np.arange(2), problems(env))
    drive = Drive(env.simulation)
    action = drive.action_to(drive.target + 0.01)
    assert (action[env.task.locked] == 0.0).all()
    assert (action[~env.task.locked] > 0.0).all()
