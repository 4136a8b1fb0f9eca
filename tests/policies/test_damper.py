"""A shielded policy wants what it wanted, but comes no closer to spheres than it may."""

from dataclasses import replace

import numpy as np
import pytest

from coordlog.errors import ConfigError
from coordlog.policies.scripted import scripted, with_shield
from coordlog.sim.env import BatchEnv
from coordlog.tasks.config import EnvConfig
from coordlog.tasks.scene import SCENES


def spheres(n: int) -> BatchEnv:
    return BatchEnv(SCENES["spheres"], EnvConfig(), n=n, threads=1)


class Forward:
    """Swings the left arm forward."""

    def __init__(self, env: BatchEnv) -> None:
        reach, names = env.draw.reach, env.task.robot.action_joints
        reach.place(
            np.array(
                [
                    [*(reach.palms(reach.standing_angles)[0] + (0.15, 0.0, 0.0)), 0.05],
                    *[[2.0, 2.0, 2.0, 0.03]] * 2,
                ]
            )
        )
        forward = np.sign(sum(found.closing for found in reach.approaches(reach.standing_angles)))
        self._action = np.where(
            [name in env.task.robot.arms[0].joints for name in names], forward, 0.0
        ).astype(np.float32)

    def begin(self, ids: np.ndarray, state: np.ndarray, rngs: list[np.random.Generator]) -> None:
        pass

    def act(self, ids: np.ndarray, state: np.ndarray) -> np.ndarray:
        return np.tile(self._action, (len(ids), 1))


@pytest.mark.parametrize("shield", [False, True])
def test_an_arm_that_swings_at_a_sphere_touches_it_unless_shielded(shield: bool) -> None:
    env, one = spheres(1), np.array([0])
    drawn = env.problem(seed=7, split="train", index=0)
    env.reset(one, [drawn])
    palm = env.task.view.physical(env.state, "palms")[0, :3]
    far = [[2.0, 2.0, 2.0, 0.03]] * 2
    env.reset(
        one, [replace(drawn, spheres=np.array([[*np.add(palm, (0.12, 0.0, 0.0)), 0.05], *far]))]
    )
    policy = with_shield(Forward(env), env) if shield else Forward(env)
    touched = False
    for _ in range(60):
        outcome = env.step(policy.act(one, env.state), one)
        names = {
            env.task.model.geom(int(row[side])).name
            for row in outcome.contacts[0]
            for side in ("geom1", "geom2")
        }
        touched |= "sphere_0" in names
        if outcome.terminated[0]:
            break
    assert touched != shield


def test_what_keeps_its_distance_is_left_alone() -> None:
    env, ids = spheres(4), np.arange(4)
    env.reset(ids, [env.problem(seed=2, split="train", index=int(i)) for i in ids])
    plain, shielded = scripted("random", env), with_shield(scripted("random", env), env)
    for policy in (plain, shielded):
        policy.begin(ids, env.state, [np.random.default_rng(int(i)) for i in ids])
    wanted, found = plain.act(ids, env.state), shielded.act(ids, env.state)
    near = np.linalg.norm(
        env.task.view.physical(env.state, "nearness").reshape(4, -1, 3), axis=2
    ).max(axis=1)
    far = near < 0.2
    assert far.any()
    np.testing.assert_allclose(found[far], wanted[far], rtol=1e-6)
    assert found.dtype == np.float32
    assert np.abs(found).max() <= 1


def test_there_must_be_spheres() -> None:
    env = BatchEnv(SCENES["free"], EnvConfig(), n=1, threads=1)
    with pytest.raises(ConfigError, match="--shield: expected a scene with spheres, got 'free'"):
        with_shield(scripted("still", env), env)
