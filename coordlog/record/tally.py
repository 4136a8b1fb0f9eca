"""What a commit marker says about an episode, defined once: for the writer as it goes, for `check`
afterwards.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

import numpy as np

from coordlog.episode import Array, Result

SPOILS = ("collision", "instability")
"""Fields of a task that, once true, keep a success from being clean."""


class Tally:
    """What the result says about the steps, kept up block by block.

    Success is a step at which the task's field `goal` is true of every arm; a task that has no such
    field knows no success.
    """

    def __init__(self, k: int) -> None:
        self.length = 0
        self.returns = np.zeros(k)
        self.success, self.spoiled = False, False
        self.terminated, self.truncated = False, False
        self._digest = hashlib.sha256()

    def add(self, columns: Mapping[str, Array]) -> None:
        """Count a block of steps in.

        Rewards are added one by one, in order, so that a sum does not depend on the blocks.
        """
        self.length += len(columns["reward"])
        self.returns = np.add.accumulate(np.vstack([self.returns, columns["reward"]]))[-1]
        if "goal" in columns:
            self.success = self.success or bool(columns["goal"].all(axis=1).any())
        self.spoiled = self.spoiled or any(
            bool(columns[name].any()) for name in SPOILS if name in columns
        )
        self.terminated, self.truncated = (
            bool(columns["terminated"][-1]),
            bool(columns["truncated"][-1]),
        )
        self.add_states(columns)

    def add_states(self, columns: Mapping[str, Array]) -> None:
        """Add the bytes of qpos and qvel, row by row, to the digest."""
        self._digest.update(np.concatenate([columns["qpos"], columns["qvel"]], axis=1).tobytes())

    def result(self, aborted: str) -> Result:
        """The result so far."""
        return Result(
            length=self.length,
            returns=tuple(self.returns.tolist()),
            success=self.success,
            clean=self.success and not self.spoiled,
            terminated=self.terminated,
            truncated=self.truncated,
            aborted=aborted,
            digest=self._digest.hexdigest(),
        )
