"""Kinematics of whole episodes, and the polygons a robot stands on."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from coordlog.errors import FormatError
from coordlog.kinematics.balance import CONTACT_HEIGHT, support_margin
from coordlog.kinematics.geometry import Geometry, Motion, hull
from coordlog.mjcf import compose
from coordlog.sim.settling import settled
from coordlog.tasks.config import EnvConfig
from coordlog.tasks.scene import SCENES


def geometry(name):
    scene = SCENES[name]
    model = mujoco.MjModel.from_xml_string(compose(scene, EnvConfig()).text)
    return Geometry(model, scene.robot, settled(scene.robot, model, "stand")), model


def configurations(model, rng, n):
    """Random angles of all joints, a random base where there is one."""
    qpos = rng.uniform(-0.7, 0.7, (n, model.nq))
    if model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE:
        qpos[:, 3:7] = Rotation.random(n, rng=rng).as_quat(scalar_first=True)
    return qpos


@pytest.mark.parametrize("name", ["table", "shelf", "planar"])
def test_poses_are_those_of_a_plain_forward_pass(name):
    rng = np.random.default_rng(3)
    body, model = geometry(name)
    qpos = configurations(model, rng, 12)
    motion, data = body.motion(qpos), mujoco.MjData(model)
    for t, row in enumerate(qpos):
        data.qpos[:] = row
        mujoco.mj_forward(model, data)
        fixed = [geom.index for geom in body.geoms if geom.place in ("robot", "world")]
        assert_allclose(motion.position[t, fixed], data.geom_xpos[fixed], atol=1e-12)
        turned = Rotation.from_quat(motion.quaternion[t], scalar_first=True).as_matrix()
        assert_allclose(turned[fixed], data.geom_xmat[fixed].reshape(-1, 3, 3), atol=1e-12)
        assert_allclose(motion.com[t], data.subtree_com[1], atol=1e-12)
        palms = [data.site(arm.palm).xpos for arm in SCENES[name].robot.arms]
        assert_allclose(motion.palms[t], palms, atol=1e-12)
    assert_allclose(body.palms(qpos), motion.palms, atol=1e-12)


def test_geoms_know_their_place():
    body, _ = geometry("spheres")
    places = {geom.name: geom.place for geom in body.geoms}
    assert places["chest_0"] == "robot"
    assert places["floor"] == "world"
    assert places["goal_left"] == "goal"
    assert places["object"] == "object"
    assert places["sphere_1"] == "obstacle"
    assert [geom.name for geom in geometry("table")[0].of_place("world")] == ["floor", "table"]


def test_standing_still_the_support_polygon_is_around_both_feet():
    body, model = geometry("free")
    motion = body.motion(settled(SCENES["free"].robot, model, "stand")[None, 1 : 1 + model.nq])
    (polygon,) = motion.support()
    low = motion.corners[0][motion.corners[0][:, 2] < CONTACT_HEIGHT]
    assert len(low) == 8
    assert_allclose(np.sort(polygon[:, 0])[[0, -1]], [low[:, 0].min(), low[:, 0].max()])
    assert 0.02 < support_margin(motion.com[0, :2], motion.corners[0]) < 0.1


@pytest.mark.parametrize("n", [0, 1, 2, 3, 4, 8, 12])
def test_hull_is_scipys(n):
    rng = np.random.default_rng(n)
    points = rng.normal(size=(n, 2))
    corners = hull(points)
    if n < 3:
        assert corners == []
        return
    wanted = ConvexHull(points).vertices.tolist()  # counter-clockwise too
    turn = wanted.index(corners[0])
    assert corners == wanted[turn:] + wanted[:turn]


def test_hull_of_a_line_and_of_doubled_points():
    line = np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0], [2.0, 2.0]])
    assert hull(line) == []
    square = np.array(
        [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.5, 0.0], [0.0, 0.0], [0.5, 0.5]]
    )
    assert_array_equal(
        np.sort(square[hull(square)], axis=0), np.sort([[0, 0], [1, 0], [1, 1], [0, 1]], axis=0)
    )


def test_support_polygons_of_a_motion_are_those_of_each_step():
    rng = np.random.default_rng(9)
    corners = rng.normal(size=(60, 8, 3)) * [1.0, 1.0, 0.001]
    corners[10:30] = corners[10]  # standing still
    corners[15, :, 2] = 1.0  # but for a jump
    corners[40, :6, 2] = 1.0  # on two corners
    motion = Motion(*[np.zeros((60, 1, 3))] * 4, corners)
    for polygon, each in zip(motion.support(), corners, strict=True):
        low = each[each[:, 2] < CONTACT_HEIGHT, :2]
        alone = low[hull(low)]
        assert len(polygon) == len(alone)
        assert {tuple(point) for point in polygon} == {tuple(point) for point in alone}


def test_what_does_not_fit_is_said():
    scene = SCENES["free"]
    model = mujoco.MjModel.from_xml_string(compose(scene, EnvConfig()).text)
    with pytest.raises(FormatError, match=r"expected .* numbers for the attached model"):
        Geometry(model, scene.robot, np.zeros(7))
    noses = replace(scene.robot, arms=tuple(replace(arm, palm="nose") for arm in scene.robot.arms))
    with pytest.raises(FormatError, match="lacks what robot 'humanoid' names"):
        Geometry(model, noses)
