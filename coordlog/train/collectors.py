"""Several collectors of live steps, each with simulations of its own, that feed one learner.

All take the same number of steps with the same policy, then the learner has them all: the result
depends on how many collectors there are and not on where they run or which is faster. Collector c
of N takes the problems c, c + N, c + 2 N, …
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from itertools import pairwise
from typing import Any

import numpy as np

from coordlog.crew import Crew
from coordlog.episode import Array
from coordlog.policies.checkpoint import under
from coordlog.sim.scoring import figures
from coordlog.train.columns import Block
from coordlog.train.exploration import Exploring
from coordlog.train.live import Simulations, from_row


def shares(lanes: int, count: int) -> list[int]:
    """Simulations of each collector, as equal as can be."""
    return [
        last - first for first, last in pairwise(lanes * at // count for at in range(count + 1))
    ]


class Collector:
    """The simulations of one collector."""

    def __init__(self, simulations: Simulations, recorder: AbstractContextManager[Any]) -> None:
        """Take both; leaving closes the recorder."""
        self._simulations, self._recorder = simulations, recorder
        recorder.__enter__()

    def collect(
        self, steps: int, policy: Callable[[Array], Array]
    ) -> tuple[Block, dict[str, Array]]:
        """A block, and the state after it, whose scores are told of once."""
        block = self._simulations.collect(steps, policy)
        state = self._simulations.state()
        self._simulations.summary()
        return block, state

    def state(self) -> dict[str, Array]:
        """As `Simulations.state`."""
        return self._simulations.state()

    def load_state(self, arrays: Mapping[str, Array]) -> None:
        """As `Simulations.load_state`."""
        self._simulations.load_state(arrays)

    def close(self) -> None:
        """Close the files."""
        self._recorder.__exit__(None, None, None)


class Collectors:
    """A crew of collectors; a `task.LiveSource`. One that is lost is made again, and its block is
    collected again.
    """

    def __init__(self, crew: Crew, lanes: list[int], *, k: int) -> None:
        """Feed from a crew of `Collector`s.

        Args:
            crew: One for each entry of `lanes`.
            lanes: Simulations of each.
            k: Number of arms.
        """
        self.lanes = sum(lanes)
        self._crew, self._each, self._k = crew, lanes, k
        self._states: list[dict[str, Array]] = crew.ask("state", [()] * len(lanes))
        self._scores, self._ended = self._states[0]["scores"], 0

    def collect(self, steps: int, policy: Callable[[Array], Array]) -> Block:
        """Step every simulation of every collector; see `task.LiveSource`."""
        assert isinstance(policy, Exploring)
        asked = [(steps, share) for share in policy.shares(steps, self._each)]
        found = self._crew.ask("collect", asked, before=lambda at: ("load_state", self._states[at]))
        fresh = [state.pop("scores") for _, state in found]
        self._scores = np.concatenate([self._scores, *fresh])
        self._states = [state | {"scores": self._scores[:0]} for _, state in found]
        columns = zip(*(block for block, _ in found), strict=True)
        return Block(*(np.concatenate(parts, axis=1) for parts in columns))

    def summary(self) -> Mapping[str, float]:
        """As `Simulations.summary`, of all."""
        fresh, self._scores = self._scores, self._scores[:0]
        self._ended += len(fresh)
        scores = [from_row(row, self._k) for row in fresh]
        return {"episodes_total": float(self._ended), **figures(scores)}

    def state(self) -> dict[str, Array]:
        """The states of all, and the scores that no summary has told of."""
        own = {"scores": self._scores, "ended": np.array([self._ended])}
        each = {
            f"{at}.{name}": value
            for at, state in enumerate(self._states)
            for name, value in state.items()
        }
        return own | each

    def load_state(self, arrays: Mapping[str, Array]) -> None:
        """Do again what led to a `state()`."""
        self._scores, self._ended = arrays["scores"], int(arrays["ended"][0])
        self._states = [under(f"{at}.", dict(arrays)) for at in range(len(self._each))]
        self._crew.ask("load_state", [(state,) for state in self._states])
