"""Live transitions, first in, first out.

The buffer has one lane per simulation and one slot per control step: slot p of lane l is row p ·
lanes + l, and what follows a transition in its episode stands in the next slot of its lane. So an
episode needs no index, and a block is one write.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from coordlog.episode import Array
from coordlog.errors import ConfigError, StorageError
from coordlog.policies.checkpoint import load_arrays, save_arrays
from coordlog.train.relabel import RewardFunction, draw_later

SEGMENT = "coordlog replay segment"


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


class ReplayBuffer:
    """The last `capacity` live transitions, with rewards unscaled."""

    def __init__(
        self, capacity: int, lanes: int, *, widths: tuple[int, int, int], reward: RewardFunction
    ) -> None:
        """Reserve the memory; the system provides it as it is written to.

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
        n_x, n_u, k = widths
        self.widths, self.slots, self.lanes, self._reward = widths, capacity // lanes, lanes, reward
        self.total = 0
        """Slots ever written."""
        self._saved = 0
        shape = (self.slots, lanes)
        self._columns: dict[str, Array] = {
            "state": np.zeros((*shape, n_x), np.float32),
            "action": np.zeros((*shape, n_u), np.float32),
            "reward": np.zeros((*shape, k), np.float32),
            "next_state": np.zeros((*shape, n_x), np.float32),
            "collision": np.zeros(shape, np.bool_),
            "instability": np.zeros(shape, np.bool_),
            "terminated": np.zeros(shape, np.bool_),
            "mishaps": np.zeros(
                shape, np.int32
            ),  # collisions and falls of the lane so far, this step's included
            "episode": np.zeros(shape, np.int32),
            "step": np.zeros(shape, np.int32),
        }
        self._rows = {
            name: column.reshape(self.slots * lanes, *column.shape[2:])
            for name, column in self._columns.items()
        }
        self._length = np.zeros(0, np.int32)  # steps so far of each episode, by number

    def __len__(self) -> int:
        """Number of transitions stored."""
        return min(self.total, self.slots) * self.lanes

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
        reward = self._reward(
            flat["distance"], flat["boundary"], flat["goal"], flat["collision"], flat["instability"]
        )
        slots = (self.total + np.arange(n)) % self.slots
        before = self._columns["mishaps"][(self.total - 1) % self.slots]  # of a new buffer: zeros
        mishaps = before + np.cumsum(block.collision | block.instability, axis=0, dtype=np.int32)
        values = {
            **block._asdict(),
            "reward": reward.reshape(n, self.lanes, -1),
            "mishaps": mishaps,
        }
        for name, column in self._columns.items():
            column[slots] = values[name]
        self._count(flat["episode"], flat["step"])
        self.total += n

    def _count(self, episode: Array, step: Array) -> None:
        missing = int(episode.max()) + 1 - len(self._length)
        if missing > 0:
            self._length = np.concatenate(
                (self._length, np.zeros(max(missing, len(self._length)), np.int32))
            )
        np.maximum.at(self._length, episode, step.astype(np.int32) + 1)

    def draw(self, rng: np.random.Generator, size: int) -> Array:
        """Row numbers, uniform with replacement."""
        return rng.integers(len(self), size=size)

    def ahead(self, rows: Array, n: int) -> tuple[Array, Array]:
        """Rows of the n steps from each row on, and which of them are stored and of its episode;
        the others repeat the last that is.
        """
        left = self._last_step(rows) - self._rows["step"].take(rows)
        return self._after(rows[:, None], np.minimum(np.arange(n), left[:, None])), np.arange(
            n
        ) <= left[:, None]

    def take(self, name: str, rows: Array, out: Array | None = None) -> Array:
        """A column at some rows of any shape."""
        return np.asarray(self._rows[name].take(rows, axis=0, out=out, mode="clip"))

    def next_state(self, rows: Array, out: Array | None = None) -> Array:
        """The states that the steps of some rows (n,) led to, (n, n_x)."""
        return self.take("next_state", rows, out)

    def later(self, rng: np.random.Generator, rows: Array, horizon: int) -> tuple[Array, Array]:
        """As `Store.later`."""
        step = self._rows["step"].take(rows)
        ahead = draw_later(rng, step, self._last_step(rows), horizon) - step
        return self._after(rows, ahead), ahead + 1

    def clean(self, rows: Array, horizon: int) -> Array:
        """As `Store.clean`."""
        left = self._last_step(rows) - self._rows["step"].take(rows)
        then = self._after(rows, np.minimum(left, horizon - 1) if horizon > 0 else left)
        mishap = self._rows["collision"].take(rows) | self._rows["instability"].take(rows)
        return np.asarray(
            self._rows["mishaps"].take(then) == self._rows["mishaps"].take(rows) - mishap
        )

    def _last_step(self, rows: Array) -> Array:
        return np.asarray(self._length.take(self._rows["episode"].take(rows)) - 1)

    def _after(self, rows: Array, steps: Array) -> Array:
        """Rows that many slots later in the same lane."""
        return np.asarray(
            (rows // self.lanes + steps) % self.slots * self.lanes + rows % self.lanes
        )

    def save(self, folder: Path) -> None:
        """Write the slots added since the last save as one more segment file; `total` at this time
        is what `load` needs.

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
            arrays = {name: column[slots] for name, column in self._columns.items()}
            save_arrays(
                folder / f"{first:012d}-{self.total:012d}.safetensors",
                arrays,
                kind=SEGMENT,
                meta={},
            )
        self._saved = self.total

    def load(self, folder: Path, *, total: int) -> None:
        """Continue from the save made when `total` slots had been written; later segments are
        removed.

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
                for name, column in self._columns.items():
                    column[np.arange(first + skip, last) % self.slots] = arrays[name][skip:]
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
