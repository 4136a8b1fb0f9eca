"""What a path asks of the servos and of the feet: inverse dynamics along it, nothing simulated.

The base, the legs and the head stand where the log had them at that time, at rest; the action
joints move as the path says. Torques are those of the rigid bodies, of the rotors' inertia and of
the motors' damping. Dry friction, contacts and joint stops are left out: they answer to a motion
that happens, and a path alone does not say how.
"""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from coordlog.episode import Array
from coordlog.kinematics.base_motion import Logged
from coordlog.kinematics.support import FALLING, Footing

_STAGES = (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_comVel, mujoco.mj_passive)
"""What Newton-Euler needs to know: of `mj_inverse` the part that is used here, and no
constraint."""


class Load(NamedTuple):
    """What n states of the action joints ask for."""

    torque: Array
    """Of the action joints, (n, n_u) [Nm]."""
    balance: Array
    """Signed distance of the zero-moment point to the edge of the support polygon, (n,) [m]; no
    more than FALLING outside without any support, infinite for a robot that stands on nothing."""


class Inverse:
    """Inverse dynamics along one episode."""

    def __init__(self, model: mujoco.MjModel, logged: Logged, footing: Footing) -> None:
        """Prepare for the logged configurations."""
        self._model, self._data = model, mujoco.MjData(model)
        self._logged, self._footing = logged, footing
        self._dofs: Array = model.jnt_dofadr[logged.joints]
        self._base = int(model.body_rootid[model.jnt_bodyid[logged.joints[0]]])
        first = int(model.body_dofadr[self._base])
        self._push, self._turn = slice(first, first + 3), slice(first + 3, first + 6)

    def __call__(self, time: Array, q: Array, velocity: Array, acceleration: Array) -> Load:
        """Load of the action joints' states (n, n_u) in rad, rad/s and rad/s² at times (n,) of the
        log [s].
        """
        model, data, corners = self._model, self._data, self._footing.corners
        force, n = np.zeros(model.nv), len(q)
        torque, point, sites = (
            np.empty((n, len(self._dofs))),
            np.zeros((n, 2)),
            np.zeros((n, len(corners), 3)),
        )
        data.qvel[:] = data.qacc[:] = 0.0
        for i, row in enumerate(self._logged.whole(time, q)):
            data.qpos[:], data.qvel[self._dofs], data.qacc[self._dofs] = (
                row,
                velocity[i],
                acceleration[i],
            )
            for stage in _STAGES:
                stage(model, data)
            mujoco.mj_rne(model, data, 1, force)
            torque[i] = (
                force[self._dofs]
                + model.dof_armature[self._dofs] * acceleration[i]
                - data.qfrc_passive[self._dofs]
            )
            if corners:
                moment = (
                    data.xmat[self._base].reshape(3, 3) @ force[self._turn]
                )  # MuJoCo turns a free base in its own frame
                point[i], sites[i] = (
                    _zero_moment(data.xpos[self._base], force[self._push], moment),
                    data.site_xpos[corners],
                )
        balance = (
            np.maximum(self._footing.margin(time, point, sites), FALLING)
            if corners
            else np.full(n, np.inf)
        )
        return Load(torque, np.asarray(balance))


def _zero_moment(place: Array, force: Array, moment: Array) -> Array:
    """Where on the floor z = 0 the floor's push can act, (2,) [m], if at `place` it is this force
    and moment [N, Nm].
    """
    lift = max(float(force[2]), 1e-3)
    x, y, z = place
    return np.array([x - (moment[1] + z * force[0]) / lift, y + (moment[0] - z * force[1]) / lift])
