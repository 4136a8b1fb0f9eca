"""The only loop that runs a policy in an environment.

Training, evaluation, recording and smoothing all come through here.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice
from typing import Protocol

import numpy as np

from coordlog.contracts import Outcome
from coordlog.episode import Array
from coordlog.errors import SpecError
from coordlog.sim.sampler import Problem


class Policy(Protocol):
    """State in, action in [-1, 1] out, for several episodes at once.

    Slots are numbered as the environment's simulations.
    """

    def begin(self, ids: Array, state: Array, rngs: list[np.random.Generator]) -> None:
        """Episodes start in slots `ids` (n,), in states (n, n_x).

        Whatever is random in one comes from its own generator.
        """

    def act(self, ids: Array, state: Array) -> Array:
        """Actions (n, n_u) float32 in [-1, 1] for the states (n, n_x) of slots `ids`."""


class Env(Protocol):
    """What the loop needs of an environment; a recorder is one too."""

    @property
    def n(self) -> int:
        """Number of simulations."""

    @property
    def state(self) -> Array:
        """Present policy state of every simulation, (N, n_x) float32."""

    def problem(self, *, seed: int, split: str, index: int) -> Problem:
        """The problem of one episode."""

    def reset(self, ids: Array, problems: list[Problem]) -> None:
        """Start an episode in each of the simulations `ids`."""

    def step(self, action: Array, ids: Array) -> Outcome:
        """Advance simulations `ids` by one control period."""


def policy_rng(seed: int, split: str, index: int) -> np.random.Generator:
    """The generator of everything random that a policy does in one episode.

    Disjoint from the problem's.
    """
    return np.random.default_rng([seed, sum(split.encode()), index, 1])


def rollout(
    env: Env,
    policy: Policy,
    episodes: Iterable[int],
    *,
    seed: int,
    split: str = "train",
    running: Array | None = None,
) -> Iterator[tuple[Array, Outcome]]:
    """Run episodes until all have ended, as many at a time as the environment has simulations.

    A simulation whose episode has ended takes the next index at once. An episode depends on its
    seed, split and index alone, not on what runs beside it.

    Args:
        env: Where to run them.
        policy: What acts.
        episodes: Indices of the episodes, consumed in order; may be endless.
        seed: Seed of problems and noise.
        split: "train" or "test".
        running: Simulations that are in the middle of an episode already and go on with it.

    Yields:
        After every step of all running simulations: their ids (n,), and what the step led to.

    Raises:
        SpecError: if the policy's action is no number.
    """
    waiting = iter(episodes)
    running = np.zeros(0, dtype=np.int64) if running is None else running
    idle = np.setdiff1d(np.arange(env.n), running)
    while True:
        indices = list(islice(waiting, len(idle)))
        started = idle[: len(indices)]
        if indices:
            env.reset(
                started, [env.problem(seed=seed, split=split, index=index) for index in indices]
            )
            policy.begin(
                started, env.state[started], [policy_rng(seed, split, index) for index in indices]
            )
            running = np.sort(np.concatenate([running, started]))
        if not len(running):
            return
        action = np.asarray(policy.act(running, env.state[running]), dtype=np.float32)
        if not np.isfinite(action).all():
            raise SpecError(
                f"action: expected numbers in [-1, 1] from policy {type(policy).__name__}, got NaN or infinity"
            )
        outcome = env.step(np.clip(action, -1.0, 1.0), running)
        yield running, outcome
        over = outcome.terminated | outcome.truncated | outcome.diverged
        idle = np.sort(np.concatenate([idle[len(indices) :], running[over]]))
        running = running[~over]
