"""Logs that are learnt from without being held in memory: episodes pass, in an order of chance,
through a window of transitions.

The order is drawn from the seed alone, anew for each pass over the episodes, and how far it has
come follows from the number of updates. So batches do not depend on who reads or how fast, and a
resumed run reads again what its window held.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from itertools import count, islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from coordlog.episode import Json
from coordlog.errors import ConfigError, FormatError, SpecError, StorageError
from coordlog.record.dataset import decoded
from coordlog.record.files import Skipped
from coordlog.train.columns import Columns
from coordlog.train.relabel import RewardFunction
from coordlog.train.transitions import Transitions, row_size

GROUP = 16
"""Episodes that are read and enter the window together."""
REUSE = 8.0
"""How often a transition is drawn, on average, before others take its place."""
ORDER = 2
"""What tells the generator of the order from those of batches (0) and exploration (1)."""


class Logged(NamedTuple):
    """One episode of a set, as it was listed before the run."""

    path: str
    digest: str
    length: int


Group = tuple[Logged, ...]
Reader = Callable[[Iterator[Group]], Iterator[Columns]]
"""Columns of groups of episodes, in their order; may read ahead of what is asked."""


class Read(NamedTuple):
    """A group of episodes as it was found."""

    columns: Columns
    envs: dict[str, str]
    """Each `coordlog.env` record that is among them, as JSON, and a file that has it."""


def read(group: Group) -> Read:
    """Read and decode some episodes, each file once.

    Raises:
        StorageError: if one cannot be read, or is not what was listed any more.
        FormatError: if one is no episode.
        SpecError: if they are not all of one layout, or lack what is learnt from.
    """
    skipped: list[Skipped] = []
    digests: dict[Path, str] = {}
    parts = decoded([Path(each.path) for each in group], skipped=skipped, digests=digests)
    for item in skipped:
        raise FormatError(f"{item.path}: {item.reason}")
    for each in group:
        if digests[Path(each.path)] != each.digest:
            raise StorageError(f"{each.path}: changed since the run began; begin a new one")
    if len(parts) != 1:
        raise SpecError(f"{group[0].path} and others: expected logs of one layout, got several")
    steps, finals, headers, known = parts[0]
    columns = Columns.from_tables(steps, finals)
    paths = {each.digest: each.path for each in group}
    envs = {
        json.dumps(header.env): paths[digest] for header, digest in zip(headers, known, strict=True)
    }
    places = {digest: at for at, digest in enumerate(known)}
    wanted = [places[each.digest] for each in group]  # of copies one is decoded
    return Read(columns if wanted == [*range(len(known))] else columns.of(wanted), envs)


class Stream:
    """A set of logged episodes, and the window that they pass through.

    Example:
        >>> stream = Stream(logged, read, memory=500_000_000, seed=0)     # doctest: +SKIP
        >>> window = stream.open(widths, reward, drawn=256)               # doctest: +SKIP
        >>> stream.feed(updates=0)                                        # doctest: +SKIP
    """

    def __init__(
        self,
        logged: Sequence[Logged],
        reader: Reader,
        *,
        memory: int,
        seed: int,
        reuse: float = REUSE,
    ) -> None:
        """Read nothing yet.

        Args:
            logged: The episodes; their order does not matter.
            reader: Reads groups of them.
            memory: Bytes that the window may take.
            seed: Seed of the order.
            reuse: How often a transition is drawn, on average, before others take its place.
        """
        self._logged = sorted(logged, key=lambda each: (each.digest, each.path))
        self._reader, self._memory, self._seed, self._reuse = reader, memory, seed, reuse
        self.transitions = sum(each.length for each in logged)
        """Of all episodes together."""
        self._groups: Iterator[Columns] | None = None
        self._fed = 0  # groups that the window has taken in
        self._starts: deque[tuple[int, int]] = deque()  # groups in the window, and their first slot

    def room(self, widths: tuple[int, int, int]) -> int:
        """Transitions that the window holds.

        Raises:
            ConfigError: if the memory is too little for a few episodes.
        """
        size = row_size(widths)
        longest = max(each.length for each in self._logged)
        least = min(self.transitions, 2 * GROUP * longest)
        rows = min(self.transitions, self._memory // size)
        if rows < least:
            raise ConfigError(
                f"--memory: expected at least {-(-least * size // 10**6)} MB, room for {2 * GROUP}"
                f" episodes of {longest} steps, got {self._memory / 1e6:g} MB"
            )
        return rows

    def about(self, widths: tuple[int, int, int]) -> Json:
        """What a run says of its window."""
        return {
            "memory": self._memory,
            "transitions": self.room(widths),
            "of": self.transitions,
            "episodes": len(self._logged),
            "reuse": self._reuse,
        }

    def open(
        self, widths: tuple[int, int, int], reward: RewardFunction | None, *, drawn: int
    ) -> Transitions:
        """The window, still empty.

        Args:
            widths: n_x, n_u and k.
            reward: The reward to learn from.
            drawn: Transitions that are drawn for each update. Where all fit, they enter once and
                stay.
        """
        self.window = Transitions.ring(self.room(widths), 1, widths=widths, reward=reward)
        self._pace, self._passes = drawn / self._reuse, self.window.slots < self.transitions
        return self.window

    def feed(self, updates: int) -> None:
        """Take in what is due before the update after so many.

        Raises:
            CoordlogError: what the reader raises.
        """
        due = self.window.slots + (int(updates * self._pace) if self._passes else 0)
        while self.window.total < due:
            self._take()
        if not self._passes:
            self.close()

    def state(self) -> Json:
        """The window's place in the order: its oldest group, where that lies, and the next one."""
        group, slot = self._starts[0] if self._starts else (0, 0)
        return {"group": group, "slot": slot, "next": self._fed}

    def load_state(self, place: Json) -> None:
        """Read again what the window held at a `state()`."""
        self.close()
        self._fed, self.window.total = place["group"], place["slot"]
        while self._fed < place["next"]:
            self._take()

    def close(self) -> None:
        """Stop reading ahead."""
        if self._groups is not None and hasattr(self._groups, "close"):
            self._groups.close()
        self._groups = None

    def _take(self) -> None:
        """Put the next group into the window."""
        if self._groups is None:
            self._groups = self._reader(islice(self._order(), self._fed, None))
        columns = next(self._groups)
        self._starts.append((self._fed, self.window.total))
        self.window.add(columns.block(first=self._fed * GROUP))
        self._fed += 1
        oldest = self.window.total - self.window.slots
        while len(self._starts) > 1 and self._starts[1][1] <= oldest:
            self._starts.popleft()

    def _order(self) -> Iterator[Group]:
        """Groups of episodes: one pass over all of them after the other, or one if all fit."""
        for turn in count() if self._passes else range(1):
            order = np.random.default_rng([self._seed, ORDER, turn]).permutation(len(self._logged))
            for start in range(0, len(order), GROUP):
                yield tuple(self._logged[at] for at in order[start : start + GROUP])
