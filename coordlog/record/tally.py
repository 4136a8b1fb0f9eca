"""What a commit marker says about an episode, defined once: for the writer as it goes, for `check`
afterwards.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from coordlog.contracts import Task
from coordlog.episode import Array, Header, Json, Result
from coordlog.errors import ConfigError
from coordlog.tasks.progress import Progress
from coordlog.tasks.registry import task_of


def task_here(header: Header) -> Task | None:
    """The task of a log; None where it is not installed, or does not know its constants."""
    if not header.task:
        return None
    said = {key: header.env.get(key) for key in ("task", "config", "reward")}
    if said["task"] is None:
        del said["task"]
    return _task(json.dumps(said))


@lru_cache(maxsize=64)
def _task(env: str) -> Task | None:
    said: Json = json.loads(env)
    try:
        return task_of(said)
    except ConfigError:
        return None


class Tally:
    """What the result says about the steps, kept up block by block.

    An episode of no task, or of one that is not installed, is no success.
    """

    def __init__(self, header: Header) -> None:
        self.length = 0
        self.returns = np.zeros(header.layout.k)
        self.terminated, self.truncated = False, False
        task = task_here(header)
        self._progress = None if task is None else Progress(task, 1)
        self._digest = hashlib.sha256()

    def add(self, columns: Mapping[str, Array]) -> None:
        """Count a block of steps in.

        Rewards are added one by one, in order, so that a sum does not depend on the blocks.
        """
        self.length += len(columns["reward"])
        self.returns = np.add.accumulate(np.vstack([self.returns, columns["reward"]]))[-1]
        if self._progress is not None:
            try:
                self._progress.block(columns)
            except KeyError:  # a tool has left the task's topic out
                self._progress = None
        self.terminated, self.truncated = (
            bool(columns["terminated"][-1]),
            bool(columns["truncated"][-1]),
        )
        self.add_states(columns)

    def add_states(self, columns: Mapping[str, Array]) -> None:
        """Add the bytes of qpos and qvel, row by row, to the digest."""
        self._digest.update(np.concatenate([columns["qpos"], columns["qvel"]], axis=1).ravel())

    def result(self, aborted: str) -> Result:
        """The result so far."""
        one = np.array([0])
        progress = self._progress if self.length else None
        return Result(
            length=self.length,
            returns=tuple(self.returns.tolist()),
            success=progress is not None and bool(progress.success(one)[0]),
            clean=progress is not None and bool(progress.clean(one)[0]),
            terminated=self.terminated,
            truncated=self.truncated,
            aborted=aborted,
            digest=self._digest.hexdigest(),
        )
