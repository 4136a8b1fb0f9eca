"""A policy whose actions are turned along what is near before they are executed.

The network decides where to go; a velocity damper (`avoid.slide`) decides how fast a link may come
closer to a sphere on the way, and an arm to the robot itself, and how far the torso may lean. It
knows the robot's kinematics, as the expert does, and takes the base to stand still.
"""

from __future__ import annotations

import numpy as np

from coordlog.contracts import Policy
from coordlog.episode import Array
from coordlog.kinematics.ik import Reach
from coordlog.policies.avoidance import DamperConfig, farthest, turned
from coordlog.sim.task import BoundTask


class Shielded:
    """Another policy, shielded from spheres."""

    def __init__(self, policy: Policy, task: BoundTask, reach: Reach, config: DamperConfig) -> None:
        """Take the kinematics of a scene with spheres."""
        self._policy, self._task, self._reach, self._config = policy, task, reach, config
        self._step = task.speeds * task.config.control_period  # (n_u,) rad per step at action 1

    def begin(self, ids: Array, state: Array, rngs: list[np.random.Generator]) -> None:
        """As the policy begins."""
        self._policy.begin(ids, state, rngs)

    def act(self, ids: Array, state: Array) -> Array:
        """What the policy wants, as far as what is near lets it, (n, n_u) float32."""
        view = self._task.view
        wanted = self._policy.act(ids, state)
        angles = view.physical(state, "angles")
        spheres, palms, goals = (
            view.physical(state, name).reshape(len(state), -1, width)
            for name, width in (("spheres", 4), ("palms", 3), ("goals", 3))
        )
        found: Array = np.empty_like(wanted)
        for row, (q, action) in enumerate(zip(angles, wanted, strict=True)):
            self._reach.place(spheres[row])
            found[row] = turned(
                self._reach,
                q,
                action,
                step=self._step,
                config=self._config,
                distance=farthest(palms[row], goals[row]),
            )
        return found
