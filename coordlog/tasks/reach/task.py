"""The paper's task, as the contract asks for it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from coordlog.contracts import Kinematics, Reading, Sample, View
from coordlog.episode import Array, Json
from coordlog.robots.robot import Robot
from coordlog.spec import Field
from coordlog.tasks import goals
from coordlog.tasks.config import EnvConfig, RewardConfig
from coordlog.tasks.reach import reward as rules
from coordlog.tasks.reach.fields import FIELDS
from coordlog.tasks.reach.observation import StateView, state_view
from coordlog.tasks.scene import Scene


class ReachTask:
    """Bring every palm to its goal at the same step.

    Example:
        >>> from coordlog.tasks.config import EnvConfig, RewardConfig
        >>> task = ReachTask(EnvConfig(), RewardConfig())
        >>> distance = np.array([[0.01, 0.05]])
        >>> task.derive({"distance": distance})["goal"].tolist()
        [[True, False]]
    """

    name = "reach"
    fields: tuple[Field, ...] = FIELDS
    throughout = False
    defaults: ClassVar[Json] = {}
    """Constants of the environment that differ from `EnvConfig`'s."""

    def __init__(self, config: EnvConfig, constants: RewardConfig) -> None:
        self._config, self._constants = config, constants

    def to_json(self) -> Json:
        """Its name: it has no constants beside those of the environment and the reward."""
        return {"name": self.name}

    def view(self, robot: Robot, limits: Array, *, spheres: int) -> StateView:
        """Angles, palms, goals, spheres, and the extras of the configuration."""
        return state_view(robot, limits, spheres=spheres, config=self._config)

    def parts(self, reading: Reading, view: View) -> dict[str, Array]:
        """Their values."""
        return goals.parts(reading, view)

    def given(self, reading: Reading) -> dict[str, Array]:
        """Nothing: goals stand still, and the header has them."""
        return {}

    def measure(self, reading: Reading) -> dict[str, Array]:
        """Distance, collision and instability."""
        return goals.measure(reading)

    def derive(self, columns: Mapping[str, Array]) -> dict[str, Array]:
        """Boundary and goal flags."""
        boundary, goal = rules.proximity(columns["distance"], self._config)
        return {"boundary": boundary, "goal": goal}

    def reward(self, columns: Mapping[str, Array]) -> Array:
        """The paper's reward of each arm, (n, k)."""
        return rules.rewards(columns["distance"], goals.flags_of(columns), self._constants)

    def ended(self, columns: Mapping[str, Array]) -> Array:
        """A fall, or every goal reached, (n,) bool."""
        return rules.ended(columns["goal"], columns["instability"])

    def accomplished(self, columns: Mapping[str, Array]) -> Array:
        """Every palm within its goal radius, (n,) bool."""
        return np.asarray(columns["goal"].all(axis=-1))

    def mishaps(self, columns: Mapping[str, Array]) -> Array:
        """Collision or instability, (n,) bool."""
        return goals.mishaps(columns)

    def sample(
        self, rng: np.random.Generator, scene: Scene, kinematics: Kinematics, angles: Array
    ) -> Sample | None:
        """The sides of an object drawn in the scene's box, or without one a posture's palms; None
        if there is no such posture.
        """
        if scene.object_box is None:
            palms = goals.anywhere(rng, kinematics)
            return None if palms is None else Sample(palms, reachable=True)
        centre = goals.inside(rng, scene.object_box)
        sides = np.array([scene.palm_offset, -scene.palm_offset])
        points = np.stack([centre + np.array([0.0, side, 0.0]) for side in sides])
        return Sample(points, centre)
