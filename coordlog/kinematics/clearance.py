"""Is a configuration allowed, and how far is it from trouble? The checker that smoothing asks, for
one recorded episode.

The action joints stand where the path puts them; the free base and every other joint stand where
the log says they were at that time. Trouble is contact of the robot with the scene or with itself,
and the centre of mass leaving the support polygon. Soles may touch the floor; pairs of geoms that
no action joint moves against one another are the log's business and not looked at.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from typing import NamedTuple

import mujoco
import numpy as np

from coordlog.config import build
from coordlog.episode import INITIAL_STATE, Array, Episode
from coordlog.errors import FormatError
from coordlog.kinematics.base_motion import Logged
from coordlog.kinematics.inverse_dynamics import Inverse
from coordlog.kinematics.motion_bounds import bounds
from coordlog.kinematics.support import FALLING, Footing
from coordlog.mjcf import load_attached
from coordlog.robots.robot import Robot
from coordlog.tasks.config import EnvConfig

STATE = mujoco.mjtState.mjSTATE_INTEGRATION
NEAR = 0.08
"""Distances up to this are measured [m].

Pairs whose bounding spheres are further apart get that lower bound.
"""
NEVER = -1e3  # m: a contact margin that no contact meets


class Verdict(NamedTuple):
    """What a checker says about n configurations."""

    free: Array  # (n,) bool
    depth: Array  # (n,) m, by how much the worst pair falls short; 0 where free
    what: Array  # (n,) index of that pair; -1 where free


class Bodies(NamedTuple):
    """Where everything is at n configurations."""

    qpos: Array  # (n, n_q)
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
    ) -> None:
        """Find the pairs and their bounds.

        Args:
            model: Robot and scene; copied, not changed.
            robot: Names of the action joints and soles.
            config: Its balance margin counts.
            time: Times of the logged configurations, (T,), T ≥ 2, increasing [s].
            qpos: The logged configurations (T, n_q).
            initial: mjSTATE_INTEGRATION vector whose goals and obstacles hold throughout.

        Raises:
            FormatError: if the model lacks what the robot names, or has joints other than hinges on
                a free base.
        """
        self._model, self._data = copy(model), mujoco.MjData(model)
        mujoco.mj_setState(model, self._data, initial, STATE)
        self._model.pair_margin[:] = NEVER  # soles on the floor
        self._time, self._margin = time, config.balance_margin
        self._logged = Logged(model, robot, time=time, qpos=qpos)
        self._footing, self._joints = Footing(model, robot, self._logged), self._logged.joints
        self._corners = self._footing.corners
        found = bounds(model, self._joints, self._corners)
        self._keep, self._index, self._mass = found.keep, found.place, found.mass
        self.pairs = found.pairs
        """Geom ids of the pairs that are looked at, (P', 2).

        Balance is one more pair after them.
        """
        self.inverse = Inverse(self._model, self._logged, self._footing)
        self.reach: Array = found.change[:, self._joints]
        """Metres by which a radian of each action joint changes the distance of each pair, at most,
        (P, n_u)."""
        self._drift = (
            np.delete(_speeds(model, time, qpos), self._joints, axis=1)
            @ np.delete(found.change, self._joints, axis=1).T
        )
        if self._corners:  # a corner that comes to or leaves the floor changes the balance at once
            lifted = np.flatnonzero(np.diff(self._footing.standing, axis=0).any(axis=1))
            self._drift[np.clip(lifted[:, None] + (-1, 0, 1), 0, len(self._drift) - 1), -1] = np.inf

    @classmethod
    def of(cls, episode: Episode, attachments: Mapping[str, bytes]) -> SceneChecker:
        """The checker of a recorded episode, from the file's attachments.

        Raises:
            FormatError: if the model or the first state is missing, damaged, or not the episode's.
        """
        model = load_attached(attachments)
        initial = np.frombuffer(attachments.get(INITIAL_STATE, b""), dtype="<f8")
        wanted = mujoco.mj_stateSize(model, STATE)
        if initial.shape != (wanted,) or model.nq != episode.qpos.shape[1]:
            raise FormatError(
                f"attached model and state: expected {wanted} numbers and nq = {episode.qpos.shape[1]}, got {initial.size}, {model.nq}"
            )
        robot, config = (
            Robot.from_json(episode.header.env["robot"]),
            build(EnvConfig, episode.header.env["config"]),
        )
        return cls(model, robot, config, time=episode.time, qpos=episode.qpos, initial=initial)

    def check(self, time: Array, q: Array, clearance: float) -> Verdict:
        """Judge n configurations of the action joints, q (n, n_u) [rad] at `time` (n,) [s].

        Pairs must keep `clearance` [m].
        """
        model, data = self._model, self._data
        model.geom_margin[:] = clearance
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
        if self._corners:
            short = -self._balance(time, com, corners)
            worse = short > depth
            depth, what = np.where(worse, short, depth), np.where(worse, balance, what)
        return Verdict(what < 0, depth, what)

    def moving(self, time: Array, q: Array, velocity: Array, acceleration: Array) -> Verdict:
        """Judge the zero-moment point of n states of the action joints, (n, n_u) each: over the
        feet, with the task's margin.
        """
        short = self._margin - self.inverse(time, q, velocity, acceleration).balance
        return Verdict(
            short <= 0.0, np.maximum(short, 0.0), np.where(short > 0.0, len(self.pairs) + 1, -1)
        )

    def slack(self, time: Array, q: Array, clearance: float) -> Array:
        """Distance left to each pair, (n, P) [m]: exact up to NEAR, beyond it a lower bound.

        And the margin of balance.
        """
        bodies = self._place(self._logged.whole(time, q))
        distance = self._apart(bodies.centre)
        row, pair = np.nonzero(distance < clearance + NEAR)
        model, data, last = self._model, self._data, -1
        first, second = self.pairs.T.tolist()
        for i, p in zip(row.tolist(), pair.tolist(), strict=True):
            if i != last:
                data.geom_xpos[:], data.geom_xmat[:], last = bodies.centre[i], bodies.frame[i], i
            distance[i, p] = mujoco.mj_geomDistance(
                model, data, first[p], second[p], clearance + NEAR, None
            )
        distance -= clearance * self._keep
        if not self._corners:
            return np.asarray(distance)
        return np.concatenate(
            [distance, self._balance(time, bodies.com, bodies.corners)[:, None]], axis=1
        )

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

        No more than NEAR.
        """
        if not self._keep.any():
            return NEAR
        return min(NEAR, float(self.slack(time, q, 0.0)[:, : len(self.pairs)][:, self._keep].min()))

    def describe(self, what: int) -> str:
        """Name a pair."""
        if what >= len(self.pairs):
            return f"the {'centre of mass' if what == len(self.pairs) else 'zero-moment point'} and the edge of its support"
        first, second = (self._model.geom(int(geom)).name for geom in self.pairs[what])
        return f"{first} and {second}"

    def _place(self, qpos: Array) -> Bodies:
        model, data, n = self._model, self._data, len(qpos)
        centre, frame = np.empty((n, model.ngeom, 3)), np.empty((n, model.ngeom, 9))
        com, corners = np.empty((n, 2)), np.empty((n, len(self._corners), 3))
        here, mid, site, position, matrix = (
            data.qpos,
            data.xipos,
            data.site_xpos,
            data.geom_xpos,
            data.geom_xmat,
        )
        for i in range(n):
            here[:] = qpos[i]
            mujoco.mj_kinematics(model, data)
            centre[i], frame[i], com[i], corners[i] = (
                position,
                matrix,
                (self._mass @ mid)[:2],
                site[self._corners],
            )
        return Bodies(qpos, centre, frame, com, corners)

    def _apart(self, centre: Array) -> Array:
        """Lower bounds on all distances, (n, P') [m]: sphere to sphere, and to planes and boxes of
        the world as they are.
        """
        model, data = self._model, self._data
        first, second = self.pairs.T
        bound = (
            np.linalg.norm(centre[:, first] - centre[:, second], axis=2)
            - model.geom_rbound[first]
            - model.geom_rbound[second]
        )
        for geom in np.unique(self.pairs[model.geom_bodyid[self.pairs] == 0]):
            columns = np.flatnonzero((first == geom) | (second == geom))
            other = np.where(first[columns] == geom, second[columns], first[columns])
            away = (centre[:, other] - data.geom_xpos[geom]) @ data.geom_xmat[geom].reshape(3, 3)
            if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
                bound[:, columns] = away[..., 2] - model.geom_rbound[other]
            elif model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
                outside = np.maximum(np.abs(away) - model.geom_size[geom], 0.0)
                bound[:, columns] = np.linalg.norm(outside, axis=2) - model.geom_rbound[other]
        return np.asarray(bound)

    def _balance(self, time: Array, com: Array, corners: Array) -> Array:
        """Margin of the centre of mass over the feet, less the one the task asks for, (n,) [m]."""
        return np.asarray(
            np.maximum(self._footing.margin(time, com, corners) - self._margin, FALLING)
        )


def _speeds(model: mujoco.MjModel, time: Array, qpos: Array) -> Array:
    """How fast every joint turns between logged configurations, at most [rad/s], and last the base
    shifts [m/s], (T - 1, n_jnt + 1).
    """
    moved = np.zeros((len(time) - 1, model.njnt + 1))
    for joint in range(model.njnt):
        place = int(model.jnt_qposadr[joint])
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE:
            moved[:, joint] = np.abs(np.diff(qpos[:, place]))
        else:
            moved[:, -1] = np.linalg.norm(np.diff(qpos[:, place : place + 3], axis=0), axis=1)
            turn = qpos[:, place + 3 : place + 7]
            half = np.arccos(np.clip(np.abs((turn[1:] * turn[:-1]).sum(axis=1)), 0.0, 1.0))
            moved[:, joint] = 4.0 * np.tan(
                half / 2.0
            )  # a straight line between quaternions turns fastest in its middle
    return np.asarray(moved / np.diff(time)[:, None])
