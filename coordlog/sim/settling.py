"""A robot at rest in a start pose, and everything that is wrong with it there."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from coordlog.episode import Array
from coordlog.errors import ConfigError
from coordlog.mjcf import held_controls
from coordlog.robots.robot import Robot
from coordlog.sim.physics import STATE, sole_pairs

SETTLE_SECONDS = 4.0
"""The start pose is simulated this long, so that an episode starts at rest."""
HELD = 0.1
"""A joint of the action this far from where the pose asks for it is not held [rad, m]."""
SUNK = 0.05
"""A base this much lower than it was put down has fallen [m]."""
LEANT = 0.2
"""A base turned by this much has fallen, too [rad]."""
MOVING = 0.1
"""A joint this fast does not rest [rad/s, m/s]."""
LOCKED = 1e4
"""A joint with more damping does not move [N·s/m, N·m·s/rad]."""
FREE, BALL = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)


class Rest(NamedTuple):
    """A robot that stands still in a start pose."""

    row: Array
    """Full mjSTATE_INTEGRATION vector at time zero, (n_state,)."""
    asked: Array
    """qpos that the pose asked for, (n_q,)."""
    resting: list[tuple[int, int]]
    """Pairs of geoms that touch there and that no joint of the action moves apart."""
    touching: list[tuple[int, int]]
    """Pairs of geoms that touch there though they could be apart."""


def settled(robot: Robot, model: mujoco.MjModel, pose: str) -> Array:
    """The full state vector of the robot at rest in a pose, time zero (`settle`)."""
    return settle(robot, model, pose).row


def settle(robot: Robot, model: mujoco.MjModel, pose: str) -> Rest:
    """Set the robot down on its soles in a pose, and simulate it until it stands still.

    Raises:
        ConfigError: if the pose names a joint that is not there, or puts one outside its range.
    """
    data = mujoco.MjData(model)
    _pose(robot, model, data, pose)
    data.ctrl[:] = held_controls(model, data.qpos, robot, pose)
    mujoco.mj_kinematics(model, data)
    if robot.soles:
        lowest = min(
            data.site_xpos[i, 2] for i in range(model.nsite) if "_corner_" in model.site(i).name
        )
        data.qpos[2] -= lowest
    asked = data.qpos.copy()
    for _ in range(round(SETTLE_SECONDS / model.opt.timestep)):
        mujoco.mj_step(model, data)
    data.time = 0.0
    row = np.empty(mujoco.mj_stateSize(model, STATE))
    mujoco.mj_getState(model, data, row, STATE)
    mujoco.mj_forward(model, data)
    resting, touching = _contacts(robot, model, data)
    return Rest(row, asked, resting, touching)


def _pose(robot: Robot, model: mujoco.MjModel, data: mujoco.MjData, pose: str) -> None:
    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, pose)
    if key >= 0:
        data.qpos[:] = model.key_qpos[key]
    for name, angle in robot.poses[pose].items():
        joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
        if joint < 0:
            raise ConfigError(
                f"robot '{robot.name}': its pose '{pose}' names a joint '{name}' that its model "
                "lacks"
            )
        low, high = model.jnt_range[joint]
        if model.jnt_limited[joint] and not low <= angle <= high:
            raise ConfigError(
                f"robot '{robot.name}': its pose '{pose}' has {name} at {angle:g} rad, outside its "
                f"range {low:g} to {high:g}"
            )
        data.qpos[model.jnt_qposadr[joint]] = angle


def moving(model: mujoco.MjModel, body: int) -> set[int]:
    """Joints that move a body: its own and those of all bodies above it."""
    found: set[int] = set()
    while body:
        first = int(model.body_jntadr[body])
        found.update(range(first, first + int(model.body_jntnum[body])))
        body = int(model.body_parentid[body])
    return found


def _contacts(
    robot: Robot, model: mujoco.MjModel, data: mujoco.MjData
) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Pairs that touch: those that no joint of the action moves apart, and the others."""
    action = {model.joint(name).id for name in robot.action_joints}
    soles = sole_pairs(model)
    resting: set[tuple[int, int]] = set()
    touching: set[tuple[int, int]] = set()
    for contact in data.contact:
        first, second = int(contact.geom1), int(contact.geom2)
        pair = (min(first, second), max(first, second))
        if contact.dist > 0.0 or pair[0] < 0 or soles[pair]:
            continue
        one, other = (moving(model, int(model.geom_bodyid[geom])) & action for geom in pair)
        (touching if one ^ other else resting).add(pair)
    return sorted(resting), sorted(touching)


def faults(robot: Robot, model: mujoco.MjModel, pose: str, rest: Rest) -> list[str]:
    """What is wrong with the robot's spec or with how it stands, one sentence each."""
    return _tree(robot, model) + (_base(robot, model) or _held(robot, model, pose, rest))


def _base(robot: Robot, model: mujoco.MjModel) -> list[str]:
    palm = moving(model, int(model.site(robot.arms[0].palm).bodyid[0]))
    free = [joint for joint in palm if model.jnt_type[joint] == FREE]
    if free and not robot.soles and model.opt.gravity.any():
        return [
            "it has a free base and no soles, so it would fall: name the geoms it stands on as "
            "soles, "
            "or take the free joint out"
        ]
    return []


def _tree(robot: Robot, model: mujoco.MjModel) -> list[str]:
    """Palms that their joints do not move, or another arm's joints do."""
    said = []
    for arm in robot.arms:
        movers = {
            model.joint(joint).name for joint in moving(model, int(model.site(arm.palm).bodyid[0]))
        }
        idle = [name for name in arm.joints if name not in movers]
        if idle:
            said.append(
                f"palm '{arm.palm}' of arm '{arm.name}' is not moved by {_list(idle)}, which the "
                "arm names as its own: "
                "expected a palm at the arm's end"
            )
        for other in robot.arms:
            strange = [name for name in other.joints if name in movers and other is not arm]
            if strange:
                said.append(
                    f"palm '{arm.palm}' of arm '{arm.name}' is moved by {_list(strange)} of arm "
                    f"'{other.name}': "
                    "a joint that moves several palms is shared"
                )
        apart = [name for name in robot.shared if name not in movers]
        if apart:
            said.append(
                f"palm '{arm.palm}' of arm '{arm.name}' is not moved by {_list(apart)}, which the "
                "robot names as shared by all"
            )
    return said


def _held(robot: Robot, model: mujoco.MjModel, pose: str, rest: Rest) -> list[str]:
    """Joints and a base that are not where the pose asked for them."""
    qpos, said = rest.row[1 : 1 + model.nq], []
    if not np.isfinite(qpos).all():
        return [f"pose '{pose}' is not held: the simulation diverges before {SETTLE_SECONDS:g} s"]
    free = np.flatnonzero(model.jnt_type == FREE)
    palms = moving(model, int(model.site(robot.arms[0].palm).bodyid[0]))
    for joint in (int(joint) for joint in free if int(joint) in palms):
        at = int(model.jnt_qposadr[joint])
        sunk = float(rest.asked[at + 2] - qpos[at + 2])
        same = abs(float(rest.asked[at + 3 : at + 7] @ qpos[at + 3 : at + 7]))
        turned = 2.0 * float(np.arccos(min(1.0, same)))
        if sunk > SUNK or turned > LEANT:
            return [
                f"pose '{pose}' is not held: after {SETTLE_SECONDS:g} s the base is "
                f"{sunk * 100:.0f} cm lower and has "
                f"turned by {np.degrees(turned):.0f}°: expected a robot that stands; stiffen its "
                "servos or choose another pose"
            ]
    speed = np.abs(rest.row[1 + model.nq : 1 + model.nq + model.nv])
    named = set(robot.action_joints)
    for joint in sorted(palms - set(free.tolist())):
        name = model.joint(joint).name or f"joint {joint}"
        first = int(model.jnt_dofadr[joint])
        last = first + (3 if model.jnt_type[joint] == BALL else 1)
        if name not in named and (speed[first:last] > MOVING).any():
            said.append(
                f"pose '{pose}' is not held: joint '{name}', which carries a palm and is not of "
                "the action, still moves after "
                f"{SETTLE_SECONDS:g} s; give it a servo, or take it out"
            )
    for name in robot.action_joints:
        at = int(model.joint(name).qposadr[0])
        if abs(qpos[at] - rest.asked[at]) > HELD:
            slide = model.joint(name).type[0] == mujoco.mjtJoint.mjJNT_SLIDE
            unit = "m" if slide else "rad"
            said.append(
                f"pose '{pose}' is not held: joint '{name}' was asked to be at "
                f"{rest.asked[at]:.3f} {unit} and came to rest "
                f"at {qpos[at]:.3f} {unit}; {_tied(model, name)}stiffen its servo or choose "
                "another pose"
            )
    return said


def _tied(model: mujoco.MjModel, name: str) -> str:
    """What an equality of the model ties a joint to, as the beginning of a sentence."""
    joint, found = model.joint(name).id, []
    for tie in np.flatnonzero(model.eq_active0 & (model.eq_type == mujoco.mjtEq.mjEQ_JOINT)):
        pair = [int(model.eq_obj1id[tie]), int(model.eq_obj2id[tie])]
        if joint in pair:
            other = pair[1 - pair.index(joint)]
            found.append(f"'{model.joint(other).name}'" if other >= 0 else "a fixed place")
    return f"an equality ties it to {' and '.join(found)}: leave it out of the action, or " * bool(
        found
    )


def _list(names: list[str]) -> str:
    return ", ".join(f"'{name}'" for name in names)
