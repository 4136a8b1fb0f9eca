"""All palms to their goals at once: damped least squares over every action joint, the base standing
still.

Used to verify that a drawn problem can be solved and by the scripted expert; no learner sees it.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import NamedTuple

import mujoco
import numpy as np

from coordlog.episode import Array
from coordlog.kinematics.balance import support_margin
from coordlog.kinematics.levers import Levers
from coordlog.kinematics.pairs import below, obstacles
from coordlog.robots.robot import Robot
from coordlog.tasks.scene import sole_corner, sphere_geom

ITERATIONS = 60
DAMPING = 0.03
TOLERANCE = 0.002
RESOLUTION = 0.05
"""A joint path is looked at this often [rad]."""
STEP = 0.25
"""Largest joint change of one iteration [rad]."""
POSTURE = 0.05
"""Share of the way back to the seed posture that each iteration makes in the null space."""
MARGIN = 0.03
"""Obstacles nearer than this to the robot can be told from far ones [m]."""
FAR = 0.14
"""Obstacles within this distance of a link can be slid past [m]."""
BESIDE = 0.05
"""The same for links that are not an arm's last one, and for arms beside the robot itself, as far
as MARGIN goes [m]."""
JOINTED = 3
"""Links with fewer action joints between them stand close by design, and keep no distance."""
UPRIGHT = 1e-3
"""Sine of a lean below which it has no direction."""
SHARED_EFFORT = 2.0
"""Shared joints count as this much harder to move: the spine helps where the arms alone do not
reach."""


class Approach(NamedTuple):
    """Two things that are near each other."""

    closing: Array
    """How a joint's motion closes the gap, (n_u,) [m/rad]."""
    gap: float
    """Between their surfaces [m]."""
    tip: bool
    """Whether one of them is an arm's last link."""
    solid: bool
    """Whether one of them is an obstacle."""


class Reach:
    """The kinematics of one robot in one scene: palms, legality and inverse kinematics at given
    joint angles.
    """

    def __init__(
        self,
        robot: Robot,
        model: mujoco.MjModel,
        *,
        margin: float,
        tilt: float,
        standing: Array,
        resting: Sequence[tuple[int, int]] = (),
    ) -> None:
        """Copy the model; nothing here touches a simulation.

        Args:
            robot: Names.
            model: The scene's model; copied, so spheres can be placed.
            margin: The centre of mass stays this far inside the feet [m].
            tilt: A torso that leans further counts as tipped [rad].
            standing: qpos at rest in the start pose, shape (n_q,).
            resting: Pairs of geoms that lie against one another and never count as touching.
        """
        self._resting = {frozenset(pair) for pair in resting}
        self._model, self._margin, self._tilt, self._soles = copy(model), margin, tilt, robot.soles
        self._obstacles = obstacles(self._model)
        self._solid = set(self._obstacles.tolist())
        self._wide = copy(model)
        levers = Levers(model)
        self._above = [levers.above(int(body)) for body in model.geom_bodyid]
        self._tip_geoms = self._set_margins(robot)
        self._data = mujoco.MjData(self._model)
        self._data.qpos[:] = standing
        joints = [model.joint(name) for name in robot.action_joints]
        self._qpos = np.array([joint.qposadr[0] for joint in joints])
        self._dofs = np.array([joint.dofadr[0] for joint in joints])
        self._driven = frozenset(joint.id for joint in joints)
        self._sites = [model.site(arm.palm).id for arm in robot.arms]
        self._corners = [
            model.site(sole_corner(sole, i)).id for sole in robot.soles for i in range(4)
        ]
        self._sole_geoms = {model.geom(sole).id for sole in robot.soles}
        self._torso = (
            model.body(robot.torso).id if robot.soles else 0
        )  # the world, which never leans
        self._base = model.body(self._torso).rootid[0]
        self.limits: Array = np.array([joint.range for joint in joints])
        self.standing_angles: Array = standing[self._qpos].copy()
        self._effort = np.array(
            [SHARED_EFFORT if name in robot.shared else 1.0 for name in robot.action_joints]
        )
        self.seeds = [self.angles_of(robot, pose) for pose in robot.poses if pose != "neutral"][
            ::-1
        ]
        self._jacobian = np.zeros((3, self._model.nv))
        self.met: tuple[int, int] = (-1, -1)
        """The pair of geoms that the last `touches` found."""

    def _set_margins(self, robot: Robot) -> set[int]:
        """Have contacts listed before anything touches; the geoms of the arms' last links, fingers
        among them.
        """
        model = self._model
        last = [int(model.site(arm.palm).bodyid[0]) for arm in robot.arms]
        held = last + below(model, last)
        tips = np.isin(model.geom_bodyid, held)
        arms = np.isin(model.geom_bodyid, [*held, *model.body_parentid[last]])
        for own, far, links in (self._model, MARGIN, tips), (self._wide, FAR, arms):
            own.geom_margin[self._obstacles] = far
            own.geom_margin[links] = MARGIN  # those of the arms with the rest of the robot
            mujoco.mj_setConst(own, mujoco.MjData(own))  # bodies have margins, too
        return set(np.flatnonzero(tips & (model.geom_contype > 0)).tolist())

    @staticmethod
    def angles_of(robot: Robot, pose: str) -> Array:
        """Action joint angles of a named pose, (n_u,) [rad]."""
        return np.array([robot.poses[pose].get(name, 0.0) for name in robot.action_joints])

    def approaches(self, angles: Array) -> list[Approach]:
        """What is near: the arms' last links and obstacles within FAR, other links within BESIDE,
        and arms beside the rest of the robot.
        """
        self.palms(angles)
        mujoco.mj_collision(self._wide, self._data)
        mujoco.mj_comPos(self._wide, self._data)
        contact = self._data.contact
        found = []
        for pair, gap, frame, place in zip(
            contact.geom.tolist(), contact.dist.tolist(), contact.frame, contact.pos, strict=True
        ):
            tip, solid = not self._tip_geoms.isdisjoint(pair), not self._solid.isdisjoint(pair)
            if frozenset(pair) in self._resting or not (solid or self._apart(*pair)):
                continue
            if self._sole_geoms.isdisjoint(pair) and gap < (FAR if tip and solid else BESIDE):
                first, second = (self._rate(place, frame[:3], geom) for geom in pair)
                found.append(Approach(first - second, gap, tip, solid))
        return found

    def leaning(self) -> Approach:
        """The torso beside the angle at which it counts as tipped, both in radians, at the angles
        of the last `approaches`.
        """
        up = self._data.xmat[self._torso].reshape(3, 3)[:, 2]
        mujoco.mj_jacBody(self._wide, self._data, None, self._jacobian, self._torso)
        turning = self._jacobian[:, self._dofs]  # (3, n_u)
        lean = float(np.arccos(np.clip(up[2], -1.0, 1.0)))
        rising = turning[0] * up[1] - turning[1] * up[0]  # of the upper end of its axis
        return Approach(
            -rising / max(np.sin(lean), UPRIGHT), self._tilt - lean, tip=False, solid=False
        )

    def _rate(self, point: Array, along: Array, geom: int) -> Array:
        """How a point of a geom moves along a direction with the joints, (n_u,) [m/rad]."""
        mujoco.mj_jac(
            self._wide, self._data, self._jacobian, None, point, self._wide.geom_bodyid[geom]
        )
        return np.asarray(along @ self._jacobian[:, self._dofs])

    def place(self, spheres: Array) -> None:
        """Put the sphere obstacles where a problem has them, rows of x, y, z, radius."""
        for i, (x, y, z, radius) in enumerate(spheres):
            geom, body = self._model.geom(sphere_geom(i)).id, self._model.body(sphere_geom(i))
            self._data.mocap_pos[body.mocapid[0]] = x, y, z
            for model in (
                self._model,
                self._wide,
            ):  # all that mj_setConst would work out from the size, a hundred times faster
                model.geom_size[geom, 0] = model.geom_rbound[geom] = radius
                model.geom_aabb[geom, 3:] = model.bvh_aabb[model.body_bvhadr[body.id], 3:] = radius

    def palms(self, angles: Array) -> Array:
        """Palm positions at joint angles (n_u,), (k, 3) [m]."""
        self._data.qpos[self._qpos] = angles
        mujoco.mj_kinematics(self._model, self._data)
        return np.asarray(self._data.site_xpos[self._sites].copy())

    def touches(self, angles: Array, *, clearance: float = 0.0, own: float = 0.0) -> bool:
        """The robot touches itself or an obstacle, or comes too close.

        Args:
            angles: Joint angles, (n_u,) [rad].
            clearance: Distance kept from obstacles, at most MARGIN [m].
            own: Distance that the arms' last links and fingers keep from the rest of the robot, at
                most MARGIN [m].
        """
        self.palms(angles)
        mujoco.mj_collision(self._model, self._data)
        contact = self._data.contact
        for pair, distance in zip(contact.geom.tolist(), contact.dist, strict=True):
            near = distance < (own if self._solid.isdisjoint(pair) else clearance)
            if distance >= 0.0 and not (self._solid & set(pair) or self._apart(*pair)):
                continue
            if near and self._sole_geoms.isdisjoint(pair) and frozenset(pair) not in self._resting:
                self.met = (pair[0], pair[1])
                return True
        return False

    def _apart(self, one: int, other: int) -> bool:
        """Whether the joints between two geoms could keep them apart."""
        return len((self._above[one] ^ self._above[other]) & self._driven) >= JOINTED

    def legal(self, angles: Array, *, clearance: float = 0.0) -> bool:
        """No touch (as `touches`), and the centre of mass over the feet."""
        if self.touches(angles, clearance=clearance):
            return False
        if not self._soles:
            return True
        mujoco.mj_comPos(self._model, self._data)
        corners = self._data.site_xpos[self._corners].copy()
        corners[:, 2] -= corners[:, 2].min()  # the base stands still: the soles are on the floor
        return bool(support_margin(self._data.subtree_com[self._base, :2], corners) > self._margin)

    def free(self, start: Array, end: Array, *, clearance: float, own: float = 0.0) -> bool:
        """The straight joint path from `start` (exclusive) to `end` touches nothing and keeps
        `clearance` from obstacles, and `own` from the robot itself as in `touches`.
        """
        count = max(int(np.ceil(np.abs(end - start).max() / RESOLUTION)), 1)
        return not any(
            self.touches(start + (end - start) * (i / count), clearance=clearance, own=own)
            for i in range(1, count + 1)
        )

    def solve(
        self,
        goals: Array,
        *,
        seed: Array | None = None,
        held: Array | None = None,
        clearance: float = 0.0,
    ) -> Array | None:
        """Legal joint angles with every palm on its goal, or None.

        Args:
            goals: Goal of each palm, shape (k, 3) [m].
            seed: Angles to start from and stay near, shape (n_u,); without it the robot's named
                poses, one after another.
            held: Angles of joints that do not move, shape (n_u,), NaN for those that do; None: all
                do.
            clearance: Distance kept from obstacles, at most MARGIN [m].
        """
        for start in self.seeds if seed is None else [seed]:
            angles = self.descend(goals, start, held=held)
            if angles is not None and self.legal(angles, clearance=clearance):
                return angles
        return None

    def descend(self, goals: Array, seed: Array, *, held: Array | None = None) -> Array | None:
        """Joint angles near `seed` with every palm on its goal, legal or not.

        None if there is no way. `held` as in `solve`.
        """
        moves = np.ones(len(seed), dtype=bool) if held is None else np.isnan(held)
        seed = seed if held is None else np.where(moves, seed, held)
        angles = np.clip(seed, self.limits[:, 0], self.limits[:, 1])
        identity = DAMPING**2 * np.eye(goals.size)
        for _ in range(ITERATIONS):
            gap = (goals - self.palms(angles)).ravel()
            if np.abs(gap).max() < TOLERANCE:
                return angles
            J = (
                self._palm_jacobian() * moves / self._effort
            )  # (3k, n_u), in joint coordinates weighted by effort
            inverse = np.linalg.solve(J @ J.T + identity, np.column_stack([gap, J]))
            posture = POSTURE * (seed - angles) * self._effort * moves
            step = (J.T @ inverse[:, 0] + posture - J.T @ (inverse[:, 1:] @ posture)) / self._effort
            step *= min(1.0, STEP / max(np.abs(step).max(), 1e-12))
            angles = np.clip(angles + step, self.limits[:, 0], self.limits[:, 1])
        return None

    def _palm_jacobian(self) -> Array:
        mujoco.mj_comPos(self._model, self._data)
        rows = []
        for site in self._sites:
            mujoco.mj_jacSite(self._model, self._data, self._jacobian, None, site)
            rows.append(self._jacobian[:, self._dofs])
        return np.concatenate(rows)
