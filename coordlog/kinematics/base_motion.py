"""The configurations of a whole model along one episode, with the action joints standing elsewhere
than they did.
"""

from __future__ import annotations

import mujoco
import numpy as np

from coordlog.episode import Array, Episode
from coordlog.errors import FormatError
from coordlog.kinematics.levers import FREE, HINGE, SLIDE
from coordlog.robots.robot import Robot

STATE = mujoco.mjtState.mjSTATE_INTEGRATION


class Logged:
    """The log's configurations, linear in time, its action joints replaced."""

    def __init__(self, model: mujoco.MjModel, robot: Robot, *, time: Array, qpos: Array) -> None:
        """Find the action joints.

        Args:
            model: Robot and scene.
            robot: Names of the action joints.
            time: Times of the logged configurations, (T,), T ≥ 2, increasing [s].
            qpos: The logged configurations (T, n_q).

        Raises:
            FormatError: if the model lacks a joint that the robot names.
        """
        try:
            self.joints: list[int] = [model.joint(name).id for name in robot.action_joints]
            """Ids of the action joints."""
        except KeyError as error:
            raise FormatError(
                f"the attached model lacks what robot '{robot.name}' names: "
                f"{str(error).splitlines()[0]}"
            ) from error
        self.time, self.qpos = time, qpos
        self._places: Array = model.jnt_qposadr[self.joints]
        free = model.jnt_qposadr[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE] + 3
        ball = model.jnt_qposadr[model.jnt_type == mujoco.mjtJoint.mjJNT_BALL]
        self._turns = [slice(int(place), int(place) + 4) for place in (*free, *ball)]

    def whole(self, time: Array, q: Array) -> Array:
        """Configurations of the whole model at `time` (n,) [s] with the action joints at q (n, n_u)
        [rad], (n, n_q).
        """
        last = len(self.time) - 1
        after = np.clip(np.searchsorted(self.time, time), 1, last)
        before = after - 1
        share = np.clip(
            (time - self.time[before]) / (self.time[after] - self.time[before]), 0.0, 1.0
        )[:, None]
        a, b = self.qpos[before], self.qpos[after]
        qpos = a + share * (b - a)
        for place in self._turns:
            turn = a[:, place] * (1.0 - share) + b[:, place] * (
                share * np.sign((a[:, place] * b[:, place]).sum(axis=1, keepdims=True))
            )
            qpos[:, place] = turn / np.linalg.norm(turn, axis=1, keepdims=True)
        qpos[:, self._places] = q
        return np.asarray(qpos)


def speeds(model: mujoco.MjModel, time: Array, qpos: Array) -> Array:
    """How fast every joint moves between logged configurations, at most [rad/s, m/s], and last how
    fast each free body shifts [m/s], (T - 1, n_jnt + n_free).
    """
    turned, shifted = np.zeros((len(time) - 1, model.njnt)), []
    for joint in range(model.njnt):
        place, kind = int(model.jnt_qposadr[joint]), int(model.jnt_type[joint])
        if kind in (HINGE, SLIDE):
            turned[:, joint] = np.abs(np.diff(qpos[:, place]))
            continue
        if kind == FREE:
            shifted.append(np.linalg.norm(np.diff(qpos[:, place : place + 3], axis=0), axis=1))
            place += 3
        turn = qpos[:, place : place + 4]
        half = np.arccos(np.clip(np.abs((turn[1:] * turn[:-1]).sum(axis=1)), 0.0, 1.0))
        # A straight line between quaternions turns fastest in its middle.
        turned[:, joint] = 4.0 * np.tan(half / 2.0)
    return np.asarray(np.column_stack([turned, *shifted]) / np.diff(time)[:, None])


def require_fit(model: mujoco.MjModel, initial: Array, episode: Episode) -> None:
    """Refuse a model and a first state that are not an episode's.

    Raises:
        FormatError: if a length differs.
    """
    wanted = mujoco.mj_stateSize(model, STATE)
    if initial.shape != (wanted,) or model.nq != episode.qpos.shape[1]:
        raise FormatError(
            f"attached model and state: expected {wanted} numbers and "
            f"nq = {episode.qpos.shape[1]}, got {initial.size}, {model.nq}"
        )
