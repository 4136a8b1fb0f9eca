"""Bounds and distances for joints and shapes of every kind: random trees, laws that must hold in
any posture."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from coordlog.kinematics.clearance import SceneChecker
from coordlog.kinematics.levers import FREE, Levers, moved, strokes
from coordlog.robots.robot import Arm, Robot
from coordlog.smooth import Limits, smooth
from coordlog.tasks.config import EnvConfig

TETRA = "0 0 0  .12 0 0  0 .1 0  0 0 .08  .1 .1 .1"


def vector(rng, scale=1.0):
    return " ".join(f"{x:.6f}" for x in scale * rng.normal(size=3))


def tree(seed):
    """A random chain with branches: up to three joints of any kind on each body, and a loose box."""
    rng = np.random.default_rng(seed)
    text, names = "", []
    for i in range(5):
        joints = ""
        for k in range(rng.integers(1, 4)):
            kind = rng.choice(["hinge", "hinge", "slide"])
            names.append(f"j{i}{k}")
            limit = 'range="-0.3 0.2" limited="true"' if kind == "slide" else ""
            joints += (
                f'<joint name="j{i}{k}" type="{kind}" axis="{vector(rng)}" '
                f'pos="{vector(rng, 0.05)}" {limit}/>'
            )
        text += (
            f'<body name="b{i}" pos="{vector(rng, 0.15)}" euler="{vector(rng)}">{joints}'
            f'<geom type="mesh" mesh="m" pos="{vector(rng, 0.03)}"/>'
        )
    text += "</body>" * 5
    xml = (
        f'<mujoco><compiler angle="radian"/><asset><mesh name="m" vertex="{TETRA}"/></asset>'
        f'<worldbody>{text}<body pos="1 1 1"><freejoint/><geom type="box" size=".1 .2 .1"/>'
        '<body pos="0 0 .3"><joint type="ball" name="ball"/><geom size=".05" pos=".1 0 0"/></body>'
        "</body></worldbody></mujoco>"
    )
    return mujoco.MjModel.from_xml_string(xml), names, rng


def posture(model, rng):
    q = model.qpos0.copy()
    for joint in range(model.njnt):
        place = model.jnt_qposadr[joint]
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE:
            q[place] = rng.uniform(-7.0, 7.0)
        elif model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE:
            q[place] = rng.uniform(*model.jnt_range[joint])
        else:
            size = 7 if model.jnt_type[joint] == FREE else 4
            q[place : place + size] = rng.normal(size=size)
            q[place + size - 4 : place + size] /= np.linalg.norm(q[place + size - 4 : place + size])
    return q


def centres(model, q):
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    return data.geom_xpos.copy(), data.geom_xmat.reshape(-1, 3, 3).copy()


@pytest.mark.parametrize("seed", range(5))
def test_no_point_moves_further_than_the_bounds_say(seed):
    """One joint moved a little anywhere: every point within a geom's sphere, by its lever at most."""
    model, _, rng = tree(seed)
    levers = Levers(model)
    _, reach = moved(model, levers)
    worst = 0.0
    for _ in range(15):
        q = posture(model, rng)
        for joint in range(model.njnt):
            tangent = np.zeros(model.nv)
            dof = int(model.jnt_dofadr[joint])
            if model.jnt_type[joint] == FREE:
                tangent[dof + 3 : dof + 6] = rng.normal(size=3)
            elif model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_BALL:
                tangent[dof : dof + 3] = rng.normal(size=3)
            else:
                tangent[dof] = 1.0
            step = 1e-5
            tangent *= step / np.linalg.norm(tangent)
            other = q.copy()
            mujoco.mj_integratePos(model, other, tangent, 1.0)
            (c0, r0), (c1, r1) = centres(model, q), centres(model, other)
            for _ in range(3):
                local = rng.normal(size=(model.ngeom, 3))
                local *= model.geom_rbound[:, None] / np.linalg.norm(local, axis=1)[:, None]
                there = c1 + np.einsum("nij,nj->ni", r1, local)
                here = c0 + np.einsum("nij,nj->ni", r0, local)
                speed = np.linalg.norm(there - here, axis=1) / step
                assert (speed <= reach[:, joint] + 1e-4).all()
                worst = max(worst, (speed / np.maximum(reach[:, joint], 1e-9)).max())
    assert worst > 0.3  # the bounds are bounds of this motion and not of anything


def test_the_outer_of_two_hinges_on_one_body_sees_the_inner_one_turn():
    xml = (
        '<mujoco><worldbody><body><joint name="z" axis="0 0 1"/><joint name="x" axis="1 0 0"/>'
        '<geom size="0.01" pos="0 0 1"/></body></worldbody></mujoco>'
    )
    model = mujoco.MjModel.from_xml_string(xml)
    reach = Levers(model).of([1], np.array([[0.0, 0.0, 1.0]]), np.zeros(1))
    assert reach[0, 0] >= 1.0  # turned down by x, the point is a metre from the axis of z
    assert reach[0, 1] == pytest.approx(1.0)


GANTRY = f"""
<mujoco><compiler angle="radian"/><asset><mesh name="m" vertex="{TETRA}"/></asset><worldbody>
<geom name="floor" type="plane" size="2 2 .1"/>
<body name="post" pos="0.2 0 0.12"><geom name="post" type="mesh" mesh="m"/></body>
<body name="rail" pos="0 0 0.4"><joint name="x" type="slide" axis="1 0 0" range="-1 1" limited="true"/>
<geom name="rail" type="box" size=".05 .05 .02"/>
<body name="lift" pos="0 0 -0.05"><joint name="z" type="slide" axis="0 0 1" range="-0.3 0.1" limited="true"/>
<geom name="lift" type="capsule" size=".02 .05"/>
<body name="wrist" pos="0 0 -0.1"><joint name="turn" axis="0 0 1" limited="false"/>
<geom name="tool" type="mesh" mesh="m"/><site name="palm" pos="0 0 -.05"/></body></body></body>
</worldbody></mujoco>"""


@pytest.fixture(scope="module")
def gantry():
    """A gantry of two slides and an endless wrist, meshes for a tool and an obstacle."""
    model = mujoco.MjModel.from_xml_string(GANTRY)
    robot = Robot("gantry", GANTRY, (Arm("tool", "palm", ("x", "z", "turn")),), poses={"stand": {}})
    rng = np.random.default_rng(1)
    time = np.arange(120) * 0.02
    s = np.linspace(0.0, 1.0, 120)
    bump = s**2 * (1.0 - s) ** 2 * 16.0
    q = np.stack([-0.5 + 1.4 * s, 0.13 * bump - 0.1, 8.0 * s], axis=1)
    q += 0.004 * rng.normal(size=q.shape) * np.minimum(1.0, 20.0 * np.minimum(s, 1.0 - s))[:, None]
    data = mujoco.MjData(model)
    initial = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION))
    mujoco.mj_getState(model, data, initial, mujoco.mjtState.mjSTATE_INTEGRATION)
    checker = SceneChecker(model, robot, EnvConfig(), time=time, qpos=q, initial=initial)
    return model, checker, time, q


def test_units_and_endless_joints_are_the_models(gantry):
    _, checker, _, _ = gantry
    assert checker.units == ("m", "m", "rad")
    assert checker.continuous == (2,)


def test_slides_and_meshes_change_no_slack_faster_than_said(gantry):
    _, checker, _, _ = gantry
    rng = np.random.default_rng(0)
    low, high = np.array([-0.9, -0.25, -9.0]), np.array([0.9, 0.05, 9.0])
    one = rng.uniform(low, high, (400, 3))
    two = np.clip(one + 0.05 * rng.normal(size=(400, 3)), low, high)
    time = np.zeros(400)
    first, second = (checker.slack(time, q, 0.0) for q in (one, two))
    near = (first < 0.07) & (second < 0.07)
    assert near.sum() > 50
    allowed = np.abs(two - one) @ checker.reach.T
    assert (np.abs(first - second) <= allowed + 1e-5)[near].all()


def test_check_and_slack_agree_about_meshes(gantry):
    _, checker, _, _ = gantry
    rng = np.random.default_rng(2)
    q = rng.uniform([-0.9, -0.25, -9.0], [0.9, 0.05, 9.0], (500, 3))
    slack = checker.slack(np.zeros(500), q, 0.005).min(axis=1)
    free = checker.check(np.zeros(500), q, 0.005).free
    clear = np.abs(slack) > 1e-5
    assert (free == (slack >= 0.0))[clear].all()
    assert 0.05 < free.mean() < 0.95


def test_a_path_of_slides_past_a_mesh_is_proven(gantry):
    """Held against MuJoCo's own contacts at sixteen samples a knot, asked without the checker."""
    model, checker, time, q = gantry
    assert checker.check(time, q, 0.0).free.all()
    limits = Limits([-1.0, -0.3, -np.inf], [1.0, 0.1, np.inf])
    result = smooth(
        time,
        np.column_stack([q[:, :2], (q[:, 2] + np.pi) % (2.0 * np.pi) - np.pi]),
        checker,
        limits=limits,
        continuous=checker.continuous,
        units=checker.units,
        clearance=0.002,
        max_deviation=[0.05, 0.03, 0.3],
    )
    assert (result.status, result.certified) == ("smoothed", True), result.reason
    assert (result.deviation <= [0.05, 0.03, 0.3]).all()
    data = mujoco.MjData(model)
    for row in result.spline(np.linspace(0.0, time[-1], 16 * len(time))):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        assert not (data.contact.dist < 0.0).any()
    assert result.after.jerk < 0.05 * result.before.jerk


def test_a_slide_leaves_its_way_nowhere(gantry):
    model, checker, _, _ = gantry
    ways = strokes(model)
    assert ways[0, 0] < -1.0 < 1.0 < ways[0, 1]
    assert np.isinf(ways[2]).all()
    verdict = checker.check(np.zeros(1), np.array([[3.0, 0.0, 0.0]]), 0.0)
    assert not verdict.free[0]
    assert checker.describe(int(verdict.what[0])) == "a slide and the end of its way"


def test_the_least_distance_is_that_of_all_slacks(gantry):
    _, checker, time, q = gantry
    fine = np.linspace(0.0, time[-1], 300)
    path = np.stack([np.interp(fine, time, column) for column in q.T], axis=1)
    slack = checker.slack(fine, path, 0.0)
    keeps = (slack - checker.slack(fine, path, 1e-3)).max(axis=0) > 5e-4
    assert checker.nearest(fine, path) == pytest.approx(slack[:, keeps].min(), abs=1e-5)
