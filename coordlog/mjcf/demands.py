"""What a robot's spec and a model ask for that cannot be had, one sentence each."""

from __future__ import annotations

import re
from collections.abc import Iterable

import mujoco

from coordlog.robots.robot import Robot

CONTROL = re.compile(r"[\x00-\x1f\x7f]")
CONTACT = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
ACTUATION = int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
SENSOR = int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
BODY = int(mujoco.mjtObj.mjOBJ_BODY)
SLEEP = int(mujoco.mjtEnableBit.mjENBL_SLEEP)


def unknown_names(spec: mujoco.MjSpec, robot: Robot) -> list[str]:
    """Joints and actuators that the robot's tables name and its model does not have."""
    joints = {joint.name for joint in spec.joints}
    actuators = {act.name or f"actuator {i}" for i, act in enumerate(spec.actuators)}
    every = (spec.bodies, spec.joints, spec.geoms, spec.sites, spec.actuators)
    said = [
        f"its model has the name {thing.name!r}, with a line break or another control character "
        "in it: give it another"
        for things in every
        for thing in things
        if CONTROL.search(thing.name)
    ]
    said += [
        f"arm '{arm.name}' has no joints: expected those that move its palm"
        for arm in robot.arms
        if not arm.joints and not robot.shared
    ]
    for table, names, kind, known in (
        ("servo_gains", robot.servo_gains, "joint", joints | {"*"}),
        ("ranges", robot.ranges, "joint", joints),
        ("held", robot.held, "actuator", actuators),
    ):
        said += [
            f"{table} names the {kind} '{name}', but its model has {some(known - {'*'})}"
            for name in names
            if name not in known
        ]
    return said


def switched(spec: mujoco.MjSpec) -> list[str]:
    """Flags under which nothing could be told or replayed; sensors are switched on again, which
    moves nothing.
    """
    spec.option.disableflags &= ~SENSOR
    said = []
    if spec.option.disableflags & CONTACT:
        said.append(
            'its model switches contacts off (<flag contact="disable"/>), so no collision could be '
            "seen: take that out"
        )
    if spec.option.disableflags & ACTUATION:
        said.append(
            'its model switches actuators off (<flag actuation="disable"/>), so nothing would move '
            "it: take that out"
        )
    if spec.option.disableactuator:
        said.append(
            "its model switches groups of actuators off (actuatorgroupdisable), whose servos would "
            "do nothing: take that out"
        )
    if spec.option.enableflags & SLEEP:
        said.append(
            'its model lets bodies sleep (<flag sleep="enable"/>), which is no part of a state '
            "that a log could hold: "
            "take that out"
        )
    if not spec.option.timestep > 0:
        said.append(f"its model has the timestep {spec.option.timestep:g} s: expected more than 0")
    return said


def leave_out(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Take out of a robot's model what somebody else's scene needs: the ground of a robot on feet,
    which gets one at its soles, and what ties the robot to a mocap body, which nothing here moves.
    """
    if robot.soles:
        for geom in list(spec.worldbody.geoms):
            if geom.type == mujoco.mjtGeom.mjGEOM_PLANE:
                spec.delete(geom)
    for tie in spec.equalities:
        ends = [spec.body(name) for name in (tie.name1, tie.name2) if name]
        if int(tie.objtype) == BODY and any(body is not None and body.mocap for body in ends):
            tie.active = False


def some(names: Iterable[object]) -> str:
    """The first of some names, sorted; "none" if there are none."""
    found = sorted(str(name) for name in names if name)
    return (", ".join(found[:12]) + (" …" if len(found) > 12 else "")) or "none"
