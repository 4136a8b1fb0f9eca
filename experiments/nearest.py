"""How close the robot comes to what stands around it, exactly, at the end of every control step."""

from __future__ import annotations

from copy import copy

import mujoco
import numpy as np

from coordlog.episode import Array
from coordlog.kinematics.pairs import obstacles
from coordlog.sim.env import BatchEnv

FAR = 2.0
"""Distances are looked for up to this [m]."""


class Nearest:
    """Distances of the simulations of one environment to panels and spheres.

    The floor is none of these.
    """

    def __init__(self, env: BatchEnv) -> None:
        """Copy the model; nothing here touches a simulation."""
        self._env, self._model = env, copy(env.task.model)
        model = self._model
        self._data = mujoco.MjData(model)
        self._obstacles = obstacles(model)
        bodies = model.geom_bodyid
        self._robot = np.flatnonzero(
            (bodies > 0) & (model.body_mocapid[bodies] < 0) & (model.geom_contype > 0)
        )

    @property
    def known(self) -> bool:
        """Whether the scene has obstacles at all."""
        return len(self._obstacles) > 0

    def of(self, sim: int) -> float:
        """Distance of one simulation's robot to the nearest obstacle now [m].

        Negative where one is inside the other.
        """
        physics = self._env.physics
        return self.at(physics.qpos[sim], physics.mocap_pos[sim], self._env.simulation.radii[sim])

    def at(self, qpos: Array, mocap_pos: Array, radii: Array) -> float:
        """The same for a configuration (n_q,), and where the mocap bodies and how large the spheres
        are.
        """
        model, data = self._model, self._data
        data.qpos[:], data.mocap_pos[:] = qpos, mocap_pos
        model.geom_size[self._env.task.sphere_geoms, 0] = model.geom_rbound[
            self._env.task.sphere_geoms
        ] = radii
        mujoco.mj_kinematics(model, data)
        bound = self._bounds()
        nearest = FAR
        for flat in np.argsort(bound, axis=None):
            i, j = np.unravel_index(flat, bound.shape)
            if bound[i, j] >= nearest:
                break
            nearest = min(
                nearest,
                mujoco.mj_geomDistance(
                    model, data, int(self._robot[i]), int(self._obstacles[j]), FAR, None
                ),
            )
        return float(nearest)

    def _bounds(self) -> Array:
        """No pair is nearer than this, (robot geoms, obstacles) [m]."""
        model, data = self._model, self._data
        bound = np.empty((len(self._robot), len(self._obstacles)))
        for j, geom in enumerate(self._obstacles):
            away = data.geom_xpos[self._robot] - data.geom_xpos[geom]
            if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
                away = np.maximum(
                    np.abs(away @ data.geom_xmat[geom].reshape(3, 3)) - model.geom_size[geom], 0.0
                )
                bound[:, j] = np.linalg.norm(away, axis=1)
            else:
                bound[:, j] = np.linalg.norm(away, axis=1) - model.geom_rbound[geom]
        return np.asarray(bound - model.geom_rbound[self._robot][:, None])
