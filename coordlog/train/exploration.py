"""Exploration: a policy whose actions are disturbed, and the disturbance's memory from step to
step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from coordlog.episode import Array, Json
from coordlog.policies.checkpoint import generator_from_json, generator_to_json
from coordlog.policies.noise import remembered


class Noise:
    """Normal noise with memory, of deviation 1 per lane and action, one generator for all lanes."""

    def __init__(self, lanes: int, n_u: int, *, correlation: float, seed: list[int]) -> None:
        """Start in the stationary distribution."""
        self._rng, self._correlation = np.random.default_rng(seed), np.float32(correlation)
        self._value = self._rng.standard_normal((lanes, n_u), dtype=np.float32)

    def draw(self) -> Array:
        """The next noise, (lanes, n_u) float32."""
        value = self._value
        fresh = self._rng.standard_normal(value.shape, dtype=np.float32)
        self._value = remembered(value, fresh, self._correlation)
        return value

    def state(self) -> tuple[Json, dict[str, Array]]:
        """What the next draws depend on."""
        return generator_to_json(self._rng), {"value": self._value}

    def load_state(self, generator: Json, arrays: Mapping[str, Array]) -> None:
        """Continue from a `state()`."""
        self._rng, self._value = generator_from_json(generator), np.array(arrays["value"])


class Drawn:
    """Noise that has been drawn before, (steps, lanes, n_u), to be had once."""

    def __init__(self, values: Array) -> None:
        self._values = iter(values)

    def draw(self) -> Array:
        """The next noise, (lanes, n_u) float32."""
        return np.asarray(next(self._values))


class Exploring:
    """a = clip(μ(s) + σ x, -1, 1) for the states of all lanes, to be executed and logged as it is
    (Algorithm 1).
    """

    def __init__(
        self, policy: Callable[[Array], Array], noise: Noise | Drawn, *, deviation: float
    ) -> None:
        """Disturb a policy by noise of this standard deviation, in units of the action range [-1,
        1].
        """
        self.policy, self.deviation, self._noise = policy, np.float32(deviation), noise

    def __call__(self, state: Array) -> Array:
        """Actions (lanes, n_u) float32 for states (lanes, n_x)."""
        action = self.policy(state) + self.deviation * self._noise.draw()
        return np.asarray(np.clip(action, np.float32(-1), np.float32(1)))

    def shares(self, steps: int, lanes: Sequence[int]) -> list[Exploring]:
        """For each of several collectors the policy of its lanes, with its part of the noise of so
        many steps, drawn now.
        """
        noise = np.stack([self._noise.draw() for _ in range(steps)])
        parts = np.split(noise, np.cumsum(lanes)[:-1], axis=1)
        return [
            Exploring(self.policy, Drawn(part), deviation=float(self.deviation)) for part in parts
        ]
