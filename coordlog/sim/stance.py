"""How a robot stands: its start poses, and on what."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi
from typing import Any

import mujoco
import numpy as np

from coordlog.episode import Array
from coordlog.mjcf.servos import HINGE, SLIDE
from coordlog.robots.robot import Robot
from coordlog.sim.palms import above, bearer
from coordlog.sim.settling import FREE, moving

INSIDE = 0.35
"""The centre of mass stays inside the feet by this share of their extent."""
NUDGE = 1e-5
"""By how much an angle is moved to see what it does [rad]."""
BALANCING = 30
"""Steps of Gauss and Newton towards a stance."""
LAZY = 0.03
"""Weight of staying where a joint was, beside metres and radians of feet and centre of mass."""
FLAT = 0.01
"""Geoms whose lowest points are this near the lowest of all are what a robot stands on [m]."""


def start_poses(
    model: mujoco.MjModel, data: mujoco.MjData, robot: Robot, notes: list[str]
) -> dict[str, dict[str, float]]:
    """The keyframes, and "stand": the first of them, or a posture in which nothing touches."""
    singles = [j for j in range(model.njnt) if int(model.jnt_type[j]) in (HINGE, SLIDE)]

    def named(qpos: Array) -> dict[str, float]:
        return {
            model.joint(j).name: round(float(qpos[model.jnt_qposadr[j]]), 6)
            for j in singles
            if model.joint(j).name
            and (
                abs(qpos[model.jnt_qposadr[j]]) > 1e-9 or model.joint(j).name in robot.action_joints
            )
        }

    keys = {model.key(i).name or f"key_{i}": model.key_qpos[i] for i in range(model.nkey)}
    poses = {name: named(qpos) for name, qpos in keys.items()}
    if "stand" in poses:
        return poses
    if poses:
        first = next(iter(poses))
        notes.append(f"its start pose, stand, is its keyframe '{first}'")
        return {"stand": poses[first], **{k: v for k, v in poses.items() if k != first}}
    notes.append("it has no keyframe: its start pose, stand, is a guess")
    return {"stand": named(_free_posture(model, data, robot))}


def _free_posture(model: mujoco.MjModel, data: mujoco.MjData, robot: Robot) -> Array:
    """The zero posture, or the nearest to it among random ones in which fewer bodies touch."""
    index, limits = action_of(model, robot)
    middle = np.clip(
        0.0,
        limits[:, 0] + 0.1 * np.ptp(limits, axis=1),
        limits[:, 1] - 0.1 * np.ptp(limits, axis=1),
    )
    rng, tries = np.random.default_rng(0), [middle]
    tries += [
        middle + rng.uniform(-1, 1, len(middle)) * share for share in np.linspace(0.1, 1.2, 40)
    ]
    best, fewest = model.qpos0.copy(), np.inf
    for angles in tries:
        data.qpos[:] = model.qpos0
        data.qpos[index] = np.clip(angles, limits[:, 0], limits[:, 1])
        mujoco.mj_fwdPosition(model, data)
        touching = int((data.contact.dist <= 0).sum())
        if touching < fewest:
            best, fewest = data.qpos.copy(), touching
        if not touching:
            break
    return np.asarray(best)


def action_of(model: mujoco.MjModel, robot: Robot) -> tuple[Array, Array]:
    """Places in qpos and ranges of the action's joints, (n_u,) and (n_u, 2)."""
    joints = [model.joint(name) for name in robot.action_joints]
    limits = [joint.range if model.jnt_limited[joint.id] else (-pi, pi) for joint in joints]
    return np.array([joint.qposadr[0] for joint in joints]), np.array(limits)


def stand(model: mujoco.MjModel, data: mujoco.MjData, robot: Robot) -> None:
    """Put the robot into its start pose."""
    mujoco.mj_resetData(model, data)
    if model.nkey:
        data.qpos[:] = model.key_qpos[0]
    for name, angle in robot.poses["stand"].items():
        data.qpos[model.joint(name).qposadr[0]] = angle


def balanced(
    model: mujoco.MjModel, data: mujoco.MjData, robot: Robot
) -> Mapping[str, Mapping[str, float]]:
    """The poses; where no keyframe says how a robot on feet stands, its legs are bent in the start
    pose so that its centre of mass is above its feet, which stay level and flat.
    """
    if not robot.soles or model.nkey:
        return robot.poses
    stand(model, data, robot)
    mujoco.mj_forward(model, data)
    soles = soles_of(model, robot)
    grounded = sorted({int(model.geom_bodyid[g]) for g in soles})
    action = {model.joint(name).id for name in robot.action_joints}
    legs = sorted(
        j
        for j in set().union(*(moving(model, body) for body in grounded)) - action
        if model.jnt_type[j] == HINGE and model.joint(j).name
    )
    if not legs:
        return robot.poses
    index = model.jnt_qposadr[legs]
    before, level = data.qpos[index].copy(), data.xmat[grounded].copy()
    low, high = np.where(model.jnt_limited[legs, None], model.jnt_range[legs], (-pi, pi)).T
    root = int(model.body_rootid[grounded[0]])

    def wrong(angles: Array) -> Array:
        """What is to become zero at some angles of the legs."""
        data.qpos[index] = angles
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        bottoms = np.array([bottom(model, data, g) for g in soles])
        return np.concatenate(
            [
                data.subtree_com[root, :2] - _above_what(model, data, soles),
                bottoms - bottoms.min(),
                (data.xmat[grounded] - level).ravel(),
                LAZY * (angles - before),
            ]
        )

    angles, error = before, wrong(before)
    for _ in range(BALANCING):
        slope = np.stack(
            [(wrong(angles + step) - error) / NUDGE for step in NUDGE * np.eye(len(legs))]
        )
        angles = np.clip(angles - np.linalg.lstsq(slope.T, error, rcond=None)[0], low, high)
        error = wrong(angles)
    bent = {model.joint(j).name: round(float(a), 4) for j, a in zip(legs, angles, strict=True)}
    return {**robot.poses, "stand": {**robot.poses["stand"], **bent}}


def _above_what(model: mujoco.MjModel, data: mujoco.MjData, soles: list[int]) -> Array:
    """Where the centre of mass belongs, (2,): above the ankles, which may be weak, but well inside
    the feet [m].
    """
    lowest, highest = data.geom_xpos[soles].min(axis=0), data.geom_xpos[soles].max(axis=0)
    inside = INSIDE * (highest - lowest)
    ankles = []
    for body in {int(model.geom_bodyid[g]) for g in soles}:
        while not model.body_jntnum[body] and body:
            body = int(model.body_parentid[body])
        ankles.append(data.xanchor[int(model.body_jntadr[body])])
    return np.asarray(np.clip(np.mean(ankles, axis=0), lowest + inside, highest - inside)[:2])


def soles_of(model: mujoco.MjModel, robot: Robot) -> list[int]:
    """Geoms that the robot stands on."""
    return [g for g in range(model.ngeom) if geom_name(model, g) in robot.soles]


def feet(
    model: mujoco.MjModel, data: mujoco.MjData, robot: Robot, notes: list[str]
) -> dict[str, Any]:
    """What a robot on a free base stands on, and its torso."""
    palm = bearer(model, robot.arms[0].palm)
    if not any(model.jnt_type[j] == FREE for j in moving(model, palm)):
        return {}
    stand(model, data, robot)
    mujoco.mj_kinematics(model, data)
    own = [
        g
        for g in range(model.ngeom)
        if model.body_rootid[model.geom_bodyid[g]] == model.body_rootid[palm]
        and (model.geom_contype[g] or model.geom_conaffinity[g])
    ]
    lowest = {g: bottom(model, data, g) for g in own}
    floor = min(lowest.values(), default=0.0)
    soles = [g for g in own if lowest[g] < floor + FLAT]
    arm = above(model, palm)
    shared = [
        b
        for b in arm
        if all(
            b in [bearer(model, a.palm), *above(model, bearer(model, a.palm))] for a in robot.arms
        )
    ]
    torso = model.body(shared[0] if shared else int(model.body_rootid[palm])).name
    notes.append(f"it has a free base and stands on {len(soles)} geoms: see soles")
    return {"soles": tuple(geom_name(model, g) for g in soles), "torso": torso}


def geom_name(model: mujoco.MjModel, geom: int) -> str:
    """A geom's name, or what mjcf/compose.py calls it if it has none."""
    body = int(model.geom_bodyid[geom])
    place = geom - int(model.body_geomadr[body])
    return str(model.geom(geom).name or f"geom {place} of {model.body(body).name or 'a body'}")


def bottom(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float:
    """The lowest height of a geom's bounding box [m]; exact for boxes and spheres."""
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE:
        return float(data.geom_xpos[geom, 2] - model.geom_size[geom, 0])
    turn = data.geom_xmat[geom].reshape(3, 3)
    centre = data.geom_xpos[geom] + turn @ model.geom_aabb[geom, :3]
    return float(centre[2] - np.abs(turn[2]) @ model.geom_aabb[geom, 3:])
