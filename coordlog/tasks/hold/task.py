"""Goals that start on the palms and move away slowly, all alike, as if both hands held one tray."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from coordlog.config import plain
from coordlog.contracts import Kinematics, Reading, Sample, View
from coordlog.episode import Array, Json
from coordlog.errors import ConfigError
from coordlog.robots.robot import Robot
from coordlog.spec import Field
from coordlog.tasks import goals
from coordlog.tasks.config import EnvConfig, RewardConfig
from coordlog.tasks.hold.fields import FIELDS
from coordlog.tasks.reach.observation import StateView, state_view
from coordlog.tasks.reach.reward import proximity, shaped
from coordlog.tasks.scene import Scene

CHECKS = 4
"""Places along the way at which a posture must hold the goals."""


@dataclass(frozen=True)
class HoldConfig:
    """How the goals move."""

    seconds: float = 3.0
    """Time that they take from one end of their way to the other [s]."""
    nearest: float = 0.05
    """Shortest way [m]."""
    farthest: float = 0.12
    """Longest way [m]."""

    def __post_init__(self) -> None:
        if not self.seconds > 0:
            raise ConfigError(f"task seconds: expected a positive number, got {self.seconds}")
        if not 0 <= self.nearest <= self.farthest:
            raise ConfigError(
                "task nearest, farthest: expected 0 ≤ nearest ≤ farthest, got "
                f"{self.nearest} and {self.farthest}"
            )


class HoldTask:
    """Keep every palm on its goal, which moves slowly, for the whole time.

    Success is every palm within its goal radius at every step until the time is over; only a fall
    ends an episode before.

    Example:
        >>> from coordlog.tasks.config import EnvConfig, RewardConfig
        >>> task = HoldTask(EnvConfig(max_steps=75), RewardConfig())
        >>> track = task.track(np.zeros((2, 3)), np.array([0.1, 0.0, 0.0]))
        >>> track.shape, track[-1, 0].tolist()
        ((76, 2, 3), [0.1, 0.0, 0.0])
    """

    name = "hold"
    fields: tuple[Field, ...] = FIELDS
    throughout = True
    defaults: ClassVar[Json] = {"max_steps": 75}
    """Three seconds of 0.04 s."""

    def __init__(
        self, config: EnvConfig, constants: RewardConfig, own: HoldConfig | None = None
    ) -> None:
        self._config, self._constants, self._own = config, constants, own or HoldConfig()

    def to_json(self) -> Json:
        """Its name, and how its goals move."""
        return {"name": self.name, **plain(self._own)}

    def view(self, robot: Robot, limits: Array, *, spheres: int) -> StateView:
        """As in the reach task: a policy learnt there can be tried here."""
        return state_view(robot, limits, spheres=spheres, config=self._config)

    def parts(self, reading: Reading, view: View) -> dict[str, Array]:
        """Their values."""
        return goals.parts(reading, view)

    def given(self, reading: Reading) -> dict[str, Array]:
        """Where the goals are."""
        return {"goals": reading.goals.reshape(len(reading.goals), -1)}

    def measure(self, reading: Reading) -> dict[str, Array]:
        """Distance to where the goals are at the end of the step, collision and instability."""
        return goals.measure(reading)

    def derive(self, columns: Mapping[str, Array]) -> dict[str, Array]:
        """Boundary and goal flags."""
        boundary, goal = proximity(columns["distance"], self._config)
        return {"boundary": boundary, "goal": goal}

    def reward(self, columns: Mapping[str, Array]) -> Array:
        """The terms of the reach task's reward without κ, (n, k): every step counts alike."""
        return shaped(columns["distance"], goals.flags_of(columns), self._constants)

    def ended(self, columns: Mapping[str, Array]) -> Array:
        """A fall, (n,) bool."""
        return np.asarray(columns["instability"])

    def accomplished(self, columns: Mapping[str, Array]) -> Array:
        """Every palm within its goal radius, (n,) bool."""
        return np.asarray(columns["goal"].all(axis=-1))

    def mishaps(self, columns: Mapping[str, Array]) -> Array:
        """Collision or instability, (n,) bool."""
        return goals.mishaps(columns)

    def track(self, start: Array, way: Array) -> Array:
        """Goals before each step and after the last, (max_steps + 1, k, 3) [m].

        They start at rest in `start` (k, 3) and come to rest `way` (3,) from there.
        """
        time = np.arange(self._config.max_steps + 1) * self._config.control_period
        share = (1.0 - np.cos(np.pi * np.minimum(time / self._own.seconds, 1.0))) / 2
        return np.asarray(start + share[:, None, None] * way)

    def sample(
        self, rng: np.random.Generator, scene: Scene, kinematics: Kinematics, angles: Array
    ) -> Sample | None:
        """Goals on the palms of the start posture, and a way in any direction that the palms can
        follow; None where they cannot.
        """
        direction = rng.standard_normal(3)
        way = direction / np.linalg.norm(direction)
        way *= rng.uniform(self._own.nearest, self._own.farthest)
        start, posture = kinematics.palms(angles), angles
        for share in np.linspace(0.0, 1.0, CHECKS + 1)[1:]:
            found = kinematics.solve(start + share * way, seed=posture)
            if found is None:
                return None
            posture = found
        return Sample(start, track=self.track(start, way), reachable=True)
