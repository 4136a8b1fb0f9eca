"""The humanoid against the table of facts it was written from, and against plain physics: it
stands, and it falls when it should."""

from copy import copy

import mujoco
import numpy as np
import pytest

from coordlog.mjcf import compile_model, compose
from coordlog.robots.humanoid import HUMANOID
from coordlog.sim.settling import settled
from coordlog.tasks.config import EnvConfig
from coordlog.tasks.scene import find

MOTORS = {
    "MX-28": (100.0, 2.5),
    "MX-64": (240.0, 6.0),
    "AX-12": (60.0, 1.5),
}  # kp [N·m/rad], stall torque at 12 V [N·m]

# body, parent, joint, axis, origin in the parent [m], range [deg], mass [kg], motor: measured on
# Poppy, both sides written out
# fmt: off
TABLE = (
    ("pelvis", "", "", "", (0, 0, .446), (0, 0), .21115, ""),
    ("abs_motors", "pelvis", "abs_y", "y", (.017, 0, .061), (-12, 50), .31759, "MX-64"),
    ("abdomen", "abs_motors", "abs_x", "x", (0, 0, 0), (-45, 45), .0438, "MX-64"),
    ("spine", "abdomen", "abs_z", "z", (0, 0, .05164), (-90, 90), .10569, "MX-28"),
    ("bust_motors", "spine", "bust_y", "y", (.0028, 0, .07985), (-27, 67), .18127, "MX-28"),
    ("chest", "bust_motors", "bust_x", "x", (0, 0, 0), (-40, 40), .31405, "MX-28"),
    ("neck", "chest", "head_z", "z", (.005, 0, .084), (-90, 90), .00671, "AX-12"),
    ("head", "neck", "head_y", "y", (0, 0, .02), (-26, 25), .24254, "AX-12"),
    ("l_shoulder", "chest", "l_shoulder_y", "y", (.004, .0771, .05), (-210, 65), .00956, "MX-28"),
    ("l_shoulder_motor", "l_shoulder", "l_shoulder_x", "x", (0, .0284, 0), (-20, 195), .09455, "MX-28"),
    ("l_upper_arm", "l_shoulder_motor", "l_arm_z", "z", (-.0185, 0, -.03625), (-105, 105), .19182, "MX-28"),
    ("l_forearm", "l_upper_arm", "l_elbow_y", "y", (.01, 0, -.11175), (-148, 1), .05548, "MX-28"),
    ("r_shoulder", "chest", "r_shoulder_y", "y", (.004, -.0771, .05), (-210, 65), .00956, "MX-28"),
    ("r_shoulder_motor", "r_shoulder", "r_shoulder_x", "x", (0, -.0284, 0), (-195, 20), .09455, "MX-28"),
    ("r_upper_arm", "r_shoulder_motor", "r_arm_z", "z", (-.0185, 0, -.03625), (-105, 105), .19182, "MX-28"),
    ("r_forearm", "r_upper_arm", "r_elbow_y", "y", (.01, 0, -.11175), (-148, 1), .05548, "MX-28"),
    ("l_hip", "pelvis", "l_hip_x", "x", (0, .02254, 0), (-28.5, 30), .09621, "MX-28"),
    ("l_hip_motor", "l_hip", "l_hip_z", "z", (.005, .044, 0), (-90, 25), .15798, "MX-28"),
    ("l_thigh", "l_hip_motor", "l_hip_y", "y", (0, 0, -.024), (-104, 84), .13814, "MX-64"),
    ("l_shin", "l_thigh", "l_knee_y", "y", (0, 0, -.182), (-3.5, 134), .12742, "MX-28"),
    ("l_ankle", "l_shin", "l_ankle_y", "y", (0, 0, -.18), (-45, 45), .11408, "MX-28"),
    ("l_foot", "l_ankle", "l_ankle_x", "x", (0, -.0225, -.025), (-30, 30), .05335, "MX-28"),
    ("r_hip", "pelvis", "r_hip_x", "x", (0, -.02254, 0), (-30, 28.5), .09621, "MX-28"),
    ("r_hip_motor", "r_hip", "r_hip_z", "z", (.005, -.044, 0), (-25, 90), .15798, "MX-28"),
    ("r_thigh", "r_hip_motor", "r_hip_y", "y", (0, 0, -.024), (-104, 84), .13814, "MX-64"),
    ("r_shin", "r_thigh", "r_knee_y", "y", (0, 0, -.182), (-3.5, 134), .12742, "MX-28"),
    ("r_ankle", "r_shin", "r_ankle_y", "y", (0, 0, -.18), (-45, 45), .11408, "MX-28"),
    ("r_foot", "r_ankle", "r_ankle_x", "x", (0, .0225, -.025), (-30, 30), .05335, "MX-28"),
)
# fmt: on
PALM = (0, 0.006, -0.160)  # in the left forearm [m]; the right one's is its mirror image
JOINTS = [row for row in TABLE if row[2]]


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(HUMANOID.mjcf)


@pytest.fixture(scope="module")
def standing():
    """The robot on the floor, and its full state at rest in the stand pose."""
    model = compile_model(compose(find("free"), EnvConfig()))
    return model, settled(HUMANOID, model, "stand")


def at(model, state):
    """Fresh data in a state."""
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
    mujoco.mj_forward(model, data)
    return data


def turn(axis, angle):
    """Rotation matrix about a coordinate axis."""
    i = "xyz".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    R = np.eye(3)
    R[j, j] = R[k, k] = np.cos(angle)
    R[k, j], R[j, k] = np.sin(angle), -np.sin(angle)
    return R


def forward(angles, base):
    """Position and rotation of every body, from the table alone."""
    frames = {"": base}
    for body, parent, joint, axis, origin, *_ in TABLE:
        place, R = frames[parent]
        frames[body] = (place + R @ origin, R @ turn(axis, angles[joint]) if joint else R)
    return frames


def random_angles(rng):
    return {joint: rng.uniform(*np.radians(limits)) for _, _, joint, _, _, limits, *_ in JOINTS}


def set_angles(model, data, angles):
    for joint, angle in angles.items():
        data.qpos[model.joint(joint).qposadr[0]] = angle
    mujoco.mj_forward(model, data)


def mirrored(angles):
    """The same posture with left and right exchanged: roll and yaw change sign."""
    other = {"l_": "r_", "r_": "l_"}
    axes = {row[2]: row[3] for row in JOINTS}
    return {
        other.get(name[:2], name[:2]) + name[2:]: angle if axes[name] == "y" else -angle
        for name, angle in angles.items()
    }


def test_has_27_joints_a_free_base_and_a_servo_each(model):
    assert model.nv == 27 + 6
    assert model.nu == 27
    assert model.njnt == 28
    assert {model.joint(i).name for i in range(28)} == {row[2] for row in JOINTS} | {"base"}
    assert [model.actuator(i).name for i in range(27)] == [
        model.joint(model.actuator(i).trnid[0]).name for i in range(27)
    ]


def test_weighs_three_and_a_half_kilograms_link_by_link(model):
    assert model.body_mass.sum() == pytest.approx(3.50, abs=0.001)
    for body, *_, mass, _ in TABLE:
        assert model.body(body).mass[0] == pytest.approx(mass, abs=1e-9), body


def test_stands_84_centimetres_high(model):
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    head = model.geom("head_0").id
    top = data.geom_xpos[head, 2] + model.geom_size[head, 2]
    soles = [
        data.geom_xpos[model.geom(sole).id, 2] - model.geom(sole).size[2] for sole in HUMANOID.soles
    ]
    assert max(soles) == pytest.approx(0.0, abs=1e-9)
    assert top - min(soles) == pytest.approx(0.84, abs=0.001)


def test_joint_ranges_and_motors_are_the_tables(model):
    for _, _, joint, axis, _, limits, _, motor in JOINTS:
        kp, torque = MOTORS[motor]
        assert model.joint(joint).range == pytest.approx(np.radians(limits), abs=1e-9), joint
        assert model.joint(joint).axis.tolist() == [float(axis == name) for name in "xyz"]
        servo = model.actuator(joint)
        assert servo.forcerange.tolist() == [-torque, torque], joint
        assert (servo.gainprm[0], servo.biasprm[1]) == (kp, -kp), joint
        assert servo.ctrlrange == pytest.approx(model.joint(joint).range), joint


def test_forward_kinematics_at_random_postures(model):
    rng, data = np.random.default_rng(0), mujoco.MjData(model)
    for _ in range(50):
        angles, place = random_angles(rng), rng.normal(size=3)
        quat = rng.normal(size=4)
        quat /= np.linalg.norm(quat)
        data.qpos[:3], data.qpos[3:7] = place, quat
        set_angles(model, data, angles)
        R = np.zeros(9)
        mujoco.mju_quat2Mat(R, quat)
        frames = forward(angles, (place - R.reshape(3, 3) @ TABLE[0][4], R.reshape(3, 3)))
        for body, (origin, rotation) in list(frames.items())[1:]:
            assert data.body(body).xpos == pytest.approx(origin, abs=1e-9), body
            assert data.body(body).xmat == pytest.approx(rotation.ravel(), abs=1e-9), body
        for side, sign in (("left", 1), ("right", -1)):
            origin, rotation = frames[f"{side[0]}_forearm"]
            palm = origin + rotation @ (PALM[0], sign * PALM[1], PALM[2])
            assert data.site(f"{side}_palm").xpos == pytest.approx(palm, abs=1e-9)


def test_left_and_right_are_mirror_images(model):
    rng, mirror = np.random.default_rng(1), np.array([1, -1, 1])
    one, other = mujoco.MjData(model), mujoco.MjData(model)
    for _ in range(10):
        angles = random_angles(rng)
        set_angles(model, one, angles)
        set_angles(model, other, mirrored(angles))
        assert other.site("right_palm").xpos == pytest.approx(
            one.site("left_palm").xpos * mirror, abs=1e-12
        )
        assert other.site("left_palm").xpos == pytest.approx(
            one.site("right_palm").xpos * mirror, abs=1e-12
        )
        assert other.body("r_foot").xpos == pytest.approx(
            one.body("l_foot").xpos * mirror, abs=1e-12
        )
        assert other.subtree_com[1] == pytest.approx(one.subtree_com[1] * mirror, abs=1e-12)


def test_masses_and_inertias_of_the_sides_are_mirror_images(model):
    for body, *_ in TABLE:
        if body.startswith("l_"):
            left, right = model.body(body), model.body("r_" + body[2:])
            assert right.mass == left.mass
            assert right.ipos.tolist() == [left.ipos[0], -left.ipos[1], left.ipos[2]]
            assert right.inertia == pytest.approx(left.inertia, rel=1e-9)


def test_limits_of_the_sides_are_mirror_images(model):
    for _, _, joint, axis, *_ in JOINTS:
        if joint.startswith("l_"):
            low, high = model.joint(joint).range
            other = model.joint("r_" + joint[2:]).range.tolist()
            assert other == ([low, high] if axis == "y" else [-high, -low]), joint


@pytest.mark.parametrize("pose", ["neutral", "stand", "home"])
def test_touches_nothing_in_its_poses(model, pose):
    data = mujoco.MjData(model)
    set_angles(model, data, dict(HUMANOID.poses[pose]))
    assert data.ncon == 0


def test_poses_are_within_the_limits(model):
    for pose, joints in HUMANOID.poses.items():
        for joint, angle in joints.items():
            low, high = model.joint(joint).range
            assert low <= angle <= high, f"{pose}: {joint}"


def test_an_arm_pressed_against_the_hips_is_a_contact(model):
    data = mujoco.MjData(model)
    set_angles(model, data, {"l_shoulder_x": np.radians(-20)})
    pairs = {tuple(sorted((model.geom(a).name, model.geom(b).name))) for a, b in data.contact.geom}
    assert ("l_forearm_0", "pelvis_0") in pairs


def test_stands_for_ten_seconds(standing):
    model, state = standing
    data = at(model, state)
    height = data.qpos[2]
    for _ in range(round(10 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    assert data.qpos[2] == pytest.approx(height, abs=1e-3)
    assert np.abs(data.qvel).max() < 1e-2
    assert data.sensor("upright").data[2] > np.cos(np.radians(3))


def lowest(model, state, *, velocity, seconds=2.0):
    """How low the base gets after a kick [m]."""
    data = at(model, state)
    data.qvel[:2] += velocity
    height = np.inf
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
        height = min(height, data.qpos[2])
    return height


def test_keeps_its_feet_when_nudged_and_falls_when_pushed_hard(standing):
    assert lowest(*standing, velocity=(0.1, 0.0)) > 0.4
    assert lowest(*standing, velocity=(0.0, 0.2)) > 0.4
    assert lowest(*standing, velocity=(-1.0, 0.0)) < 0.25
    assert lowest(*standing, velocity=(0.0, 1.2)) < 0.25


def test_falls_when_its_legs_go_limp(standing):
    limp, state = copy(standing[0]), standing[1]
    for i in range(limp.nu):
        if any(part in limp.actuator(i).name for part in ("hip", "knee", "ankle")):
            limp.actuator_forcerange[i] = 0.0
    assert lowest(limp, state, velocity=(0.0, 0.0)) < 0.3


def test_no_servo_gives_more_than_its_stall_torque(standing):
    model, state = standing
    data, rng = at(model, state), np.random.default_rng(0)
    joints = {row[2]: MOTORS[row[7]][1] for row in JOINTS}
    limit = np.array([joints[model.actuator(i).name] for i in range(model.nu)])
    dofs = model.jnt_dofadr[model.actuator_trnid[:, 0]]
    most = np.zeros(model.nu)
    for _ in range(20):
        data.ctrl[:] = rng.uniform(*model.actuator_ctrlrange.T)
        for _ in range(50):
            mujoco.mj_step(model, data)
            most = np.maximum(most, np.abs(data.qfrc_actuator[dofs]))
    assert (most <= limit + 1e-12).all()
    assert (most == limit).sum() > 10  # the limits are what held them back, not gentle commands


def test_standing_asks_little_of_the_servos(standing):
    model, state = standing
    assert (np.abs(at(model, state).actuator_force) < 0.25 * model.actuator_forcerange[:, 1]).all()
