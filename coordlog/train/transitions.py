"""The one store of transitions: of whole logs, of logs that stream through a window, of live steps.

One lane per simulation, one slot per control step: slot p of lane l is row p · lanes + l, and what
follows a transition in its episode stands in the next slot. Logs are one lane: whole, or a window
whose oldest transitions make room, as those of live steps do.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from coordlog.episode import Array
from coordlog.errors import ConfigError, StorageError
from coordlog.policies.checkpoint import load_arrays, save_arrays
from coordlog.spec import LEARNT, names, owned
from coordlog.train.columns import Block, Columns
from coordlog.train.relabel import RewardFunction, draw_later

SEGMENT = "coordlog replay segment"
CHUNK = 65_536
"""Rows whose rewards are computed together, so that a mapped column is never read as a whole."""
_OUTCOME = names(owned(LEARNT, "reach"))


class Transitions:
    """Transitions that can be drawn from by row number, with rewards unscaled.

    Example:
        >>> live = Transitions.ring(1000, 4, widths=(37, 13, 2), reward=reward)  # doctest: +SKIP
        >>> live.add(block)                                                    # doctest: +SKIP
        >>> live.take("reward", live.draw(rng, 256)).shape                     # doctest: +SKIP
        (256, 2)
    """

    def __init__(
        self,
        rows: dict[str, Array],
        *,
        lanes: int,
        reward: RewardFunction | None,
        length: Array | None = None,
        final: Array | None = None,
    ) -> None:
        """For use by `ring` and `of_logs`."""
        self._rows, self.lanes, self._reward = rows, lanes, reward
        self.slots = len(rows["step"]) // lanes
        self.total = 0
        """Slots ever written."""
        self._saved = 0
        self._length = np.zeros(0, np.int32) if length is None else length
        """Steps so far of each episode, by its number."""
        self._final = final
        """States after the last steps, by number of episode; the next state of any other step is
        the next row. None where all next states are kept."""
        if final is not None:
            self._ends = rows["step"] + 1 == self._length.take(rows["episode"])

    @classmethod
    def ring(
        cls,
        capacity: int,
        lanes: int,
        *,
        widths: tuple[int, int, int],
        reward: RewardFunction | None,
    ) -> Transitions:
        """Room for the last `capacity` transitions of `add`; the system provides the memory as it
        is written to.

        Args:
            capacity: Transitions kept, rounded down to whole slots.
            lanes: Simulations.
            widths: n_x, n_u and k.
            reward: The reward to learn from.

        Raises:
            ConfigError: if a slot does not fit.
        """
        if capacity < lanes:
            raise ConfigError(
                f"replay.capacity: expected at least one transition per simulation, {lanes}, got "
                f"{capacity}"
            )
        n = capacity // lanes * lanes
        rows: dict[str, Array] = {
            name: np.zeros((n, *shape), kind) for name, (shape, kind) in _kept(widths).items()
        }
        return cls(rows, lanes=lanes, reward=reward)

    @classmethod
    def of_logs(cls, logs: Columns, reward: RewardFunction | None) -> Transitions:
        """All transitions of logs. States and actions stay where they are, memory-mapped or not.

        Rewards are computed from the logged distances and flags; whatever constants the logs were
        made with do not matter. Without a function they are those that were logged, and nothing
        went wrong.
        """
        steps, length = logs.steps, np.asarray(logs.length, np.int32)
        n = len(steps["state"])
        if reward is None:
            rewards = np.asarray(steps["reward"], np.float32)
            steps = {**steps, **dict.fromkeys(("collision", "instability"), np.zeros(n, np.bool_))}
        else:
            rewards = np.empty(steps["distance"].shape, np.float32)
            for start in range(0, n, CHUNK):
                part = slice(start, start + CHUNK)
                rewards[part] = reward(*(steps[name][part] for name in _OUTCOME))
        mishaps = np.cumsum(steps["collision"] | steps["instability"], dtype=np.int32)
        kept = ("state", "action", "collision", "instability", "terminated")
        step = np.arange(n, dtype=np.int32)
        step -= np.repeat((np.cumsum(length) - length).astype(np.int32), length)
        rows = {name: np.asarray(steps[name]) for name in kept} | {
            "reward": rewards,
            "mishaps": mishaps,
            "episode": np.repeat(np.arange(len(length), dtype=np.int32), length),
            "step": step,
        }
        made = cls(rows, lanes=1, reward=reward, length=length, final=np.asarray(logs.final))
        made.total = n
        return made

    def __len__(self) -> int:
        """Number of transitions stored."""
        return min(self.total, self.slots) * self.lanes

    @property
    def widths(self) -> tuple[int, int, int]:
        """n_x, n_u and k."""
        n_x, n_u, k = (self._rows[name].shape[-1] for name in ("state", "action", "reward"))
        return n_x, n_u, k

    def add(self, block: Block) -> None:
        """Store a block in place of the oldest transitions.

        Raises:
            ConfigError: if the block is longer than the buffer.
        """
        n = len(block.step)
        if n > self.slots:
            raise ConfigError(
                f"loop.block: expected at most the buffer's {self.slots} steps per simulation, got "
                f"{n}"
            )
        flat = {
            name: array.reshape(n * self.lanes, *array.shape[2:])
            for name, array in block._asdict().items()
        }
        assert self._reward is not None  # nothing but logs tells rewards of its own
        reward = self._reward(*(flat[name] for name in _OUTCOME))
        slots = (self.total + np.arange(n)) % self.slots
        before = self._slots("mishaps")[(self.total - 1) % self.slots]  # of a new buffer: zeros
        mishaps = before + np.cumsum(block.collision | block.instability, axis=0, dtype=np.int32)
        values = {
            **block._asdict(),
            "reward": reward.reshape(n, self.lanes, -1),
            "mishaps": mishaps,
        }
        for name in self._rows:
            self._slots(name)[slots] = values[name]
        self._count(flat["episode"], flat["step"])
        self.total += n

    def _slots(self, name: str) -> Array:
        """A column as (slots, lanes, …), over the same memory."""
        column = self._rows[name]
        return column.reshape(self.slots, self.lanes, *column.shape[1:])

    def _count(self, episode: Array, step: Array) -> None:
        missing = int(episode.max()) + 1 - len(self._length)
        if missing > 0:
            self._length = np.concatenate(
                (self._length, np.zeros(max(missing, len(self._length)), np.int32))
            )
        np.maximum.at(self._length, episode, step.astype(np.int32) + 1)

    def draw(self, rng: np.random.Generator, size: int) -> Array:
        """Row numbers, uniform with replacement, (size,) int64."""
        return rng.integers(len(self), size=size)

    def take(self, name: str, rows: Array, out: Array | None = None) -> Array:
        """A column ("state", "action", "reward", "collision", "instability", "terminated") at some
        rows of any shape.
        """
        return np.asarray(self._rows[name].take(rows, axis=0, out=out, mode="clip"))

    def next_state(self, rows: Array, out: Array | None = None) -> Array:
        """The states that the steps of some rows (n,) led to, (n, n_x)."""
        if self._final is None:
            return self.take("next_state", rows, out)
        states = self.take("state", rows + 1, out)
        ends = np.flatnonzero(self._ends.take(rows))
        states[ends] = self._final[self._rows["episode"].take(rows[ends])]
        return states

    def ahead(self, rows: Array, n: int) -> tuple[Array, Array]:
        """Rows of the n steps from each row on, (size, n), and which of them are stored and of its
        episode; the others repeat the last that is.
        """
        if n == 1:
            return rows[:, None], np.ones((len(rows), 1), np.bool_)
        left, steps = self._left(rows)[:, None], np.arange(n)
        return self._after(rows[:, None], np.minimum(steps, left)), steps <= left

    def later(self, rng: np.random.Generator, rows: Array, horizon: int) -> tuple[Array, Array]:
        """A row drawn uniformly from each row to the last stored one of its episode, or up to a
        horizon, and the steps it takes, (n,).
        """
        step = self._rows["step"].take(rows)
        ahead = draw_later(rng, step, step + self._left(rows), horizon) - step
        return self._after(rows, ahead), ahead + 1

    def clean(self, rows: Array, horizon: int) -> Array:
        """Whether nothing went wrong from each row to the last stored one of its episode, or up to
        a horizon, (n,) bool.
        """
        left = self._left(rows)
        then = self._after(rows, np.minimum(left, horizon - 1) if horizon > 0 else left)
        mishap = self._rows["collision"].take(rows) | self._rows["instability"].take(rows)
        return np.asarray(
            self._rows["mishaps"].take(then) == self._rows["mishaps"].take(rows) - mishap
        )

    def _left(self, rows: Array) -> Array:
        """Steps that are stored of each row's episode after it."""
        last = self._length.take(self._rows["episode"].take(rows)) - 1
        return np.asarray(last - self._rows["step"].take(rows))

    def _after(self, rows: Array, steps: Array) -> Array:
        """Rows that many slots later in the same lane."""
        return np.asarray(
            (rows // self.lanes + steps) % self.slots * self.lanes + rows % self.lanes
        )

    def save(self, folder: Path) -> None:
        """Write the slots added since the last save as one more segment; `load` needs `total`.

        Segments that even the previous save no longer needs are removed, so a crash between this
        and the caller's own checkpoint leaves that save whole.

        Raises:
            StorageError: if the file system refuses.
        """
        for _, last, path in _segments(folder):
            if last <= self._saved - self.slots:
                path.unlink()
        first = max(self._saved, self.total - self.slots)
        if first < self.total:
            slots = np.arange(first, self.total) % self.slots
            arrays = {name: self._slots(name)[slots] for name in self._rows}
            save_arrays(
                folder / f"{first:012d}-{self.total:012d}.safetensors",
                arrays,
                kind=SEGMENT,
                meta={},
            )
        self._saved = self.total

    def load(self, folder: Path, *, total: int) -> None:
        """Continue from the save made at `total` slots; later segments are removed.

        Raises:
            StorageError: if a segment is missing.
        """
        oldest = max(0, total - self.slots)
        reached = oldest
        for first, last, path in _segments(folder):
            if first >= total:
                path.unlink()
            elif last > oldest:
                if first > reached:
                    break
                arrays = load_arrays(path, kind=SEGMENT).arrays
                skip = max(0, oldest - first)
                for name in self._rows:
                    places = np.arange(first + skip, last) % self.slots
                    self._slots(name)[places] = arrays[name][skip:]
                self._count(arrays["episode"][skip:].reshape(-1), arrays["step"][skip:].reshape(-1))
                reached = last
        if reached != total:
            raise StorageError(
                f"{folder}: expected saved steps up to {total}, found them up to {reached}; the "
                "checkpoint cannot be resumed"
            )
        self.total = self._saved = total


def _segments(folder: Path) -> list[tuple[int, int, Path]]:
    """First and last slot (exclusive) and path of each segment, oldest first."""
    found = [(path, path.stem.split("-")) for path in sorted(folder.glob("*-*.safetensors"))]
    return [(int(first), int(last), path) for path, (first, last) in found]


def _kept(widths: tuple[int, int, int]) -> dict[str, tuple[tuple[int, ...], type]]:
    """Shape of an entry and type of every column of a ring of these n_x, n_u and k."""
    n_x, n_u, k = widths
    return {
        "state": ((n_x,), np.float32),
        "action": ((n_u,), np.float32),
        "reward": ((k,), np.float32),
        "next_state": ((n_x,), np.float32),
        "collision": ((), np.bool_),
        "instability": ((), np.bool_),
        "terminated": ((), np.bool_),
        "mishaps": ((), np.int32),  # of the lane so far, this step's included
        "episode": ((), np.int32),
        "step": ((), np.int32),
    }


def row_size(widths: tuple[int, int, int]) -> int:
    """Bytes of one transition in a ring of these n_x, n_u and k."""
    kept = _kept(widths).values()
    return sum(int(np.prod(shape, dtype=int)) * np.dtype(kind).itemsize for shape, kind in kept)
