"""A robot's spec read off its model: arms, servos, poses, feet, neighbours, workspace.

What a model cannot say is asked for (the palms, where a robot has hands with many fingers) or
worked out and said (gains of servos that it lacks). The result is a card for a person to edit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from coordlog.mjcf import actuator_label, compile_model, held_controls
from coordlog.mjcf.servos import HINGE, SLIDE, is_servo, servos_of
from coordlog.mjcf.source import whole
from coordlog.robots.robot import Arm, Robot
from coordlog.sim.palms import FINGER, arms_of, bearer, guess
from coordlog.sim.settling import moving
from coordlog.sim.stance import action_of, balanced, feet, soles_of, stand, start_poses

POSTURES = 300
"""Random postures from which workspace and neighbours are told."""
ALWAYS = 0.95
"""Bodies that touch in more than this share of them are neighbours, not in collision."""
STIFF = 20.0
"""Natural frequency of the servos that a robot lacks, where gravity asks for no more [rad/s]."""
SAG = 0.02
"""How far gravity may pull such a servo off its target [rad, m]."""
STABLE = 0.7
"""Radians of a servo's oscillation that a physics step may span; more of them diverge."""


@dataclass(frozen=True)
class Understanding:
    """What was read off a model."""

    robot: Robot
    notes: list[str] = field(default_factory=list)
    """What a person should look at, one sentence each."""


def understand(model_file: Path, palms: Sequence[str] = (), *, name: str = "") -> Understanding:
    """The spec of a robot, from its model.

    Args:
        model_file: MJCF or URDF.
        palms: Sites or bodies that reach for goals, one for each arm; empty to guess.
        name: What the robot is called; by default as its file or its folder.

    Raises:
        ConfigError: if the model cannot be read, lacks a palm that was named, or no arm is found in
            it.
    """
    name = name or _name(model_file)
    bare = Robot(name, model_file, (Arm("?", "?", ()),), poses={"stand": {}})
    model = compile_model(whole(bare))
    notes: list[str] = []
    found = list(palms) or guess(model, notes)
    arms, shared = arms_of(model, name, found, notes)
    robot = replace(bare, arms=arms, shared=shared)
    data = mujoco.MjData(model)
    robot = replace(robot, poses=start_poses(model, data, robot, notes))
    robot = replace(robot, **feet(model, data, robot, notes))
    robot = replace(robot, poses=balanced(model, data, robot))
    robot = replace(robot, servo_gains=_gains(model, data, robot, notes))
    robot = replace(robot, held=_held(model, data, robot))
    stand(model, data, robot)
    mujoco.mj_kinematics(model, data)
    robot = replace(robot, **_workspace(model, data, robot, notes))
    return Understanding(robot, notes)


def _name(file: Path) -> str:
    stem = file.stem
    return file.resolve().parent.name if stem in ("scene", "robot", "model", "mjmodel") else stem


def _gains(
    model: mujoco.MjModel, data: mujoco.MjData, robot: Robot, notes: list[str]
) -> dict[str, tuple[float, float]]:
    """Gains for joints of the action, and for motors elsewhere, that have no position servo: stiff
    enough for gravity in the start pose, damped critically.
    """
    motors = {
        int(model.actuator_trnid[i, 0])
        for i in range(model.nu)
        if model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT and not is_servo(model, i)
    }
    wanted = {model.joint(name).id for name in robot.action_joints} | motors
    bare = [
        j
        for j, servo in zip(sorted(wanted), servos_of(model, sorted(wanted)), strict=True)
        if servo < 0 and int(model.jnt_type[j]) in (HINGE, SLIDE)
    ]
    if not bare:
        return {}
    stand(model, data, robot)
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    legs = {j for sole in soles_of(model, robot) for j in moving(model, model.geom_bodyid[sole])}
    gains = {}
    for joint in bare:
        dof = int(model.jnt_dofadr[joint])
        weight = abs(float(data.qfrc_bias[dof]))
        if joint in legs:  # what it carries when it stands is not in its own subtree
            weight = max(weight, 9.81 * float(model.body_subtreemass[1]) * FINGER)
        kp = max(inertia[dof, dof] * STIFF**2, weight / SAG)
        kp = min(kp, inertia[dof, dof] * (STABLE / model.opt.timestep) ** 2)
        kv = max(
            2.0 * np.sqrt(kp * inertia[dof, dof])
            - float(
                model.dof_damping[dof, 0] if model.dof_damping.ndim > 1 else model.dof_damping[dof]
            ),
            0.0,
        )
        gains[model.joint(joint).name] = (float(f"{kp:.3g}"), float(f"{kv:.3g}"))
    notes.append(
        f"{len(gains)} joints have a motor or no actuator and get position servos with guessed "
        "gains: see [servo_gains]"
    )
    return gains


def _held(model: mujoco.MjModel, data: mujoco.MjData, robot: Robot) -> dict[str, float]:
    """Control of the actuators that are no joint's servo and do not become one."""
    stand(model, data, robot)
    controls = held_controls(model, data.qpos, robot, "stand")
    found = {}
    for i in range(model.nu):
        joint = model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT
        if is_servo(model, i) or (
            joint and model.joint(int(model.actuator_trnid[i, 0])).name in robot.servo_gains
        ):
            continue
        found[actuator_label(model, i)] = round(float(controls[i]), 6)
    return found


def _workspace(
    model: mujoco.MjModel, data: mujoco.MjData, robot: Robot, notes: list[str]
) -> dict[str, Any]:
    """Middle and half extent of where the palms get to, and bodies that always touch."""
    index, limits = action_of(model, robot)
    rng, rest = np.random.default_rng(0), data.qpos.copy()
    places, touching = [], np.zeros((model.nbody, model.nbody), dtype=np.int64)
    for _ in range(POSTURES):
        data.qpos[:] = rest
        data.qpos[index] = rng.uniform(limits[:, 0], limits[:, 1])
        mujoco.mj_fwdPosition(model, data)
        for arm in robot.arms:
            site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, arm.palm)
            places.append(
                data.site_xpos[site].copy()
                if site >= 0
                else data.xpos[bearer(model, arm.palm)].copy()
            )
        pairs = {
            (int(min(p)), int(max(p)))
            for p in model.geom_bodyid[data.contact.geom[data.contact.dist <= 0]].tolist()
        }
        for one, other in pairs:
            touching[one, other] += 1
    low, high = np.percentile(places, 2, axis=0), np.percentile(places, 98, axis=0)
    centre = tuple(round(float(v), 3) + 0.0 for v in (low + high) / 2)
    excludes = tuple(
        (model.body(int(a)).name, model.body(int(b)).name)
        for a, b in np.argwhere(touching > ALWAYS * POSTURES)
        if a and model.body(int(a)).name and model.body(int(b)).name
    )
    if excludes:
        said = ", ".join(f"{a} and {b}" for a, b in excludes)
        notes.append(
            f"{said} touch in nearly every posture and are taken for neighbours: see excludes"
        )
    return {
        "centre": centre,
        "reach": round(float((high - low).max() / 2), 3),
        "excludes": excludes,
    }
