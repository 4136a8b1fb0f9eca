"""Policies that need no learning: still, random, and noise around any other.

The scripted expert has a module of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from coordlog.contracts import Policy
from coordlog.episode import Array
from coordlog.errors import ConfigError


@dataclass(frozen=True)
class RandomConfig:
    """Constants of the random policy; the table [policy] of a configuration file, logged.

    Example:
        >>> RandomConfig(sigma=0.3).correlation
        0.9
    """

    sigma: float = 0.7
    """Standard deviation of each action before it is clipped."""
    correlation: float = 0.9
    """Of the actions from one step to the next, 0 to below 1."""

    def __post_init__(self) -> None:
        if not (self.sigma >= 0 and 0 <= self.correlation < 1):
            raise ConfigError(
                "policy random: expected sigma ≥ 0 and a correlation in [0, 1), "
                f"got {self.sigma} and {self.correlation}"
            )


class Still:
    """Does nothing."""

    def __init__(self, n_u: int) -> None:
        self._n_u = n_u

    def begin(self, ids: Array, state: Array, rngs: list[np.random.Generator]) -> None:
        """Nothing to prepare."""

    def act(self, ids: Array, state: Array) -> Array:
        """Zeros, (n, n_u)."""
        return np.zeros((len(ids), self._n_u), dtype=np.float32)


def remembered(
    before: Array, fresh: Array, correlation: float | np.floating[Any], sigma: float = 1.0
) -> Array:
    """The next value of noise with memory: x ← ρ x + √(1 - ρ²) σ ξ, so that σ is its standard
    deviation at any ρ.
    """
    return np.asarray(correlation * before + np.sqrt(1 - correlation**2) * sigma * fresh)


class ActionNoise:
    """Gaussian noise with memory (`remembered`), one stream per slot."""

    def __init__(self, n: int, n_u: int, *, sigma: float, correlation: float) -> None:
        self._sigma, self._correlation = sigma, correlation
        self._value = np.zeros((n, n_u))
        self._rngs: list[np.random.Generator | None] = [None] * n

    def begin(self, ids: Array, rngs: list[np.random.Generator]) -> None:
        """Start afresh in slots `ids`, each from its own generator."""
        for slot, rng in zip(ids, rngs, strict=True):
            self._rngs[slot] = rng
            self._value[slot] = self._sigma * rng.standard_normal(self._value.shape[1])

    def draw(self, ids: Array) -> Array:
        """The next noise of slots `ids`, (n, n_u)."""
        fresh = np.stack([self._rng(slot).standard_normal(self._value.shape[1]) for slot in ids])
        now = self._value[ids].copy()
        self._value[ids] = remembered(now, fresh, self._correlation, self._sigma)
        return now

    def _rng(self, slot: int) -> np.random.Generator:
        rng = self._rngs[slot]
        assert rng is not None, "begin() comes before draw()"
        return rng


class Random:
    """Temporally correlated noise and nothing else."""

    def __init__(self, n: int, n_u: int, config: RandomConfig | None = None) -> None:
        known = config or RandomConfig()
        self._noise = ActionNoise(n, n_u, sigma=known.sigma, correlation=known.correlation)

    def begin(self, ids: Array, state: Array, rngs: list[np.random.Generator]) -> None:
        """Give each slot its generator."""
        self._noise.begin(ids, rngs)

    def act(self, ids: Array, state: Array) -> Array:
        """Clipped noise, (n, n_u)."""
        return np.clip(self._noise.draw(ids), -1.0, 1.0).astype(np.float32)


class Noisy:
    """Another policy with noise added to its actions.

    The sum is clipped and is what gets executed and logged.
    """

    def __init__(
        self, policy: Policy, n: int, n_u: int, *, sigma: float, correlation: float = 0.0
    ) -> None:
        self._policy = policy
        self._noise = ActionNoise(n, n_u, sigma=sigma, correlation=correlation)

    def begin(self, ids: Array, state: Array, rngs: list[np.random.Generator]) -> None:
        """Start the policy and the noise, on generators of their own."""
        children = [rng.spawn(2) for rng in rngs]
        self._policy.begin(ids, state, [first for first, _ in children])
        self._noise.begin(ids, [second for _, second in children])

    def act(self, ids: Array, state: Array) -> Array:
        """The policy's action plus noise, clipped to [-1, 1], (n, n_u)."""
        action: Array = self._policy.act(ids, state) + self._noise.draw(ids)
        return np.clip(action, -1.0, 1.0).astype(np.float32)
