"""Control steps as columns: logged episodes one after the other, and a block of live steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from coordlog.episode import Array, Json
from coordlog.errors import SpecError
from coordlog.spec import LEARNT, REWARDED, names


class Block(NamedTuple):
    """n control steps of all lanes.

    A truncated step is a step like any other: its `next_state` is real and is bootstrapped from.
    """

    state: Array  # (n, lanes, n_x) float32
    action: Array  # (n, lanes, n_u) float32, executed
    next_state: Array  # (n, lanes, n_x) float32, before any reset
    distance: Array  # (n, lanes, k) m
    boundary: Array  # (n, lanes, k) bool
    goal: Array  # (n, lanes, k) bool
    collision: Array  # (n, lanes) bool
    instability: Array  # (n, lanes) bool
    terminated: Array  # (n, lanes) bool
    episode: Array  # (n, lanes) integer, every episode of the run its own number, counted from 0
    step: Array  # (n, lanes) integer, from 0 in each episode


@dataclass(frozen=True, eq=False)
class Columns:
    """N transitions of E logged episodes, one after the other, and the E states in which the
    episodes ended.
    """

    steps: Mapping[str, Array]
    """A column of N rows for each field of `spec.LEARNT`, or of `REWARDED` if the rewards are those
    that were logged; states and actions are float32."""
    final: Array
    """(E, n_x) float32, after each episode's last action"""
    length: Array
    """(E,) integer, steps of each episode, all positive"""

    def __post_init__(self) -> None:
        """Check that the columns fit together.

        Raises:
            SpecError: if they do not, or there is no transition.
        """
        n, episodes = int(np.sum(self.length)), len(self.length)
        if n == 0 or np.min(self.length) < 1:
            raise SpecError(
                f"logs: expected episodes of at least one step, got {episodes} episodes of {n} "
                "steps in all"
            )
        wanted = names(REWARDED if self.rewarded else LEARNT)
        columns = {name: self.steps[name] for name in wanted} | {"final": self.final}
        for name, column in columns.items():
            rows = episodes if name == "final" else n
            if len(column) != rows:
                raise SpecError(
                    f"{name}: expected {rows} rows for {episodes} episodes of {n} steps in all, "
                    f"got {len(column)}"
                )
            if name in ("state", "action", "final") and column.dtype != np.float32:
                raise SpecError(f"{name}: expected float32, got {column.dtype}")

    @property
    def rewarded(self) -> bool:
        """Whether the rewards to learn from are those that were logged."""
        return "reward" in self.steps

    @classmethod
    def from_tables(cls, steps: pa.Table, finals: pa.Table, *, rewarded: bool = False) -> Columns:
        """Columns over the memory of Arrow tables, copied only where a column lies in several
        chunks or is a bit per value.

        Args:
            steps: One row per step with the columns of `spec.LEARNT`, episode by episode.
            finals: One row per episode in the same order: its final "state" and its "length".
            rewarded: Those of `spec.REWARDED` instead: learn from the rewards that were logged.

        Raises:
            SpecError: if a column is missing, or the rows of the two do not fit together.
        """
        learnt = names(REWARDED if rewarded else LEARNT)
        for table, wanted in ((steps, learnt), (finals, ("state", "length"))):
            missing = [name for name in wanted if name not in table.column_names]
            if missing:
                raise SpecError(
                    f"logs: expected columns {', '.join(wanted)}, {', '.join(missing)} missing"
                )
        columns = {name: _array(steps.column(name)) for name in learnt}
        return cls(columns, _array(finals.column("state")), _array(finals.column("length")))

    def of(self, episodes: Sequence[int]) -> Columns:
        """Some of the episodes, in this order."""
        starts = np.cumsum(self.length) - self.length
        rows = np.concatenate([starts[at] + np.arange(self.length[at]) for at in episodes])
        steps = {name: column[rows] for name, column in self.steps.items()}
        return Columns(steps, self.final[list(episodes)], self.length[list(episodes)])

    def scaled(self, env: Json) -> Columns:
        """The same with states less an offset by a scale, and actions as shares of their range, -1
        to 1.

        Args:
            env: Record with state_offset and state_scale (n_x,), action_low and action_high (n_u,).
        """
        offset, scale = (np.array(env[f"state_{name}"], np.float32) for name in ("offset", "scale"))
        low, high = (np.array(env[f"action_{name}"], np.float32) for name in ("low", "high"))
        middle, half = (high + low) / 2, (high - low) / 2

        def seen(states: Array) -> Array:
            return np.asarray((states - offset) / scale, np.float32)

        action = np.clip((self.steps["action"] - middle) / half, -1, 1).astype(np.float32)
        steps = {**self.steps, "state": seen(self.steps["state"]), "action": action}
        return Columns(steps, seen(self.final), self.length)

    def block(self, *, first: int) -> Block:
        """All of them as a block of one lane, with episodes numbered from `first` on."""
        ends = np.cumsum(self.length)
        following = np.concatenate([self.steps["state"][1:], self.final[-1:]])
        following[ends - 1] = self.final
        rows = {
            **self.steps,
            "next_state": following,
            "episode": np.repeat(first + np.arange(len(ends)), self.length),
            "step": np.arange(len(following)) - np.repeat(ends - self.length, self.length),
        }
        return Block(**{name: rows[name][:, None] for name in Block._fields})


def _array(column: pa.ChunkedArray) -> Array:
    """A column as an array (n,) or (n, width), over the same memory where that is possible."""
    values = column.chunk(0) if column.num_chunks == 1 else column.combine_chunks()
    if not pa.types.is_fixed_size_list(values.type):
        return np.asarray(values.to_numpy(zero_copy_only=False))
    return np.asarray(values.flatten().to_numpy(zero_copy_only=False).reshape(len(values), -1))
