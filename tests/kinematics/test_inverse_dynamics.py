"""Tests for inverse dynamics along a path: against forward dynamics, and the zero-moment point
against plain momentum."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from coordlog.kinematics.balance import GRAVITY
from coordlog.kinematics.support import FALLING
from tests.kinematics.test_clearance import Walk
from tests.plain import product, rotate


@pytest.fixture(scope="module")
def walk():
    return Walk("table")


def moving(walk, n, *, hard=4.0):
    time, q, _ = walk.draw(n, spread=0.2)
    return time, q, walk.rng.normal(size=q.shape), hard * walk.rng.normal(size=q.shape)


def test_torques_bring_about_the_accelerations_they_were_asked_for(walk):
    """Forward dynamics with the base held, without dry friction, contacts and stops: what the
    inverse leaves out."""
    time, q, velocity, acceleration = moving(walk, 20)
    torque = walk.checker.inverse(time, q, velocity, acceleration).torque
    model, data = walk.model, mujoco.MjData(walk.model)
    places = model.jnt_dofadr[[model.joint(name).id for name in walk.task.robot.action_joints]]
    full, qpos = np.zeros((model.nv, model.nv)), walk.checker._logged.whole(time, q)
    for i in range(len(q)):
        data.qpos[:], data.qvel[:] = qpos[i], 0.0
        data.qvel[places] = velocity[i]
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        wanted = (
            full[np.ix_(places, places)] @ acceleration[i]
            + data.qfrc_bias[places]
            - data.qfrc_passive[places]
        )
        assert torque[i] == pytest.approx(wanted, abs=1e-9)
    assert np.abs(torque).max() > 1.0


def test_dry_friction_is_left_out_and_damping_is_not(walk):
    time, q, velocity, _ = moving(walk, 5)
    still = np.zeros_like(velocity)
    there, back = (
        walk.checker.inverse(time, q, sign * velocity, still).torque for sign in (1.0, -1.0)
    )
    places = walk.model.jnt_dofadr[
        [walk.model.joint(name).id for name in walk.task.robot.action_joints]
    ]
    assert (there - back) / 2.0 == pytest.approx(
        walk.model.dof_damping[places] * velocity, abs=1e-9
    )
    assert walk.model.dof_frictionloss[places].max() > 0.0, (
        "there must be some, or the test shows nothing"
    )


def test_the_zero_moment_point_is_where_the_momentum_says(walk):
    """Momentum of bodies placed in plain NumPy, its rate by differences: about the point, the
    floor's push has no level moment."""
    time, q, velocity, acceleration = moving(walk, 12)
    step, model, weight = (
        1e-3,
        walk.model,
        walk.model.body_mass.sum() * GRAVITY * np.array([0.0, 0.0, 1.0]),
    )
    whole = walk.checker._logged.whole
    places = [
        pose(walk, whole(time, q + h * velocity + 0.5 * h * h * acceleration))
        for h in (-2 * step, 0.0, 2 * step)
    ]
    earlier, later = (momentum(model, *pair, 2.0 * step) for pair in (places[:2], places[1:]))
    linear, angular = (
        (late - early) / (2.0 * step) for early, late in zip(earlier, later, strict=True)
    )
    com = walk.plain.com(whole(time, q))
    force, moment = linear + weight, angular + np.cross(com, weight)
    point = np.stack([-moment[:, 1], moment[:, 0]], axis=1) / force[:, 2:]
    sites = walk.checker._footing.corners
    body, corners = model.site_bodyid[sites], model.site_pos[sites]
    pos, quat = walk.plain.bodies(whole(time, q))
    corners = pos[:, body] + rotate(
        quat[:, body], np.broadcast_to(corners, (len(q), *corners.shape))
    )
    wanted = np.maximum(walk.checker._footing.margin(time, point, corners), FALLING)
    found = walk.checker.inverse(time, q, velocity, acceleration).balance
    assert found == pytest.approx(wanted, abs=1e-4)
    still = walk.checker.slack(time, q, 0.0)[:, -1] + walk.task.config.balance_margin
    assert np.abs(found - still).max() > 0.005, "motion must matter, or the test shows nothing"


def pose(walk, qpos):
    """Centres of mass (n, n_body, 3) and the axes of inertia (n, n_body, 3, 3), columns in the
    world."""
    model, (pos, quat) = walk.model, walk.plain.bodies(qpos)
    turn = product(quat, np.broadcast_to(model.body_iquat, quat.shape))
    axes = np.stack([rotate(turn, np.broadcast_to(axis, pos.shape)) for axis in np.eye(3)], axis=-1)
    return pos + rotate(quat, np.broadcast_to(model.body_ipos, pos.shape)), axes


def momentum(model, before, after, dt):
    """Linear and angular momentum about the origin of the world half-way between two poses dt
    apart, (n, 3) each."""
    centre, axes = (0.5 * (one + other) for one, other in zip(before, after, strict=True))
    velocity = (after[0] - before[0]) / dt
    rate = np.einsum("nbij,nbkj->nbik", (after[1] - before[1]) / dt, axes)  # the matrix of ω ×
    spin = 0.5 * np.stack(
        [
            rate[..., 2, 1] - rate[..., 1, 2],
            rate[..., 0, 2] - rate[..., 2, 0],
            rate[..., 1, 0] - rate[..., 0, 1],
        ],
        axis=-1,
    )
    about = np.einsum("nbij,bj,nbkj,nbk->nbi", axes, model.body_inertia, axes, spin)
    push = model.body_mass[:, None] * velocity
    return push.sum(axis=1), (about + np.cross(centre, push)).sum(axis=1)


def test_a_still_robot_has_its_zero_moment_point_under_its_centre_of_mass(walk):
    time, q, _ = walk.draw(50, spread=0.2)
    still = np.zeros_like(q)
    found = walk.checker.inverse(time, q, still, still).balance
    com = walk.checker.slack(time, q, 0.0)[:, -1] + walk.task.config.balance_margin
    inside = com > 0.0
    assert inside.sum() > 20
    assert found[inside] == pytest.approx(com[inside], abs=1e-9)


def test_the_checker_refuses_what_its_feet_cannot_hold(walk):
    time, q, _ = walk.draw(20, spread=0.0)
    still, hard = np.zeros_like(q), np.full_like(q, 60.0)
    assert walk.checker.moving(time, q, still, still).free.all()
    verdict = walk.checker.moving(time, q, still, hard)
    assert not verdict.free.any()
    assert (verdict.depth > 0.0).all()
    assert "zero-moment point" in walk.checker.describe(int(verdict.what[0]))


def test_a_robot_without_feet_has_torques_and_no_balance():
    arm = Walk("planar", steps=5)
    q = arm.qpos[:, arm.task.qpos_index]
    load = arm.checker.inverse(arm.time, q, np.zeros_like(q), np.ones_like(q))
    assert load.torque.shape == q.shape
    assert np.abs(load.torque).max() > 0.0
    assert np.isinf(load.balance).all()
    assert arm.checker.moving(arm.time, q, np.zeros_like(q), np.ones_like(q)).free.all()
