"""An environment that keeps its episodes in memory, as a recorder would write them to files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, Protocol

import numpy as np

from coordlog.contracts import Env, Outcome, Problem, Task
from coordlog.episode import CONTACT, Array
from coordlog.sim.task import BoundTask


class Traceable(Env, Protocol):
    """What is kept in memory: an environment that also says what holds before an action."""

    task: BoundTask

    def present(self, ids: Array) -> dict[str, Array]:
        """Every field that holds before an action, (len(ids), …)."""
        ...


class Trace(NamedTuple):
    """What came out: the columns of an episode, with the shapes of `episode.Episode`."""

    columns: dict[str, Array]
    contacts: Array


class Traced:
    """An environment that keeps in memory what a recorder would write to files.

    Example:
        >>> env = Traced(LogEnv([log]))                         # doctest: +SKIP
        >>> env.trace(0).columns["qpos"].shape                  # doctest: +SKIP
        (111, 41)
    """

    def __init__(self, env: Traceable) -> None:
        self._env = env
        self.steps: Array = np.zeros(env.n, dtype=np.int64)
        """Steps of each episode so far, (N,)."""
        self._rows: dict[str, Array] = {}
        self._contacts: list[list[Array]] = [[] for _ in range(env.n)]

    @property
    def rules(self) -> Task:
        """The environment's task."""
        return self._env.task.rules

    @property
    def n(self) -> int:
        """Number of simulations."""
        return self._env.n

    @property
    def state(self) -> Array:
        """Present policy state of every simulation, (N, n_x) float32."""
        return self._env.state

    def problem(self, *, seed: int, split: str, index: int) -> Problem:
        """As the environment's."""
        return self._env.problem(seed=seed, split=split, index=index)

    def reset(self, ids: Array, problems: list[Problem]) -> None:
        """Start episodes, and forget those that were there."""
        self._env.reset(ids, problems)
        self.steps[ids] = 0
        for sim in ids.tolist():
            self._contacts[sim] = []
        self._keep(ids, self._env.present(ids))

    def step(self, action: Array, ids: Array) -> Outcome:
        """Step, and keep what was and what it led to."""
        self._keep(ids, {"action": action})
        outcome = self._env.step(action, ids)
        self._keep(ids, outcome.columns)
        for row in np.flatnonzero([len(rows) for rows in outcome.contacts]):
            rows = outcome.contacts[row].copy()
            rows["step"] = self.steps[ids[row]]
            self._contacts[int(ids[row])].append(rows)
        self.steps[ids] += 1
        self._keep(ids, self._env.present(ids))
        return outcome

    def trace(self, sim: int, wanted: set[str] | None = None) -> Trace:
        """The columns of one simulation's episode, and its contacts.

        Args:
            sim: Which simulation.
            wanted: Names of the columns; None for all.
        """
        states, length = set(self._env.present(np.array([sim]))), int(self.steps[sim])
        columns = {
            name: rows[sim, : length + (name in states)].copy()
            for name, rows in self._rows.items()
            if wanted is None or name in wanted
        }
        return Trace(columns, np.concatenate([np.zeros(0, CONTACT), *self._contacts[sim]]))

    def _keep(self, ids: Array, values: Mapping[str, Array]) -> None:
        at = self.steps[ids]
        for name, value in values.items():
            rows = self._rows.get(name)
            if rows is None:
                rows = np.zeros((self.n, 1, *value.shape[1:]), value.dtype)
            size = int(at.max(initial=0)) + 1
            if size > rows.shape[1]:
                grown = np.zeros((self.n, 2 * size, *value.shape[1:]), value.dtype)
                grown[:, : rows.shape[1]] = rows
                rows = grown
            rows[ids, at] = value
            self._rows[name] = rows
