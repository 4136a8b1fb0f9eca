"""Stands in for a task that is not installed: the robot still moves, but nobody says how well.

Logs of such a task open, replay and are checked as far as the core's fields go.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from coordlog.contracts import Kinematics, Reading, Sample, View
from coordlog.episode import Array, Json
from coordlog.errors import ConfigError
from coordlog.robots.robot import Robot
from coordlog.spec import Field
from coordlog.tasks import goals
from coordlog.tasks.reach.observation import StateView
from coordlog.tasks.scene import Scene

TOLD = frozenset(
    ("angles", "palms", "goals", "spheres", "difference", "com", "nearness", "velocity")
)
"""Parts of a state that follow from the robot and its goals alone."""
JUDGED = frozenset(("reward", "terminated", "truncated"))
"""Fields of the core that only the task can fill."""


class UnknownTask:
    """A task that is known by its log alone."""

    fields: tuple[Field, ...] = ()
    throughout = False

    def __init__(self, env: Json) -> None:
        """Read the state's layout.

        Args:
            env: The `coordlog.env` record of a log.
        """
        self.name = str(env["task"]["name"])
        self._said, self._view = dict(env["task"]), StateView.from_json(env)
        strange = set(self._view.places) - TOLD
        self.untold: frozenset[str] = JUDGED | (frozenset(("state",)) if strange else frozenset())
        """Fields of the core that cannot be computed without the task."""

    def to_json(self) -> Json:
        """What the log says."""
        return self._said

    def view(self, robot: Robot, limits: Array, *, spheres: int) -> StateView:
        """The log's."""
        return self._view

    def parts(self, reading: Reading, view: View) -> dict[str, Array]:
        """Those parts that follow from the robot and its goals; zeros for the others."""
        n = len(reading.angles)
        blank = {
            name: np.zeros((n, place.stop - place.start)) for name, place in view.places.items()
        }
        return blank | goals.parts(reading, view)

    def given(self, reading: Reading) -> dict[str, Array]:
        """Nothing."""
        return {}

    def measure(self, reading: Reading) -> dict[str, Array]:
        """The number of arms and of steps, for `reward`."""
        return {"palms": reading.palms}

    def derive(self, columns: Mapping[str, Array]) -> dict[str, Array]:
        """Nothing."""
        return {}

    def reward(self, columns: Mapping[str, Array]) -> Array:
        """No number, (n, k)."""
        return np.full(columns["palms"].shape[:2], np.nan)

    def ended(self, columns: Mapping[str, Array]) -> Array:
        """Never, (n,)."""
        return np.zeros(len(columns["palms"]), dtype=bool)

    def accomplished(self, columns: Mapping[str, Array]) -> Array:
        """Never, (n,)."""
        return np.zeros(len(columns["reward"]), dtype=bool)

    def mishaps(self, columns: Mapping[str, Array]) -> Array:
        """Never, (n,)."""
        return np.zeros(len(columns["reward"]), dtype=bool)

    def sample(
        self, rng: np.random.Generator, scene: Scene, kinematics: Kinematics, angles: Array
    ) -> Sample | None:
        """Refuse.

        Raises:
            ConfigError: always.
        """
        raise ConfigError(
            f"task '{self.name}' is not installed here: its episodes can be replayed, not begun"
        )
