"""Live transitions, first in, first out.

The buffer has one lane per simulation and one slot per control step: slot p of lane l is row p · lanes + l, and what follows
a transition in its episode stands in the next slot of its lane. So an episode needs no index, and a block is one write.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from coordlog.episode import Array
from coordlog.errors import ConfigError, StorageError
from coordlog.train.checkpoint import load_arrays, save_arrays
from coordlog.train.relabel import RewardFunction, draw_later
from coordlog.train.replay import Arrays

SEGMENT = "coordlog replay segment"


class Block(NamedTuple):
    """n control steps of all lanes. A truncated step is a step like any other: its `next_state` is real and is bootstrapped from."""

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

    def __init__(self, capacity: int, lanes: int, *, widths: tuple[int, int, int], reward: RewardFunction) -> None:
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
            raise ConfigError(f"replay.capacity: expected at least one transition per simulation, {lanes}, got {capacity}")
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
            "episode": np.zeros(shape, np.int32),
            "step": np.zeros(shape, np.int32),
        }
        self._rows = {name: column.reshape(self.slots * lanes, *column.shape[2:]) for name, column in self._columns.items()}
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
            raise ConfigError(f"loop.block: expected at most the buffer's {self.slots} steps per simulation, got {n}")
        flat = {name: array.reshape(n * self.lanes, *array.shape[2:]) for name, array in block._asdict().items()}
        reward = self._reward(flat["distance"], flat["boundary"], flat["goal"], flat["collision"], flat["instability"])
        slots = (self.total + np.arange(n)) % self.slots
        values = {**block._asdict(), "reward": reward.reshape(n, self.lanes, -1)}
        for name, column in self._columns.items():
            column[slots] = values[name]
        self._count(flat["episode"], flat["step"])
        self.total += n

    def _count(self, episode: Array, step: Array) -> None:
        missing = int(episode.max()) + 1 - len(self._length)
        if missing > 0:
            self._length = np.concatenate((self._length, np.zeros(max(missing, len(self._length)), np.int32)))
        np.maximum.at(self._length, episode, step.astype(np.int32) + 1)

    def draw(self, rng: np.random.Generator, size: int) -> Array:
        """Row numbers, uniform with replacement."""
        return rng.integers(len(self), size=size)

    def read(self, rows: Array, out: Arrays) -> None:
        """Write the transitions of these rows."""
        for name in ("state", "action", "reward", "next_state"):
            self._rows[name].take(rows, axis=0, out=getattr(out, name), mode="clip")
        out.terminated[:, 0] = self._rows["terminated"].take(rows)

    def later(self, rng: np.random.Generator, rows: Array) -> Array:
        """Next states of a row drawn uniformly from each row to the last stored one of its episode."""
        step = self._rows["step"].take(rows)
        last = self._length.take(self._rows["episode"].take(rows)) - 1
        slot = (rows // self.lanes + draw_later(rng, step, last) - step) % self.slots
        return np.asarray(self._rows["next_state"].take(slot * self.lanes + rows % self.lanes, axis=0))

    def mishaps(self, rows: Array) -> tuple[Array, Array]:
        """Collision and instability of these rows."""
        return self._rows["collision"].take(rows), self._rows["instability"].take(rows)

    def save(self, folder: Path) -> None:
        """Write the slots added since the last save as one more segment file; `total` at this time is what `load` needs.

        Segments that even the previous save no longer needs are removed, so a crash between this and the caller's
        own checkpoint leaves that save whole.

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
            save_arrays(folder / f"{first:012d}-{self.total:012d}.safetensors", arrays, kind=SEGMENT, meta={})
        self._saved = self.total

    def load(self, folder: Path, *, total: int) -> None:
        """Continue from the save made when `total` slots had been written; later segments are removed.

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
                f"{folder}: expected saved steps up to {total}, found them up to {reached}; the checkpoint cannot be resumed"
            )
        self.total = self._saved = total


def _segments(folder: Path) -> list[tuple[int, int, Path]]:
    """First and last slot (exclusive) and path of each segment, oldest first."""
    found = [(path, path.stem.split("-")) for path in sorted(folder.glob("*-*.safetensors"))]
    return [(int(first), int(last), path) for path, (first, last) in found]
