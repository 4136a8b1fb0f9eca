"""A policy whose actions are turned along what is near before they are executed.

The network decides where to go; a velocity damper (`avoid.slide`) decides how fast a link may come closer to a sphere on the way, and a
forearm to the robot itself. It knows the robot's kinematics, as the expert does, and takes the base to stand still.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from coordlog.episode import Array
from coordlog.sim.avoid import gap_at, turned
from coordlog.sim.ik import Reach
from coordlog.sim.task import Task


class Shielded:
    """Another policy, shielded from spheres."""

    def __init__(self, policy: Any, task: Task, reach: Reach) -> None:
        """Take the kinematics of a scene with spheres."""
        self._policy, self._task, self._reach = policy, task, reach
        self._step = task.speeds * task.config.control_period  # (n_u,) rad per step at action 1

    def begin(self, ids: Array, state: Array, rngs: list[np.random.Generator]) -> None:
        """As the policy begins."""
        self._policy.begin(ids, state, rngs)

    def act(self, ids: Array, state: Array) -> Array:
        """What the policy wants, as far as spheres let it, (n, n_u) float32."""
        view = self._task.view
        wanted = self._policy.act(ids, state)
        angles, spheres = view.physical(state, "angles"), view.physical(state, "spheres").reshape(len(state), -1, 4)
        away = (view.physical(state, "goals") - view.physical(state, "palms")).reshape(len(state), -1, 3)
        distance = np.linalg.norm(away, axis=2).max(axis=1)
        found: Array = np.empty_like(wanted)
        for row, (q, action, around) in enumerate(zip(angles, wanted, spheres, strict=True)):
            self._reach.place(around)
            found[row] = turned(self._reach, q, action, step=self._step, safe=gap_at(float(distance[row])))
        return found
