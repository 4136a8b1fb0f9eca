"""Inverse kinematics and what it calls legal, against plain MuJoCo calls."""

import mujoco
import numpy as np
import pytest

from coordlog.kinematics.ik import Reach
from coordlog.sim.env import BatchEnv
from coordlog.tasks.scene import SCENES


@pytest.fixture(scope="module")
def table():
    return BatchEnv(SCENES["table"], n=1, threads=1)


@pytest.fixture(scope="module")
def spheres():
    return BatchEnv(SCENES["spheres"], n=1, threads=1)


def posture(env, **degrees):
    """Action angles from the named joints' degrees."""
    names = env.scene.robot.action_joints
    angles = np.zeros(len(names))
    for name, value in degrees.items():
        angles[names.index(name)] = np.radians(value)
    return angles


def test_solves_for_what_forward_kinematics_says(table):
    reach, rng = table.draw.reach, np.random.default_rng(0)
    for _ in range(20):
        centre = rng.uniform([0.22, -0.10, 0.50], [0.36, 0.10, 0.50])
        goals = centre + np.array([[0, 0.06, 0], [0, -0.06, 0]])
        angles = reach.solve(goals)
        assert angles is not None
        assert np.abs(reach.palms(angles) - goals).max() < 0.002
        assert reach.legal(angles)


def test_stays_near_its_seed(table):
    reach, goals = table.draw.reach, np.array([[0.3, 0.06, 0.6], [0.3, -0.06, 0.6]])
    home = Reach.angles_of(table.scene.robot, "home")
    near = reach.descend(goals, home)
    again = reach.descend(goals, near)
    assert np.abs(again - near).max() < 1e-9  # already there
    assert np.abs(near - home).max() < 1.5


def test_what_is_out_of_reach_has_no_solution(table):
    assert table.draw.reach.solve(np.array([[1.0, 0.1, 0.6], [1.0, -0.1, 0.6]])) is None


def test_a_goal_inside_the_table_has_no_legal_solution(table):
    assert table.draw.reach.solve(np.array([[0.30, 0.06, 0.43], [0.30, -0.06, 0.43]])) is None


def test_hands_in_the_table_touch_and_home_does_not(table):
    reach = table.draw.reach
    assert not reach.touches(Reach.angles_of(table.scene.robot, "home"))
    low = posture(table, l_shoulder_y=-45, r_shoulder_y=-45, l_shoulder_x=10, r_shoulder_x=-10)
    assert reach.touches(low)
    assert not reach.legal(low)


def nearest_free(reach, angles, *, clearance):
    """How close a sphere of 5 cm may come to the left palm from ahead, to a millimetre [m]."""
    palm, far = reach.palms(angles)[0], [[2.0, 0, 0, 0.03]] * 2
    for distance in np.arange(0.15, 0.0, -0.001):
        reach.place(np.vstack([np.append(palm + np.array([distance, 0, 0]), 0.05), far]))
        if reach.touches(angles, clearance=clearance):
            return distance
    return 0.0


def test_clearance_is_kept_from_obstacles(spheres):
    reach, angles = spheres.draw.reach, spheres.draw.reach.standing_angles
    touch = nearest_free(reach, angles, clearance=0.0)
    assert 0.05 < touch < 0.08  # sphere and hand
    assert nearest_free(reach, angles, clearance=0.01) == pytest.approx(touch + 0.01, abs=0.002)
    assert nearest_free(reach, angles, clearance=0.02) == pytest.approx(touch + 0.02, abs=0.002)


def test_the_size_of_a_placed_sphere_counts(spheres):
    reach, angles = spheres.draw.reach, spheres.draw.reach.standing_angles
    ahead, far = reach.palms(angles)[0] + np.array([0.07, 0, 0]), [[2.0, 0, 0, 0.03]] * 2
    for radius, touches in ((0.03, False), (0.06, True), (0.03, False)):
        reach.place(np.vstack([np.append(ahead, radius), far]))
        assert reach.touches(angles) == touches
    reach.place(
        np.vstack([np.append(ahead + np.array([0.09, 0, 0]), 0.15), far])
    )  # larger than any the scene draws
    assert reach.touches(angles)


def test_leaning_far_back_is_not_legal(table):
    reach = table.draw.reach
    leaning = posture(
        table,
        abs_y=-12,
        bust_y=-27,
        l_shoulder_y=60,
        r_shoulder_y=60,
        l_shoulder_x=20,
        r_shoulder_x=-20,
    )
    forward = posture(table, abs_y=50, bust_y=67, l_shoulder_x=60, r_shoulder_x=-60)
    assert reach.legal(reach.standing_angles)
    assert not reach.touches(leaning)
    data = mujoco.MjData(table.task.model)
    for angles in (leaning, forward):
        data.qpos[:] = table._rest[1 : 1 + table.task.model.nq]
        data.qpos[table.task.qpos_index] = angles
        mujoco.mj_forward(table.task.model, data)
        x = data.sensor("com").data[0]
        inside = -0.0375 + 0.01 < x < 0.1055 - 0.01
        assert reach.legal(angles) == (inside and not reach.touches(angles))


def test_a_straight_path_through_the_table_is_not_free(table):
    reach, home = table.draw.reach, Reach.angles_of(table.scene.robot, "home")
    assert not reach.free(reach.standing_angles, home, clearance=0.0)
    assert reach.free(home, home + 0.01, clearance=0.0)
