"""Servos by what they are: an actuator that pulls one joint towards an angle, whatever its name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import mujoco
import numpy as np

from coordlog.episode import Array
from coordlog.errors import ConfigError
from coordlog.robots.robot import Robot

JOINT_DRIVES = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
SLIDE, HINGE = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)
LAGS = (
    int(mujoco.mjtDyn.mjDYN_NONE),
    int(mujoco.mjtDyn.mjDYN_FILTER),
    int(mujoco.mjtDyn.mjDYN_FILTEREXACT),
)
"""Dynamics after which an actuator's activation comes to rest at its control."""


def is_servo(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether an actuator is a position servo of one joint: force k (u - q) - …, u in the joint's
    own units.
    """
    gain, bias = model.actuator_gainprm[actuator, 0], model.actuator_biasprm[actuator, 1]
    return bool(
        int(model.actuator_trntype[actuator]) in JOINT_DRIVES
        and model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
        and model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_AFFINE
        and int(model.actuator_dyntype[actuator]) in LAGS
        and model.actuator_gear[actuator, 0] == 1.0
        and gain == -bias != 0.0
    )


def servos_of(model: mujoco.MjModel, joints: Sequence[int]) -> list[int]:
    """The position servo of each joint, by what drives it; -1 where there is none."""
    driven = {
        int(model.actuator_trnid[i, 0]): i for i in reversed(range(model.nu)) if is_servo(model, i)
    }
    return [driven.get(int(joint), -1) for joint in joints]


def actuator_label(model: mujoco.MjModel, actuator: int) -> str:
    """An actuator's name, or its number where it has none."""
    return model.actuator(actuator).name or f"actuator {actuator}"


def held_controls(model: mujoco.MjModel, qpos: Array, robot: Robot, pose: str) -> Array:
    """What every actuator is given while the robot is held in a pose, (n_c,): servos their joints'
    positions, all others what the robot's spec says, else the control of the keyframe of that name
    or of the first there is, else the control at which they do not pull.
    """
    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, pose)
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_fwdPosition(model, data)
    ctrl = np.zeros(model.nu)
    for i in range(model.nu):
        name = actuator_label(model, i)
        if is_servo(model, i):
            ctrl[i] = qpos[model.jnt_qposadr[model.actuator_trnid[i, 0]]]
        elif name in robot.held:
            ctrl[i] = robot.held[name]
        elif model.nkey:
            ctrl[i] = model.key_ctrl[max(key, 0), i]
        else:
            ctrl[i] = _idle(model, i, float(data.actuator_length[i]))
    return np.asarray(ctrl)


def _idle(model: mujoco.MjModel, actuator: int, length: float) -> float:
    """The control at which an actuator makes no force at rest, within its range; 0 for a motor."""
    gain, bias = model.actuator_gainprm[actuator, 0], model.actuator_biasprm[actuator]
    if model.actuator_dyntype[actuator] not in LAGS:
        return 0.0  # an integrator's control is a speed
    if model.actuator_biastype[actuator] != mujoco.mjtBias.mjBIAS_AFFINE or not gain:
        return 0.0
    control = -(bias[0] + bias[1] * length) / gain
    if model.actuator_ctrllimited[actuator]:
        control = np.clip(control, *model.actuator_ctrlrange[actuator])
    return float(control)


def make_servos(spec: mujoco.MjSpec, robot: Robot) -> list[str]:
    """Give every joint of the action a position servo in its own units, and every motor and every
    joint that the robot's gains name.

    Returns:
        One sentence for each joint that has none and gets none.
    """
    faults = []
    drives = [act for act in spec.actuators if int(act.trntype) in JOINT_DRIVES]
    for joint in spec.joints:
        own = [act for act in drives if act.target == joint.name]
        served = sum(_normalised(act) for act in own)
        if served > 1 and joint.name in robot.action_joints:
            faults.append(
                f"joint '{joint.name}' has {served} position servos, which would pull against one "
                "another: expected one"
            )
        if served or joint.type not in (HINGE, SLIDE):
            continue
        gains = robot.gains(joint.name)
        wanted = own or joint.name in robot.action_joints or joint.name in robot.servo_gains
        if gains is not None and wanted:
            _serve(spec, joint, own[0] if own else None, gains)
            if spec.option.integrator == mujoco.mjtIntegrator.mjINT_EULER:
                # MuJoCo's default lets a stiff servo on a light link diverge.
                spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        elif joint.name in robot.action_joints:
            faults.append(_without(joint.name, own))
    return faults


def _normalised(act: mujoco._specs.MjsActuator) -> bool:
    """Whether it is a position servo; one with a gear or with other units than its joint's is
    written anew as one without, that makes the same force.
    """
    k, bias, gear = act.gainprm[0], act.biasprm[1], act.gear[0]
    if (
        act.gaintype != mujoco.mjtGain.mjGAIN_FIXED
        or act.biastype != mujoco.mjtBias.mjBIAS_AFFINE
        or int(act.dyntype) not in LAGS
        or not (k and bias < 0 and gear)
    ):
        return False
    if k == -bias and gear == 1.0 and act.biasprm[0] == 0.0:
        return True
    stiffness = -bias * gear * gear
    to_joint = np.sort((np.array(act.ctrlrange) * k + act.biasprm[0]) / (-bias * gear))
    act.forcerange = np.sort(np.array(act.forcerange) * gear)
    act.ctrlrange = to_joint
    act.gainprm[0] = stiffness
    damping = act.biasprm[2]  # above 0 it is a damping ratio, which no gear changes
    act.biasprm[:3] = (0.0, -stiffness, damping if damping > 0 else damping * gear * gear)
    act.gear = [1.0, 0, 0, 0, 0, 0]
    return True


def _serve(
    spec: mujoco.MjSpec,
    joint: mujoco._specs.MjsJoint,
    motor: mujoco._specs.MjsActuator | None,
    gains: tuple[float, float],
) -> None:
    """Put a position servo in a motor's place, or where there was none; the motor's limits stay."""
    limit = None
    if motor is None:
        motor = spec.add_actuator(name=free_name(spec.actuator, joint.name))
    else:
        force = _force(motor)
        limit = None if force is None else np.sort(force * motor.gear[0])
    kp, kv = gains
    motor.trntype, motor.target = mujoco.mjtTrn.mjTRN_JOINT, joint.name
    motor.gear = [1.0, 0, 0, 0, 0, 0]
    motor.dyntype = mujoco.mjtDyn.mjDYN_NONE
    motor.gaintype, motor.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
    motor.gainprm, motor.biasprm = np.zeros(len(motor.gainprm)), np.zeros(len(motor.biasprm))
    motor.set_to_position(kp, kv=kv)
    motor.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE
    motor.ctrlrange = [0.0, 0.0]
    motor.actlimited = mujoco.mjtLimited.mjLIMITED_FALSE
    motor.forcelimited = (
        mujoco.mjtLimited.mjLIMITED_FALSE if limit is None else mujoco.mjtLimited.mjLIMITED_TRUE
    )
    motor.forcerange = [0.0, 0.0] if limit is None else limit


def free_name(lookup: Callable[[str], Any], name: str) -> str:
    """A name that nothing of a kind has yet: this one, or with a number behind it."""
    i = 0
    while lookup(name if not i else f"{name}_{i}") is not None:
        i += 1
    return name if not i else f"{name}_{i}"


def _force(motor: mujoco._specs.MjsActuator) -> Array | None:
    """The range of a motor's force before its gear, None if it has none."""
    force, ctrl = np.array(motor.forcerange), np.array(motor.ctrlrange)
    if force[0] < force[1] and motor.forcelimited != mujoco.mjtLimited.mjLIMITED_FALSE:
        return force
    plain = motor.gaintype == mujoco.mjtGain.mjGAIN_FIXED
    if plain and ctrl[0] < ctrl[1] and motor.ctrllimited != mujoco.mjtLimited.mjLIMITED_FALSE:
        return np.sort(ctrl * (motor.gainprm[0] or 1.0))
    return None


def _without(joint: str, own: Sequence[mujoco._specs.MjsActuator]) -> str:
    name = f" '{own[0].name}'" if own and own[0].name else ""
    what = f"its actuator{name} is a {_kind(own[0])}" if own else "it has no actuator"
    return (
        f"joint '{joint}' has no position servo, {what}: expected one for every joint of the "
        "action; say gains, "
        f"servo_gains={{'{joint}': (kp, kv)}} in the Robot or [servo_gains] in its card, and it "
        "gets one"
    )


def _kind(act: mujoco._specs.MjsActuator) -> str:
    if act.gaintype != mujoco.mjtGain.mjGAIN_FIXED:
        return "muscle or another actuator of varying gain"
    if int(act.dyntype) not in LAGS:
        return "servo of a velocity that is integrated"
    if act.biastype == mujoco.mjtBias.mjBIAS_AFFINE and act.biasprm[2]:
        return "velocity servo"
    return "torque motor"


def require_servos(model: mujoco.MjModel, robot: Robot) -> list[int]:
    """The servos of the action's joints, in order.

    Raises:
        ConfigError: naming the first joint that is not there or has none.
    """
    names, kind = robot.action_joints, mujoco.mjtObj.mjOBJ_JOINT
    joints = [mujoco.mj_name2id(model, kind, name) for name in names]
    found = servos_of(model, joints)
    for name, joint, servo in zip(names, joints, found, strict=True):
        if joint < 0:
            raise ConfigError(
                f"robot '{robot.name}': its spec names a joint '{name}' that its model lacks"
            )
        if servo < 0:
            raise ConfigError(f"robot '{robot.name}': {_without(name, [])}")
    return found
