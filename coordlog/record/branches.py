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

    def __init__(self, logs: Logs) -> None:
        """Take what is needed of logs of one scene.

        Raises:
            ConfigError: if they are of several start poses.
        """
        self.env: Json = logs.env(0)
        """The `coordlog.env` record of the first."""
        self.scene: str = logs.episodes.column("scene")[0].as_py()
        starts = set(logs.episodes.column("start").to_pylist())
        if len(starts) > 1:
            raise ConfigError(
                f"--branch: expected logs of one start pose, got {', '.join(sorted(starts))}; "
                "choose with --where"
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
    state, action, collision, instability = (
        _column(logs, name) for name in ("state", "action", "collision", "instability")
    )
    mishap, lengths = collision | instability, logs.episodes.column("length").to_pylist()
    rows = logs.episodes.select(["seed", "split", "index", "digest"]).to_pylist()
    start = 0
    for row, length in zip(rows, lengths, strict=True):
        part = slice(start, start + length)
        yield Parent(**row, state=state[part], action=action[part], mishap=mishap[part])
        start += length


def _column(logs: Logs, name: str) -> Array:
    """A column of all steps, (N,) or (N, width)."""
    column = logs.steps.column(name)
    if column.type.num_fields == 0:
        return np.asarray(column)
    flat = np.concatenate([np.asarray(chunk.flatten()) for chunk in column.chunks])
    return flat.reshape(len(column), -1)


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
