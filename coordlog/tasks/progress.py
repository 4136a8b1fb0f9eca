"""Success and clean success of episodes, counted step by step: defined here and nowhere else."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from coordlog.contracts import Task
from coordlog.episode import Array


class Progress:
    """What n episodes have come to so far.

    An episode succeeds if at some step what the task asks for holds; where the task asks for it
    throughout, if it holds at every step and the episode comes to its full time. It is clean if it
    succeeds and nothing went wrong at any step.

    Example:
        >>> progress = Progress(task, 1)                        # doctest: +SKIP
        >>> progress.add(np.array([0]), outcome.columns)        # doctest: +SKIP
        >>> progress.success(np.array([0]))                     # doctest: +SKIP
        array([ True])
    """

    def __init__(self, task: Task, n: int) -> None:
        self._task = task
        self._once = np.zeros(n, dtype=bool)
        self._always = np.ones(n, dtype=bool)
        self._whole = np.zeros(n, dtype=bool)
        self.spoiled: Array = np.zeros(n, dtype=bool)
        """Whether something went wrong so far, (n,)."""

    def add(self, ids: Array, columns: Mapping[str, Array]) -> None:
        """Count one step of the episodes `ids`, with the columns of its outcome."""
        holds = self._task.accomplished(columns)
        self._once[ids] |= holds
        self._always[ids] &= holds
        self._whole[ids] = columns["truncated"]
        self.spoiled[ids] |= self._task.mishaps(columns)

    def block(self, columns: Mapping[str, Array]) -> None:
        """Count several steps of one episode, the first, one row each."""
        holds = self._task.accomplished(columns)
        self._once[0] |= holds.any()
        self._always[0] &= holds.all()
        self._whole[0] = columns["truncated"][-1]
        self.spoiled[0] |= self._task.mishaps(columns).any()

    def success(self, ids: Array) -> Array:
        """Whether the episodes `ids`, if they end here, have succeeded, (len(ids),) bool."""
        if self._task.throughout:
            return np.asarray(self._always[ids] & self._whole[ids])
        return np.asarray(self._once[ids])

    def clean(self, ids: Array) -> Array:
        """Whether they have, and nothing went wrong, (len(ids),) bool."""
        return np.asarray(self.success(ids) & ~self.spoiled[ids])

    def forget(self, ids: Array) -> None:
        """Other episodes begin in their place."""
        self._once[ids], self._always[ids] = False, True
        self._whole[ids], self.spoiled[ids] = False, False
