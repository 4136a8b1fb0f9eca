"""Is a configuration allowed, and how far is it from trouble? The checker that smoothing asks, for
one recorded episode.

The action joints stand where the path puts them; the free base and every other joint stand where
the log says they were at that time. Trouble is contact of the robot with the scene or with itself,
and the centre of mass leaving the support polygon. Soles may touch the floor; pairs of geoms that
no action joint moves against one another are the log's business and not looked at.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from typing import NamedTuple

import mujoco
import numpy as np

from coordlog.config import build
from coordlog.contracts import Verdict
from coordlog.episode import INITIAL_STATE, Array, Episode
from coordlog.kinematics.base_motion import STATE, Logged, require_fit, speeds
from coordlog.kinematics.geometry import geom_label
from coordlog.kinematics.inverse_dynamics import Inverse
from coordlog.kinematics.levers import HINGE, SLIDE, strokes
from coordlog.kinematics.motion_bounds import bounds
from coordlog.kinematics.pairs import distance_bounds, overestimate
from coordlog.kinematics.support import FALLING, Footing
from coordlog.mjcf import load_attached
from coordlog.robots.robot import Robot
from coordlog.tasks.config import EnvConfig

NEAR = 0.08
"""Distances up to this are measured [m].

Pairs whose bounding spheres are further apart get that lower bound.
"""
NEVER = -1e3  # m: a contact margin that no contact meets


class Bodies(NamedTuple):
    """Where everything is at n configurations."""

    centre: Array  # (n, n_geom, 3) m
    frame: Array  # (n, n_geom, 9)
    com: Array  # (n, 2) m
    corners: Array  # (n, C, 3) m


class SceneChecker:
    """Collision with clearance, self-collision and balance along one episode.

    Fits `coordlog.smooth.feasibility.DistanceChecker`.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        robot: Robot,
        config: EnvConfig,
        *,
        time: Array,
        qpos: Array,
        initial: Array,
        resting: Sequence[tuple[int, int]] = (),
    ) -> None:
        """Find the pairs and their bounds.

        Args:
            model: Robot and scene; copied, not changed.
            robot: Names of the action joints and soles.
            config: Its balance margin counts.
            time: Times of the logged configurations, (T,), T ≥ 2, increasing [s].
            qpos: The logged configurations (T, n_q).
            initial: mjSTATE_INTEGRATION vector whose goals and obstacles hold throughout.
            resting: Pairs of geoms that lie against one another by design, and are not looked at.

        Raises:
            FormatError: if the model lacks what the robot names.
        """
        self._model, self._data = copy(model), mujoco.MjData(model)
        mujoco.mj_setState(model, self._data, initial, STATE)
        self._time, self._margin = time, config.balance_margin
        self._logged = Logged(model, robot, time=time, qpos=qpos)
        self._footing, self._joints = Footing(model, robot, self._logged), self._logged.joints
        self._corners = self._footing.corners
        ways = strokes(model, qpos)
        soles = [model.geom(name).id for name in robot.soles]
        found = bounds(model, self._joints, self._corners, soles=soles, ways=ways, resting=resting)
        self._keep, self._index, self._mass = found.keep, found.place, found.mass
        self.pairs = found.pairs
        """Geom ids of the pairs that are looked at, (P', 2).

        Balance is one more pair after them, the ends of the slides' ways another.
        """
        kinds = model.jnt_type[self._joints]
        self.units: tuple[str, ...] = tuple("m" if kind == SLIDE else "rad" for kind in kinds)
        """Unit of each action joint."""
        free = model.jnt_limited[self._joints] == 0
        self.limits: Array = model.jnt_range[self._joints].copy()
        """Their ranges, infinite where unlimited, (n_u, 2)."""
        self.limits[free] = -np.inf, np.inf
        turns = (kinds == HINGE) & free
        self.continuous: tuple[int, ...] = tuple(np.flatnonzero(turns).tolist())
        """Which of the action joints turn without end."""
        self._slides: Array = np.flatnonzero(kinds == SLIDE)
        self._ways: Array = ways[np.array(self._joints)[self._slides]]
        self._unsure = overestimate(model, self.pairs)
        self._listed = self._index[model.pair_geom1, model.pair_geom2] >= 0
        self._set_margin(0.0)
        self.inverse = Inverse(self._model, self._logged, self._footing)
        self.reach: Array = self._bounded(found.change, speeds(model, time, qpos))
        """Metres by which a radian or metre of each action joint changes each slack, at most,
        (P, n_u)."""

    def _bounded(self, change: Array, speed: Array) -> Array:
        """How each action joint changes each slack, at most; what all other motion does to them is
        kept beside it.

        Args:
            change: How each joint of the model changes each slack, at most, (P, n_v).
            speed: How fast each joint moved between two samples, (T - 1, n_v).
        """
        if len(self._slides):
            change = np.concatenate([change, np.zeros((1, change.shape[1]))])
            change[-1, np.array(self._joints)[self._slides]] = 1.0
        others = np.delete(speed, self._joints, axis=1)
        self._drift = others @ np.delete(change, self._joints, axis=1).T
        if self._corners:  # a corner that comes to or leaves the floor changes the balance at once
            lifted = np.flatnonzero(np.diff(self._footing.standing, axis=0).any(axis=1))
            rows = np.clip(lifted[:, None] + (-1, 0, 1), 0, len(self._drift) - 1)
            self._drift[rows, len(self.pairs)] = np.inf
        return np.asarray(change[:, self._joints])

    def _set_margin(self, margin: float) -> None:
        """Let the engine list contacts of all pairs that are looked at, up to a distance."""
        model = self._model
        model.geom_margin[:], model.geom_gap[:], model.pair_gap[:] = margin, 0.0, 0.0
        model.pair_margin[:] = np.where(self._listed, margin, NEVER)

    @classmethod
    def of(cls, episode: Episode, attachments: Mapping[str, bytes]) -> SceneChecker:
        """The checker of a recorded episode, from the file's attachments.

        Raises:
            FormatError: if the model or the first state is missing, damaged, or not the episode's.
        """
        model = load_attached(attachments)
        initial = np.frombuffer(attachments.get(INITIAL_STATE, b""), dtype="<f8")
        require_fit(model, initial, episode)
        robot = Robot.from_json(episode.header.env["robot"])
        config = build(EnvConfig, episode.header.env["config"])
        return cls(
            model,
            robot,
            config,
            time=episode.time,
            qpos=episode.qpos,
            initial=initial,
            resting=[(one, other) for one, other in episode.header.env.get("resting", [])],
        )

    def check(self, time: Array, q: Array, clearance: float) -> Verdict:
        """Judge n configurations of the action joints, q (n, n_u) [rad] at `time` (n,) [s].

        Pairs must keep `clearance` [m].
        """
        model, data = self._model, self._data
        self._set_margin(clearance)
        n, balance = len(q), len(self.pairs)
        depth, what = np.zeros(n), np.full(n, -1)
        com, corners = np.zeros((n, 2)), np.zeros((n, len(self._corners), 3))
        here, mid, site = data.qpos, data.xipos, data.site_xpos
        for i, row in enumerate(self._logged.whole(time, q)):
            here[:] = row
            mujoco.mj_kinematics(model, data)
            mujoco.mj_collision(model, data)
            com[i], corners[i] = (self._mass @ mid)[:2], site[self._corners]
            if data.ncon:
                contact = data.contact
                pair = self._index[contact.geom[:, 0], contact.geom[:, 1]]
                short = np.where(pair >= 0, clearance * self._keep[pair] - contact.dist, 0.0)
                worst = int(short.argmax())
                if short[worst] > 0.0:
                    depth[i], what[i] = short[worst], pair[worst]
        others = []
        if self._corners:
            others.append(-self._balance(time, com, corners))
        if len(self._slides):
            others.append(-self._way_left(q))
        for more, short in enumerate(others):
            worse = short > depth
            depth, what = np.where(worse, short, depth), np.where(worse, balance + more, what)
        return Verdict(what < 0, depth, what)

    def moving(self, time: Array, q: Array, velocity: Array, acceleration: Array) -> Verdict:
        """Judge the zero-moment point of n states of the action joints, (n, n_u) each: over the
        feet, with the task's margin.
        """
        short = self._margin - self.inverse(time, q, velocity, acceleration).balance
        what = np.where(short > 0.0, len(self.reach), -1)
        return Verdict(short <= 0.0, np.maximum(short, 0.0), what)

    def slack(self, time: Array, q: Array, clearance: float) -> Array:
        """Distance left to each pair, (n, P) [m]: exact up to NEAR, beyond it a lower bound.

        And the margin of balance.
        """
        bodies = self._place(self._logged.whole(time, q))
        distance = distance_bounds(self._model, self._data, self.pairs, bodies.centre)
        row, pair = np.nonzero(distance < clearance + NEAR)
        model, data, last = self._model, self._data, -1
        first, second = self.pairs.T.tolist()
        for i, p in zip(row.tolist(), pair.tolist(), strict=True):
            if i != last:
                data.geom_xpos[:], data.geom_xmat[:], last = bodies.centre[i], bodies.frame[i], i
            distance[i, p] = mujoco.mj_geomDistance(
                model, data, first[p], second[p], clearance + NEAR, None
            )
        distance -= clearance * self._keep + self._unsure
        columns = [distance]
        if self._corners:
            columns.append(self._balance(time, bodies.com, bodies.corners)[:, None])
        if len(self._slides):
            columns.append(self._way_left(q)[:, None])
        return np.concatenate(columns, axis=1)

    def drift(self, start: Array, stop: Array) -> Array:
        """Speed at which each slack may change within [start, stop] because the base and the other
        joints move, at most, (m, P) [m/s].
        """
        last = len(self._drift)
        first = np.clip(np.searchsorted(self._time, start, side="right") - 1, 0, last - 1)
        end = np.clip(np.searchsorted(self._time, stop, side="left"), first + 1, last)
        padded = np.concatenate(
            [self._drift, self._drift[-1:]]
        )  # reduceat wants every index inside the array
        return np.asarray(np.maximum.reduceat(padded, np.stack([first, end], axis=1).ravel())[::2])

    def nearest(self, time: Array, q: Array) -> float:
        """Least distance of any pair that keeps a clearance, over n configurations [m].

        No more than NEAR. A pair is measured again only once the motion may have brought it nearer
        than the least distance found so far.

        Args:
            time: Times, (n,), increasing [s].
            q: Configurations of the action joints, (n, n_u).
        """
        model, data, least = self._model, self._data, NEAR
        pairs = np.flatnonzero(self._keep)
        step = np.diff(time)[:, None] * self.drift(time[:-1], time[1:])[:, pairs]
        loss = np.abs(np.diff(q, axis=0)) @ self.reach[pairs].T + step
        bound = np.full(len(pairs), -np.inf)
        for i, row in enumerate(self._logged.whole(time, q)):
            bound = bound - loss[i - 1] if i else bound
            near = np.flatnonzero(bound < least).tolist()
            if near:
                data.qpos[:] = row
                mujoco.mj_kinematics(model, data)
            for k in near:
                first, second = self.pairs[pairs[k]].tolist()
                bound[k] = mujoco.mj_geomDistance(model, data, first, second, 2.0 * NEAR, None)
                least = min(least, float(bound[k]))
        return least

    def describe(self, what: int) -> str:
        """Name a pair."""
        if what < len(self.pairs):
            first, second = (geom_label(self._model, int(geom)) for geom in self.pairs[what])
            return f"{first} and {second}"
        if what == len(self.reach):
            return "the zero-moment point and the edge of its support"
        if self._corners and what == len(self.pairs):
            return "the centre of mass and the edge of its support"
        return "a slide and the end of its way"

    def _way_left(self, q: Array) -> Array:
        """Metres that a slide has left to either end of its way, the least of all, (n,)."""
        at = q[:, self._slides]
        return np.asarray(np.minimum(at - self._ways[:, 0], self._ways[:, 1] - at).min(axis=1))

    def _place(self, qpos: Array) -> Bodies:
        model, data, n = self._model, self._data, len(qpos)
        centre, frame = np.empty((n, model.ngeom, 3)), np.empty((n, model.ngeom, 9))
        com, corners = np.empty((n, 2)), np.empty((n, len(self._corners), 3))
        for i in range(n):
            data.qpos[:] = qpos[i]
            mujoco.mj_kinematics(model, data)
            centre[i], frame[i] = data.geom_xpos, data.geom_xmat
            com[i], corners[i] = (self._mass @ data.xipos)[:2], data.site_xpos[self._corners]
        return Bodies(centre, frame, com, corners)

    def _balance(self, time: Array, com: Array, corners: Array) -> Array:
        """Margin of the centre of mass over the feet, less the one the task asks for, (n,) [m]."""
        return np.asarray(
            np.maximum(self._footing.margin(time, com, corners) - self._margin, FALLING)
        )
