"""What a person should know of a robot before trusting an episode's flags."""

from __future__ import annotations

from itertools import pairwise

import mujoco
import numpy as np

from coordlog.mjcf import actuator_label
from coordlog.mjcf.servos import is_servo, servos_of
from coordlog.robots.robot import Robot
from coordlog.sim.palms import follows
from coordlog.sim.settling import FREE, LOCKED, moving

NARROW = 0.05
"""A servo that leaves out more than this share of its joint's range is worth a word."""
PULLS = 1e-6
"""A held actuator with less leverage on a joint does not pull on it."""


def doubts(robot: Robot, model: mujoco.MjModel) -> list[str]:
    """What a person should know before trusting an episode's flags, one sentence each."""
    said = []
    action = {model.joint(name).id for name in robot.action_joints}
    solid = (model.geom_contype | model.geom_conaffinity) > 0
    solid[model.pair_geom1] = solid[model.pair_geom2] = True
    carried = [bool(moving(model, int(body)) & action) for body in model.geom_bodyid]
    if not (solid & carried).any():
        said.append(
            "no geom on a link that the action moves collides with anything (contype and "
            "conaffinity are 0, or there is none): "
            "no collision can be seen, and clean means nothing but success"
        )
    else:
        for arm in robot.arms:
            own = {model.joint(name).id for name in arm.joints}
            if own and not any(
                solid[g] and moving(model, int(model.geom_bodyid[g])) & own
                for g in range(model.ngeom)
            ):
                said.append(f"no geom of arm '{arm.name}' collides with anything")
    driven = {int(model.actuator_trnid[i, 0]) for i in range(model.nu)}
    palms = {j for arm in robot.arms for j in moving(model, int(model.site(arm.palm).bodyid[0]))}
    for joint in sorted(palms - action - driven):
        damping = model.dof_damping[int(model.jnt_dofadr[joint])]
        if model.jnt_type[joint] != FREE and np.max(damping) < LOCKED:
            name = model.joint(joint).name or f"joint {joint}"
            said.append(
                f"joint '{name}' carries a palm and nothing drives it: "
                + (_following(follows(model, joint)) or "what it carries sways")
            )
    for tie in np.flatnonzero((model.eq_objtype == mujoco.mjtObj.mjOBJ_BODY) & ~model.eq_active0):
        ends = [int(model.eq_obj1id[tie]), int(model.eq_obj2id[tie])]
        if (model.body_mocapid[ends] >= 0).any():
            names = " and ".join(f"'{model.body(body).name}'" for body in ends)
            said.append(f"what ties {names} is off: no mocap body of the robot's is moved here")
    return said + _hindered(robot, model, action)


def _following(leader: str) -> str:
    return leader and (
        f"it follows '{leader}' by an equality, which neither goals nor the scripted expert reckon "
        "with"
    )


def _hindered(robot: Robot, model: mujoco.MjModel, action: set[int]) -> list[str]:
    """What keeps joints of the action from where goals may ask them to go."""
    said = []
    for name in robot.action_joints:
        joint = model.joint(name).id
        servo = servos_of(model, [joint])[0]
        low, high = model.jnt_range[joint]
        if servo >= 0 and model.actuator_ctrllimited[servo]:
            least, most = model.actuator_ctrlrange[servo]
            if max(least - low, high - most) > NARROW * (high - low):
                said.append(
                    f"the servo of joint '{name}' takes {least:.3g} to {most:.3g} of the joint's "
                    f"{low:.3g} to {high:.3g}: goals beyond are out of reach; say the joint's "
                    "range, or widen ctrlrange"
                )
    return said + _tied_down(model, action) + _roped(model, action) + _pulled(model, action)


def _tied_down(model: mujoco.MjModel, action: set[int]) -> list[str]:
    """Equalities between what different joints of the action move."""
    said = []
    bodies = (int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD))
    for tie in np.flatnonzero(model.eq_active0):
        ends = int(model.eq_obj1id[tie]), int(model.eq_obj2id[tie])
        kind, of = int(model.eq_type[tie]), int(model.eq_objtype[tie])
        if kind == mujoco.mjtEq.mjEQ_JOINT:
            held = {end for end in ends if end in action}
            driven = held if len(held) == (2 if ends[1] >= 0 else 1) else set()
        elif kind in bodies:
            if of == mujoco.mjtObj.mjOBJ_SITE:
                ends = int(model.site_bodyid[ends[0]]), int(model.site_bodyid[ends[1]])
            driven = (moving(model, ends[0]) ^ moving(model, max(ends[1], 0))) & action
        else:
            driven = set()
        if driven:
            names = ", ".join(f"'{model.joint(joint).name}'" for joint in sorted(driven))
            said.append(f"an equality of the model keeps {names} from moving freely")
    return said


def _roped(model: mujoco.MjModel, action: set[int]) -> list[str]:
    """Tendons that stop joints of the action, or pull on them."""
    said = []
    tied = set(model.eq_obj1id[(model.eq_type == mujoco.mjtEq.mjEQ_TENDON) & model.eq_active0])
    for tendon in range(model.ntendon):
        held = _along(model, tendon) & action
        why = [
            word
            for word, so in (
                ("is limited to {:.3g} to {:.3g}".format(*model.tendon_range[tendon]),
                 bool(model.tendon_limited[tendon]) and _can_stop(model, tendon)),
                ("is a spring", np.any(model.tendon_stiffness[tendon])),
                ("is tied by an equality", tendon in tied),
            )
            if so
        ]  # fmt: skip
        if held and why:
            name = model.tendon(tendon).name or f"tendon {tendon}"
            names = ", ".join(f"'{model.joint(joint).name}'" for joint in sorted(held))
            said.append(
                f"tendon '{name}' {' and '.join(why)}, and keeps {names} from moving freely: "
                "neither goals nor the scripted expert reckon with it"
            )
    return said


def _along(model: mujoco.MjModel, tendon: int) -> set[int]:
    """Joints that change a tendon's length."""
    first = int(model.tendon_adr[tendon])
    parts = range(first, first + int(model.tendon_num[tendon]))
    kinds, what = model.wrap_type, model.wrap_objid
    fixed = {int(what[i]) for i in parts if kinds[i] == mujoco.mjtWrap.mjWRAP_JOINT}
    through = [
        moving(model, int(model.site_bodyid[what[i]]))
        for i in parts
        if kinds[i] == mujoco.mjtWrap.mjWRAP_SITE
    ]
    for one, other in pairwise(through):
        fixed |= one ^ other
    return fixed


def _can_stop(model: mujoco.MjModel, tendon: int) -> bool:
    """Whether joints within their ranges can bring a tendon to its limits; of one that runs through
    sites, nobody knows.
    """
    first, count = int(model.tendon_adr[tendon]), int(model.tendon_num[tendon])
    parts = slice(first, first + count)
    joints = model.wrap_objid[parts]
    if (model.wrap_type[parts] != mujoco.mjtWrap.mjWRAP_JOINT).any():
        return True
    if not model.jnt_limited[joints].all():
        return True
    ends = np.sort(model.wrap_prm[parts, None] * model.jnt_range[joints], axis=1).sum(axis=0)
    low, high = model.tendon_range[tendon]
    return bool(ends[0] < low or ends[1] > high)


def _pulled(model: mujoco.MjModel, action: set[int]) -> list[str]:
    """Actuators that are held, and hold joints of the action with them."""
    data = mujoco.MjData(model)
    mujoco.mj_fwdPosition(model, data)
    moment = np.zeros((model.nu, model.nv))
    if model.nu:
        mujoco.mju_sparse2dense(
            moment,
            data.actuator_moment,
            data.moment_rownnz,
            data.moment_rowadr,
            data.moment_colind,
        )
    said = []
    for i in range(model.nu):
        stiff = bool(model.actuator_biasprm[i, 1:3].any())
        stiff &= model.actuator_biastype[i] == mujoco.mjtBias.mjBIAS_AFFINE
        if is_servo(model, i) or not stiff:
            continue
        names = [
            f"'{model.joint(joint).name}'"
            for joint in sorted(action)
            if abs(moment[i, model.jnt_dofadr[joint]]) > PULLS
        ]
        if names:
            said.append(
                f"actuator '{actuator_label(model, i)}' is no joint's servo, is held, and holds "
                f"{', '.join(names)} with it: take it out"
            )
    return said
