"""The only loop that runs a policy in an environment.

Recording, training and evaluation come through here, and so do replays, whose policy is the logged
actions (sim/replay.py), and executions of paths, whose policy follows them (sim/tracking.py).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import islice

import numpy as np

from coordlog.contracts import Env, Outcome, Policy
from coordlog.episode import Array
from coordlog.errors import SpecError


def ended(ids: Array, outcome: Outcome) -> Array:
    """Episodes that end with a step: by their task, cut off, or because the physics broke down."""
    return np.asarray(outcome.terminated | outcome.truncated | outcome.diverged)


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
    over: Callable[[Array, Outcome], Array] = ended,
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
        over: Which of the simulations `ids` (n,) end their episode with this outcome, (n,) bool.

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
                f"action: expected numbers in [-1, 1] from policy {type(policy).__name__}, got NaN "
                "or infinity"
            )
        outcome = env.step(np.clip(action, -1.0, 1.0), running)
        yield running, outcome
        done = over(running, outcome)
        idle = np.sort(np.concatenate([idle[len(indices) :], running[done]]))
        running = running[~done]
