"""Logged transitions as columns, and as a store that batches are drawn from.

Nothing here is ever written to.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from coordlog.episode import Array
from coordlog.errors import SpecError
from coordlog.train.relabel import RewardFunction, draw_later

CHUNK = 65_536
STEP_COLUMNS = (
    "state",
    "action",
    "distance",
    "boundary",
    "goal",
    "collision",
    "instability",
    "terminated",
)


@dataclass(frozen=True, eq=False)
class Columns:
    """N transitions of E episodes, one after the other, and the E states in which the episodes
    ended.
    """

    state: Array  # (N, n_x) float32, before each action
    action: Array  # (N, n_u) float32
    distance: Array  # (N, k) m
    boundary: Array  # (N, k) bool
    goal: Array  # (N, k) bool
    collision: Array  # (N,) bool
    instability: Array  # (N,) bool
    terminated: Array  # (N,) bool
    final: Array  # (E, n_x) float32, after each episode's last action
    length: Array  # (E,) integer, steps of each episode, all positive

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
        for name in (*STEP_COLUMNS, "final"):
            rows, wanted = len(getattr(self, name)), episodes if name == "final" else n
            if rows != wanted:
                raise SpecError(
                    f"{name}: expected {wanted} rows for {episodes} episodes of {n} steps in all, "
                    f"got {rows}"
                )
        for name in ("state", "action", "final"):
            if getattr(self, name).dtype != np.float32:
                raise SpecError(f"{name}: expected float32, got {getattr(self, name).dtype}")

    @classmethod
    def from_tables(cls, steps: pa.Table, finals: pa.Table) -> Columns:
        """Columns over the memory of Arrow tables, copied only where a column lies in several
        chunks or is a bit per value.

        Args:
            steps: One row per step with the columns of `spec.STEP`, episode by episode.
            finals: One row per episode in the same order: its final "state" and its "length".

        Raises:
            SpecError: if a column is missing, or the rows of the two do not fit together.
        """
        for table, names in ((steps, STEP_COLUMNS), (finals, ("state", "length"))):
            missing = [name for name in names if name not in table.column_names]
            if missing:
                raise SpecError(
                    f"logs: expected columns {', '.join(names)}, {', '.join(missing)} missing"
                )
        columns = {name: _array(steps.column(name)) for name in STEP_COLUMNS}
        return cls(
            **columns, final=_array(finals.column("state")), length=_array(finals.column("length"))
        )


class LogReplay:
    """Transitions of logs.

    States and actions stay where they are, memory-mapped or not; the next state is the next row.
    """

    def __init__(self, columns: Columns, reward: RewardFunction) -> None:
        """Compute the rewards from the logged distances and flags; whatever constants the logs were
        made with do not matter.

        Args:
            columns: The logs.
            reward: The reward to learn from.
        """
        names = ("state", "action", "collision", "instability", "terminated")
        self._columns = {name: np.asarray(getattr(columns, name)) for name in names}
        self._final = np.asarray(columns.final)
        length = np.asarray(columns.length, dtype=np.int64)
        self._episode = np.repeat(np.arange(len(length), dtype=np.int32), length)
        self._last = np.cumsum(length) - 1  # row of each episode's last step
        self._mishaps = np.cumsum(
            self._columns["collision"] | self._columns["instability"], dtype=np.int32
        )
        self._reward = self._columns["reward"] = np.empty(columns.distance.shape, np.float32)
        for start in range(
            0, len(self), CHUNK
        ):  # so that a memory-mapped column is never read as a whole
            part = slice(start, start + CHUNK)
            flags = (
                columns.boundary[part],
                columns.goal[part],
                columns.collision[part],
                columns.instability[part],
            )
            self._reward[part] = reward(columns.distance[part], *flags)

    def __len__(self) -> int:
        """Number of transitions."""
        return len(self._columns["action"])

    @property
    def widths(self) -> tuple[int, int, int]:
        """n_x, n_u and k."""
        n_x, n_u, k = (self._columns[name].shape[-1] for name in ("state", "action", "reward"))
        return n_x, n_u, k

    def draw(self, rng: np.random.Generator, size: int) -> Array:
        """Row numbers, uniform with replacement."""
        return rng.integers(len(self), size=size)

    def ahead(self, rows: Array, n: int) -> tuple[Array, Array]:
        """Rows of the n steps from each row on, and which of them are of its episode.

        The others repeat the last that is.
        """
        if n == 1:
            return rows[:, None], np.ones((len(rows), 1), np.bool_)
        wanted = rows[:, None] + np.arange(n)
        last = self._last.take(self._episode.take(rows))[:, None]
        return np.minimum(wanted, last), wanted <= last

    def take(self, name: str, rows: Array, out: Array | None = None) -> Array:
        """A column at some rows of any shape."""
        return np.asarray(self._columns[name].take(rows, axis=0, out=out, mode="clip"))

    def next_state(self, rows: Array, out: Array | None = None) -> Array:
        """The states that the steps of some rows (n,) led to, (n, n_x)."""
        states = np.asarray(self._columns["state"].take(rows + 1, axis=0, out=out, mode="clip"))
        episode = self._episode.take(rows)
        ends = np.flatnonzero(rows == self._last.take(episode))
        states[ends] = self._final[episode[ends]]
        return states

    def later(self, rng: np.random.Generator, rows: Array, horizon: int) -> tuple[Array, Array]:
        """As `Store.later`."""
        then = draw_later(rng, rows, self._last.take(self._episode.take(rows)), horizon)
        return then, then - rows + 1

    def clean(self, rows: Array, horizon: int) -> Array:
        """As `Store.clean`."""
        last = self._last.take(self._episode.take(rows))
        then = np.minimum(last, rows + horizon - 1) if horizon > 0 else last
        mishap = self._columns["collision"].take(rows) | self._columns["instability"].take(rows)
        return np.asarray(self._mishaps.take(then) == self._mishaps.take(rows) - mishap)


def _array(column: pa.ChunkedArray) -> Array:
    """A column as an array (n,) or (n, width), over the same memory where that is possible."""
    values = column.chunk(0) if column.num_chunks == 1 else column.combine_chunks()
    if not pa.types.is_fixed_size_list(values.type):
        return np.asarray(values.to_numpy(zero_copy_only=False))
    return np.asarray(values.flatten().to_numpy(zero_copy_only=False).reshape(len(values), -1))
