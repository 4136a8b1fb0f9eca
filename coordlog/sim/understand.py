"""A robot's spec read off its model: arms, servos, poses, feet, neighbours, workspace.

What a model cannot say is asked for (the palms, where a robot has hands with many fingers) or
worked out and said (gains of servos that it lacks). The result is a card for a person to edit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import pi
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from coordlog.episode import Array
from coordlog.errors import ConfigError
from coordlog.mjcf import actuator_label, compile_model, held_controls
from coordlog.mjcf.servos import HINGE, SLIDE, is_servo, servos_of
from coordlog.mjcf.source import whole
from coordlog.robots.robot import Arm, Robot
from coordlog.sim.settling import FREE, moving

POSTURES = 300
"""Random postures from which workspace and neighbours are told."""
ALWAYS = 0.95
"""Bodies that touch in more than this share of them are neighbours, not in collision."""
FINGER = 0.15
"""A branch that reaches less far than this beyond its first joint is a finger [m]."""
ARM_JOINTS = 3
"""A branch with fewer joints is a head or a gripper, not an arm."""
STIFF = 20.0
"""Natural frequency of the servos that a robot lacks, where gravity asks for no more [rad/s]."""
SAG = 0.02
"""How far gravity may pull such a servo off its target [rad, m]."""
FLAT = 0.01
"""Geoms whose lowest points are this near the lowest of all are what a robot stands on [m]."""


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
    found = list(palms) or _guess(model, notes)
    arms, shared = _arms(model, name, found, notes)
    robot = replace(bare, arms=arms, shared=shared)
    data = mujoco.MjData(model)
    robot = replace(robot, poses=_poses(model, data, robot, notes))
    robot = replace(robot, servo_gains=_gains(model, data, robot, notes))
    robot = replace(robot, held=_held(model, data, robot), **_feet(model, data, robot, notes))
    _let_go(model, data, robot)
    robot = replace(robot, **_workspace(model, data, robot, notes))
    return Understanding(robot, notes)


def _name(file: Path) -> str:
    stem = file.stem
    return file.resolve().parent.name if stem in ("scene", "robot", "model", "mjmodel") else stem


def bearer(model: mujoco.MjModel, palm: str) -> int:
    """The body that a palm is, or is on; -1 if there is none."""
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, palm)
    if site >= 0:
        return int(model.site_bodyid[site])
    return int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, palm))


def chain(model: mujoco.MjModel, body: int) -> list[str]:
    """Hinges and slides that move a body, base to tip."""
    joints = [j for j in sorted(moving(model, body)) if int(model.jnt_type[j]) in (HINGE, SLIDE)]
    return [model.joint(j).name for j in joints]


def _arms(
    model: mujoco.MjModel, name: str, palms: Sequence[str], notes: list[str]
) -> tuple[tuple[Arm, ...], tuple[str, ...]]:
    missing = [palm for palm in palms if bearer(model, palm) < 0]
    if missing:
        sites = [model.site(i).name for i in range(model.nsite) if model.site(i).name]
        raise ConfigError(
            f"robot '{name}': expected a site or a body called '{missing[0]}' as a palm, found "
            "none; "
            f"it has the sites {', '.join(sites) or '(none)'} and the bodies "
            f"{', '.join(_bodies(model))}"
        )
    chains = [chain(model, bearer(model, palm)) for palm in palms]
    for palm, joints in zip(palms, chains, strict=True):
        if not joints:
            raise ConfigError(
                f"robot '{name}': its palm '{palm}' is moved by no hinge or slide: expected one at "
                "an arm's end"
            )
    shared = [j for j in chains[0] if all(j in other for other in chains)] if len(palms) > 1 else []
    arms = []
    for palm, joints in zip(palms, chains, strict=True):
        own = [j for j in joints if j not in shared]
        common = [j for j in own if sum(j in other for other in chains) > 1]
        if common:
            notes.append(f"{', '.join(common)} move several palms but not all: strike them out")
        arms.append(Arm(palm if len(palms) > 1 else "arm", palm, tuple(own)))
    return tuple(arms), tuple(shared)


def _bodies(model: mujoco.MjModel) -> list[str]:
    return [model.body(i).name for i in range(1, model.nbody) if model.body(i).name]


def _guess(model: mujoco.MjModel, notes: list[str]) -> list[str]:
    """Palms where branches of joints end: fingers, heads and legs are none."""
    ends = {_end(model, leaf) for leaf in range(1, model.nbody) if not _children(model, leaf)}
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_kinematics(model, data)
    inner = {p for end in ends for p in _above(model, end)}
    arms: list[int] = []
    for end in _merged(model, sorted(ends - inner)):
        joints = moving(model, end)
        free = any(model.jnt_type[j] == FREE for j in joints)
        root = int(model.body_rootid[end])
        legs = free and data.xpos[end, 2] < data.xpos[root, 2] - FINGER
        if len(chain(model, end)) >= ARM_JOINTS and not legs:
            arms.append(end)
    if not arms:
        raise ConfigError(
            "no arm found in the model: name its palms, sites or bodies, with --palm; its bodies "
            f"are {', '.join(_bodies(model))}"
        )
    found = [_site(model, end) for end in arms]
    notes.append(f"palms guessed: {', '.join(found)}; name others with --palm")
    return found


def _merged(model: mujoco.MjModel, ends: list[int]) -> list[int]:
    """Ends that differ by a few joints only are fingers of one hand: where they branch is its
    palm.
    """
    for one in ends:
        for other in ends:
            mine, theirs = set(chain(model, one)), set(chain(model, other))
            own = max(len(mine - theirs), len(theirs - mine))
            if one != other and own < ARM_JOINTS <= len(mine & theirs):
                common = next(b for b in _above(model, one) if b in _above(model, other))
                return _merged(model, sorted({common, *ends} - {one, other}))
    return ends


def _children(model: mujoco.MjModel, body: int) -> list[int]:
    return [int(i) for i in np.flatnonzero(model.body_parentid == body) if i]


def _above(model: mujoco.MjModel, body: int) -> list[int]:
    found = []
    while body := int(model.body_parentid[body]):
        found.append(body)
    return found


def _end(model: mujoco.MjModel, body: int) -> int:
    """The last body of the arm that a leaf hangs on: up over all that is a finger or fixed."""
    while int(model.body_parentid[body]) and (
        not model.body_jntnum[body]
        or model.jnt_type[model.body_jntadr[body]] == SLIDE
        or _is_finger(model, body)
    ):
        body = int(model.body_parentid[body])
    return body


def _is_finger(model: mujoco.MjModel, body: int) -> bool:
    """Short, and beside others: a gripper's or a hand's."""
    moving_beside = [
        b for b in _children(model, int(model.body_parentid[body])) if model.body_jntnum[b]
    ]
    return len(moving_beside) > 1 and _extent(model, body) < FINGER


def _extent(model: mujoco.MjModel, body: int) -> float:
    """How far what hangs on a body reaches from its origin, its own geoms included [m]."""
    own = np.flatnonzero(model.geom_bodyid == body)
    reach = [
        float(np.linalg.norm(model.geom_pos[g]) + min(model.geom_rbound[g], FINGER)) for g in own
    ]
    reach += [
        float(np.linalg.norm(model.body_pos[c])) + _extent(model, c) for c in _children(model, body)
    ]
    return max(reach, default=0.0)


def _site(model: mujoco.MjModel, body: int) -> str:
    """A site on a body or on what is fixed to it, the farthest out; else the body."""
    fixed = [body]
    for each in fixed:
        fixed += [c for c in _children(model, each) if not model.body_jntnum[c]]
    sites = [i for i in range(model.nsite) if model.site_bodyid[i] in fixed and model.site(i).name]
    if not sites:
        return str(model.body(body).name)
    return str(model.site(max(sites, key=lambda i: float(np.linalg.norm(model.site_pos[i])))).name)


def _poses(
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
    index, limits = _action(model, robot)
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


def _action(model: mujoco.MjModel, robot: Robot) -> tuple[Array, Array]:
    """Places in qpos and ranges of the action's joints, (n_u,) and (n_u, 2)."""
    joints = [model.joint(name) for name in robot.action_joints]
    limits = [joint.range if model.jnt_limited[joint.id] else (-pi, pi) for joint in joints]
    return np.array([joint.qposadr[0] for joint in joints]), np.array(limits)


def _stand(model: mujoco.MjModel, data: mujoco.MjData, robot: Robot) -> None:
    """Put the robot into its start pose."""
    mujoco.mj_resetData(model, data)
    if model.nkey:
        data.qpos[:] = model.key_qpos[0]
    for name, angle in robot.poses["stand"].items():
        data.qpos[model.joint(name).qposadr[0]] = angle


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
    _stand(model, data, robot)
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    floating = any(model.jnt_type[j] == FREE for j in range(model.njnt))
    gains = {}
    for joint in bare:
        dof = int(model.jnt_dofadr[joint])
        weight = abs(float(data.qfrc_bias[dof]))
        if floating:  # what it carries when it stands is not in its own subtree
            weight = max(weight, 9.81 * float(model.body_subtreemass[1]) * FINGER)
        kp = max(inertia[dof, dof] * STIFF**2, weight / SAG)
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
    _stand(model, data, robot)
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


def _feet(
    model: mujoco.MjModel, data: mujoco.MjData, robot: Robot, notes: list[str]
) -> dict[str, Any]:
    """What a robot on a free base stands on, and its torso."""
    palm = bearer(model, robot.arms[0].palm)
    if not any(model.jnt_type[j] == FREE for j in moving(model, palm)):
        return {}
    _stand(model, data, robot)
    mujoco.mj_kinematics(model, data)
    own = [
        g
        for g in range(model.ngeom)
        if model.body_rootid[model.geom_bodyid[g]] == model.body_rootid[palm]
        and (model.geom_contype[g] or model.geom_conaffinity[g])
    ]
    lowest = {g: _bottom(model, data, g) for g in own}
    floor = min(lowest.values(), default=0.0)
    soles = [g for g in own if lowest[g] < floor + FLAT]
    arm = _above(model, palm)
    shared = [
        b
        for b in arm
        if all(
            b in [bearer(model, a.palm), *_above(model, bearer(model, a.palm))] for a in robot.arms
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


def _bottom(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float:
    """The lowest height of a geom's bounding box [m]; exact for boxes and spheres."""
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE:
        return float(data.geom_xpos[geom, 2] - model.geom_size[geom, 0])
    turn = data.geom_xmat[geom].reshape(3, 3)
    centre = data.geom_xpos[geom] + turn @ model.geom_aabb[geom, :3]
    return float(centre[2] - np.abs(turn[2]) @ model.geom_aabb[geom, 3:])


def _let_go(model: mujoco.MjModel, data: mujoco.MjData, robot: Robot) -> None:
    _stand(model, data, robot)
    mujoco.mj_kinematics(model, data)


def _workspace(
    model: mujoco.MjModel, data: mujoco.MjData, robot: Robot, notes: list[str]
) -> dict[str, Any]:
    """Middle and half extent of where the palms get to, and bodies that always touch."""
    index, limits = _action(model, robot)
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
