"""Episodes that begin in the middle of logged ones: where those went wrong, somebody else shows how
it goes on.

What a policy does wrong it does in states that an expert's own logs never get to, so they do not
tell what is right there (Ross et al. 2011, DAgger). Episodes that begin where the policy's logs are
about to go wrong ask the expert for just that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from coordlog.commands.logs import load_logs
from coordlog.contracts import Branch
from coordlog.errors import ConfigError
from coordlog.record.recorder import Recorder

if TYPE_CHECKING:
    from collections.abc import Iterator

    from coordlog.contracts import Problem
    from coordlog.episode import Array, Json
    from coordlog.record.cache import Logs
    from coordlog.sim.env import BatchEnv

EARLIEST, LATEST = 30, 6
"""An episode in which something went wrong is left at least LATEST and at most EARLIEST steps
before that; our choice."""


@dataclass(frozen=True, eq=False)
class Parent:
    """An episode to be left."""

    seed: int
    split: str
    index: int
    digest: str
    state: Array  # (T, n_x) float32
    action: Array  # (T, n_u) float32
    mishap: Array  # (T,) bool: collision or fall


class Parents:
    """Logged episodes of one scene, each to be left as often as it is asked for."""

    def __init__(self, paths: list[Path], *, where: str, jobs: int = 0) -> None:
        """Read what is needed of the logs.

        Raises:
            ConfigError: if the condition is no SQL, or nothing satisfies it.
            FormatError: if a file is broken.
            SpecError: if there are no logs, or they are of several scenes.
        """
        logs = load_logs(paths, where=where, skip_broken=False, jobs=jobs)
        self.env: Json = logs.env(0)
        """The `coordlog.env` record of the first."""
        self.scene: str = logs.episodes.column("scene")[0].as_py()
        starts = set(logs.episodes.column("start").to_pylist())
        if len(starts) > 1:
            raise ConfigError(
                f"--branch: expected logs of one start pose, got {', '.join(sorted(starts))}; choose with --where"
            )
        (self.start,) = starts
        self._parents = list(_parents(logs))

    def __len__(self) -> int:
        """Number of episodes."""
        return len(self._parents)

    def leave(self, index: int, *, seed: int) -> tuple[Parent, Branch]:
        """The branch of a number: parents take turns, and where each is left depends on the seed
        and the number alone.
        """
        parent = self._parents[index % len(self)]
        step = leave(np.random.default_rng([seed, index]), parent.mishap)
        return parent, Branch(parent.digest, parent.action[:step], parent.state[step])


class Branched(Recorder):
    """A recorder whose episodes begin in the middle of logged ones."""

    def __init__(self, parents: Parents, env: BatchEnv, folder: Path, **options: Any) -> None:
        """As `Recorder`, of episodes that these are left for."""
        super().__init__(env, folder, **options)
        self._parents = parents

    def problem(self, *, seed: int, split: str, index: int) -> Problem:
        """The parent's problem, begun where it is left."""
        parent, branch = self._parents.leave(index, seed=seed)
        return replace(
            super().problem(seed=parent.seed, split=parent.split, index=parent.index), branch=branch
        )


def _parents(logs: Logs) -> Iterator[Parent]:
    """The episodes of some logs."""
    from coordlog.train.logs import Columns

    columns = Columns.from_tables(logs.steps, logs.episodes)
    mishap, ends = columns.collision | columns.instability, np.cumsum(columns.length)
    rows = logs.episodes.select(["seed", "split", "index", "digest"]).to_pylist()
    for row, length, end in zip(rows, columns.length, ends, strict=True):
        part = slice(int(end - length), int(end))
        yield Parent(
            **row, state=columns.state[part], action=columns.action[part], mishap=mishap[part]
        )


def leave(rng: np.random.Generator, mishap: Array) -> int:
    """The step at which to leave an episode: shortly before its first mishap, or anywhere if there
    was none.

    Args:
        rng: Chance.
        mishap: Collision or fall at each step, (T,) bool, T ≥ 1.
    """
    if not mishap.any():
        return int(rng.integers(len(mishap)))
    first = int(np.argmax(mishap))
    return int(rng.integers(max(0, first - EARLIEST), max(0, first - LATEST) + 1))
