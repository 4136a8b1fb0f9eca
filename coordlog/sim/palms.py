"""Where the palms of a robot's model are, and which joints are an arm's: named by a person, or
guessed where branches of joints end.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from coordlog.errors import ConfigError
from coordlog.mjcf.demands import some
from coordlog.mjcf.servos import HINGE, SLIDE, servos_of
from coordlog.robots.robot import Arm
from coordlog.sim.settling import FREE, moving

FINGER = 0.15
"""A branch that reaches less far than this beyond its first joint is a finger [m]."""
ARM_JOINTS = 3
"""A branch with fewer joints of its own is a head or a gripper, not an arm."""
FAST = 4000.0
"""A joint that coasts to a stop at more than this rate is locked, by whoever made the model: the
servo that could move it would take longer than an episode [1/s]."""
HEAD = ("head", "neck", "camera")
"""Words in the names of bodies that bear no palm."""


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


def _driven(model: mujoco.MjModel, body: int, notes: list[str]) -> list[str]:
    """The chain of a body without joints that have no servo and are no part of an arm: slides
    without a range, which are how somebody else moves the base, joints that are damped so much
    that they stand still, and those that an equality makes follow another.
    """
    found = []
    for name in chain(model, body):
        joint = model.joint(name).id
        leader = follows(model, joint)
        if leader and servos_of(model, [joint])[0] < 0:
            said = (
                f"{name} follows {leader} by an equality and has no servo: left out of the action"
            )
            notes += [said] * (said not in notes)
            continue
        free = model.jnt_type[joint] == SLIDE and not model.jnt_limited[joint]
        damping = float(model.dof_damping[model.jnt_dofadr[joint]].max())
        fast = damping > FAST * float(model.body_subtreemass[model.jnt_bodyid[joint]])
        if (free or fast) and servos_of(model, [joint])[0] < 0:
            said = (
                f"{name} is a slide without a range" if free else f"{name} is held by its damping"
            )
            said += " and without a servo: left out of the action"
            notes += [said] * (said not in notes)
        else:
            found.append(name)
    return found


def follows(model: mujoco.MjModel, joint: int) -> str:
    """The joint that an equality makes this one follow; "" if none does."""
    for tie in np.flatnonzero(model.eq_active0 & (model.eq_type == mujoco.mjtEq.mjEQ_JOINT)):
        if int(model.eq_obj1id[tie]) == joint and int(model.eq_obj2id[tie]) >= 0:
            return str(model.joint(int(model.eq_obj2id[tie])).name)
    return ""


def arms_of(
    model: mujoco.MjModel, name: str, palms: Sequence[str], notes: list[str]
) -> tuple[tuple[Arm, ...], tuple[str, ...]]:
    """The arms that end in some palms, and the joints that all of them share.

    Raises:
        ConfigError: if a palm is not there, or no joint moves it.
    """
    missing = [palm for palm in palms if bearer(model, palm) < 0]
    if missing:
        raise ConfigError(
            f"robot '{name}': expected a site or a body called '{missing[0]}' as a palm, found "
            "none; "
            f"it has the sites {some(site_names(model))} and the bodies {some(body_names(model))}"
        )
    chains = [_driven(model, bearer(model, palm), notes) for palm in palms]
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


def site_names(model: mujoco.MjModel) -> list[str]:
    """Names of the sites that have one."""
    return [model.site(i).name for i in range(model.nsite) if model.site(i).name]


def body_names(model: mujoco.MjModel) -> list[str]:
    """Names of the bodies that have one, the world aside."""
    return [model.body(i).name for i in range(1, model.nbody) if model.body(i).name]


def guess(model: mujoco.MjModel, notes: list[str]) -> list[str]:
    """Palms where branches of joints end: fingers, heads and legs are none."""
    ends = {_end(model, leaf) for leaf in range(1, model.nbody) if not _children(model, leaf)}
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_kinematics(model, data)
    inner = {p for end in ends for p in above(model, end)}
    arms: list[int] = []
    for end in _merged(model, sorted(ends - inner)):
        joints = moving(model, end)
        free = any(model.jnt_type[j] == FREE for j in joints)
        root = int(model.body_rootid[end])
        legs = free and data.xpos[end, 2] < data.xpos[root, 2] - FINGER
        if not legs and not _is_head(model, end):
            arms.append(end)
    # a small robot's arm has fewer joints than a large one's head
    least = min(ARM_JOINTS, max((len(chain(model, end)) for end in arms), default=0))
    arms = [end for end in arms if len(chain(model, end)) >= max(least, 1)]
    arms = [end for end in arms if _own(model, end, arms) >= min(ARM_JOINTS, _most(model, arms))]
    if not arms:
        raise ConfigError(
            "no arm found in the model: name its palms, sites or bodies, with --palm; it has the "
            f"sites {some(site_names(model))} and the bodies {some(body_names(model))}"
        )
    found = [_site(model, end) for end in arms]
    notes.append(f"palms guessed: {', '.join(found)}; name others with --palm")
    return found


def _is_head(model: mujoco.MjModel, body: int) -> bool:
    return any(word in model.body(body).name.lower() for word in HEAD)


def _own(model: mujoco.MjModel, end: int, ends: Sequence[int]) -> int:
    """How many of the joints that move an end move no other."""
    others = {name for other in ends if other != end for name in chain(model, other)}
    return len([name for name in chain(model, end) if name not in others])


def _most(model: mujoco.MjModel, ends: Sequence[int]) -> int:
    return max((_own(model, end, ends) for end in ends), default=0)


def _merged(model: mujoco.MjModel, ends: list[int]) -> list[int]:
    """Ends that differ by a few joints only are fingers of one hand: where they branch is its
    palm.
    """
    for one in ends:
        for other in ends:
            mine, theirs = set(chain(model, one)), set(chain(model, other))
            own = max(len(mine - theirs), len(theirs - mine))
            if one != other and own < ARM_JOINTS <= len(mine & theirs):
                common = next(b for b in above(model, one) if b in above(model, other))
                return _merged(model, sorted({common, *ends} - {one, other}))
    return ends


def _children(model: mujoco.MjModel, body: int) -> list[int]:
    return [int(i) for i in np.flatnonzero(model.body_parentid == body) if i]


def above(model: mujoco.MjModel, body: int) -> list[int]:
    """The bodies that a body hangs on, the nearest first."""
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
