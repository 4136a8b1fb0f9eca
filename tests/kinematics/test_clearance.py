"""Tests for the checker of recorded episodes: bounds that must hold, and distances against plain
NumPy ones."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from coordlog.episode import INITIAL_STATE
from coordlog.kinematics.clearance import NEAR, SceneChecker
from coordlog.sim.env import BatchEnv
from coordlog.tasks.scene import find
from tests.plain import Plain


class Walk:
    """A short random episode of a scene, its checker, and configurations around it."""

    def __init__(self, scene, *, seed=0, steps=40):
        rng = np.random.default_rng(seed)
        env = BatchEnv(find(scene), n=1, threads=1)
        env.reset(np.array([0]), [env.problem(seed=seed, split="train", index=0)])
        initial = np.frombuffer(env.attachments(0)[INITIAL_STATE])
        rows, drift = [env.simulation.qpos[0].copy()], np.zeros((1, env.layout.n_u), np.float32)
        for _ in range(steps):
            drift = np.clip(0.9 * drift + 0.3 * rng.normal(size=drift.shape), -1, 1).astype(
                np.float32
            )
            env.step(drift, np.array([0]))
            rows.append(env.simulation.qpos[0].copy())
        self.rng, self.model, self.task = rng, env.physics.model_of(0), env.task
        self.qpos, self.time = np.array(rows), np.arange(steps + 1) * 0.04
        self.checker = SceneChecker(
            self.model,
            env.scene.robot,
            env.task.config,
            time=self.time,
            qpos=self.qpos,
            initial=initial,
        )
        self.plain = Plain(self.model, mocap_pos=env.physics.mocap_pos[0].copy())
        low, high = env.task.limits.T
        self.low, self.high = low, high

    def draw(self, n, *, spread=1.0):
        """n times and angles: the episode's, disturbed."""
        row = self.rng.integers(len(self.qpos), size=n)
        q = self.qpos[row][:, self.task.qpos_index] + spread * self.rng.random(
            (n, 1)
        ) * self.rng.normal(size=(n, len(self.low)))
        return self.time[row], np.clip(q, self.low, self.high), row


@pytest.fixture(scope="module", params=["spheres", "shelf", "table"])
def walk(request):
    return Walk(request.param)


def test_check_says_free_exactly_where_no_slack_is_negative(walk):
    time, q, _ = walk.draw(800)
    for clearance in (0.0, 0.01):
        verdict, slack = (
            walk.checker.check(time, q, clearance),
            walk.checker.slack(time, q, clearance),
        )
        worst = slack.min(axis=1)
        clear = np.abs(worst) > 1e-7
        assert (verdict.free == (worst >= 0))[clear].all()
        assert 100 < verdict.free.sum() < 790, "both kinds must occur"
        assert (verdict.depth[~verdict.free] > 0).all()
        assert (verdict.depth[verdict.free] == 0).all()
        assert (verdict.what[verdict.free] == -1).all()
        assert all(slack[i, verdict.what[i]] < 1e-7 for i in np.flatnonzero(~verdict.free))


def test_distances_are_those_of_plain_numpy(walk):
    time, q, row = walk.draw(24)
    qpos = walk.qpos[row].copy()
    qpos[:, walk.task.qpos_index] = q
    got = walk.checker.slack(time, q, 0.0)
    wanted = walk.plain.distances(qpos, walk.checker.pairs, cap=NEAR)
    got = got[:, : len(walk.checker.pairs)]
    near = (wanted > 1e-4) & (wanted < 0.9 * NEAR)
    assert near.sum() > 300
    assert np.abs(got - wanted)[near].max() < 1e-4
    assert (got[wanted < -1e-4] < 0).all()
    assert (wanted[got < -1e-4] < 1e-4).all()


def test_no_slack_exceeds_the_true_distance(walk):
    """Lower bounds are allowed for pairs that are far apart, never upper ones."""
    time, q, row = walk.draw(10)
    qpos = walk.qpos[row].copy()
    qpos[:, walk.task.qpos_index] = q
    exact = walk.plain.distances(qpos, walk.checker.pairs, cap=np.inf)
    got = walk.checker.slack(time, q, 0.0)[:, : exact.shape[1]]
    assert (got <= np.maximum(exact, 0.0) + 2e-4).all()


def test_slack_changes_no_faster_than_reach_allows(walk):
    time, q, row = walk.draw(150)
    for size in (0.01, 0.3):
        other = np.clip(
            q + size * walk.rng.normal(size=q.shape) * (walk.rng.random(q.shape) < 0.3),
            walk.low,
            walk.high,
        )
        exact = [distances(walk, row, angles) for angles in (q, other)]
        bound = np.abs(other - q) @ walk.checker.reach.T
        change = np.abs(exact[1] - exact[0])
        assert (change <= bound + 1e-6).all()
        assert change.max() > 0.5 * size * 0.1, "something must move, or the test shows nothing"
        margin = [walk.checker.slack(time, angles, 0.0)[:, -1] for angles in (q, other)]
        finite = np.isfinite(margin[0])
        assert (np.abs(margin[1] - margin[0]) <= bound[:, -1:].ravel() + 1e-9)[finite].all()


def distances(walk, row, q):
    """Distances of all pairs by the model's own functions without a cap, balance excluded.

    Zero for overlap.
    """
    qpos = walk.qpos[row].copy()
    qpos[:, walk.task.qpos_index] = q
    model, data = walk.model, mujoco.MjData(walk.model)
    data.mocap_pos[:] = walk.plain.mocap_pos
    found = np.zeros((len(q), len(walk.checker.pairs) + 1))
    for i in range(len(q)):
        data.qpos[:] = qpos[i]
        mujoco.mj_kinematics(model, data)
        for k, (a, b) in enumerate(walk.checker.pairs.tolist()):
            found[i, k] = max(mujoco.mj_geomDistance(model, data, a, b, 10.0, None), 0.0)
    return found


def test_slack_drifts_no_faster_than_said(walk):
    """The joints of the path stand still while the base and the legs move as logged."""
    angles = np.repeat(walk.qpos[10:11, walk.task.qpos_index], 200, axis=0)
    time = np.sort(walk.rng.uniform(walk.time[0], walk.time[-1], 200))
    slack = walk.checker.slack(time, angles, -NEAR)  # a negative clearance measures further out
    speed = walk.checker.drift(time[:-1], time[1:])
    near = (
        (slack[1:] < 2 * NEAR - 1e-6)
        & (slack[:-1] < 2 * NEAR - 1e-6)
        & np.isfinite(slack[1:])
        & np.isfinite(slack[:-1])
    )
    near[:, :-1] &= (slack[1:, :-1] > NEAR) & (slack[:-1, :-1] > NEAR)
    change = np.abs(np.diff(slack, axis=0))
    allowed = speed * np.diff(time)[:, None]
    exact = near & (change < NEAR)
    assert exact.sum() > 1000
    assert (change <= allowed + 1e-6)[exact].all()


def test_drift_of_a_stretch_covers_its_parts(walk):
    start = walk.rng.uniform(0, 1.0, 50)
    stop = start + walk.rng.uniform(0, 0.5, 50)
    whole = walk.checker.drift(start, stop)
    assert (walk.checker.drift(start, (start + stop) / 2) <= whole).all()
    assert (walk.checker.drift((start + stop) / 2, stop) <= whole).all()


def test_the_log_itself_gives_what_the_physics_saw(walk):
    """Contacts that the engine reports at the logged configurations are those the checker finds."""
    data = mujoco.MjData(walk.model)
    data.mocap_pos[:] = walk.plain.mocap_pos
    verdict = walk.checker.check(walk.time, walk.qpos[:, walk.task.qpos_index], 0.0)
    pairs = {tuple(pair) for pair in walk.checker.pairs.tolist()}
    for i, row in enumerate(walk.qpos):
        data.qpos[:] = row
        mujoco.mj_kinematics(walk.model, data)
        mujoco.mj_collision(walk.model, data)
        touching = any(
            tuple(sorted(geom)) in pairs and dist < 0
            for geom, dist in zip(data.contact.geom.tolist(), data.contact.dist, strict=True)
        )
        balance = verdict.what[i] == len(walk.checker.pairs)
        assert touching == (not verdict.free[i] and not balance) or balance


def test_pairs_are_those_the_engine_lets_collide(walk):
    """Every contact of disturbed postures that an action joint can cause is among the pairs.

    Soles on the floor are not.
    """
    data = mujoco.MjData(walk.model)
    data.mocap_pos[:] = walk.plain.mocap_pos
    pairs = {tuple(pair) for pair in walk.checker.pairs.tolist()}
    _, q, row = walk.draw(300)
    seen = set()
    for i in range(len(q)):
        data.qpos[:] = walk.qpos[row[i]]
        data.qpos[walk.task.qpos_index] = q[i]
        mujoco.mj_kinematics(walk.model, data)
        mujoco.mj_collision(walk.model, data)
        seen |= {tuple(sorted(geom)) for geom in data.contact.geom.tolist()}
    names = {
        tuple(sorted((walk.model.geom(a).name, walk.model.geom(b).name))) for a, b in seen - pairs
    }
    assert names <= {("floor", "l_foot_sole"), ("floor", "r_foot_sole")}
    assert len(seen & pairs) > 10


def test_balance_is_the_last_pair_and_leaning_over_is_found(walk):
    q = walk.qpos[:1, walk.task.qpos_index].copy()
    upright = walk.checker.slack(walk.time[:1], q, 0.0)[0, -1]
    q[0, 1], q[0, 4] = walk.high[1], walk.high[4]  # bend sideways
    bent = walk.checker.slack(walk.time[:1], q, 0.0)[0, -1]
    assert upright > 0.02
    assert bent < upright - 0.01
    assert "centre of mass" in walk.checker.describe(len(walk.checker.pairs))
    assert " and " in walk.checker.describe(0)


def test_a_robot_without_obstacles_or_feet_has_no_pairs():
    arm = Walk("planar", steps=5)
    assert arm.checker.reach.shape == (0, 8)
    assert arm.checker.check(arm.time, arm.qpos[:, arm.task.qpos_index], 0.01).free.all()
    assert arm.checker.slack(arm.time, arm.qpos[:, arm.task.qpos_index], 0.0).shape == (6, 0)
    assert arm.checker.drift(arm.time[:-1], arm.time[1:]).shape[0] == 5
