"""A folder of logs as one set of episodes: sized, indexable, iterable; read when asked for.

    clean = [episode for episode in coordlog.open("logs/") if episode.result.clean]
    table = coordlog.open("logs/").to_table()      # pyarrow, one row per step

A file that is not a finished episode is an error that names it; with `skip_broken` it is listed in
`skipped` instead. Part files belong to recordings in progress or interrupted: they are listed in
`parts`, never read.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple, TypeVar, overload

import numpy as np
import pyarrow as pa

from coordlog.episode import Array, Episode, Header
from coordlog.errors import FormatError, SpecError, StorageError
from coordlog.record.arrow import EPISODE_INDEX, arrow_field, record_batch
from coordlog.record.contents import contents
from coordlog.record.decoding import joined, opened_episode
from coordlog.record.files import SUFFIX as SUFFIX
from coordlog.record.files import Files as Files
from coordlog.record.files import Skipped as Skipped
from coordlog.record.files import find_files as find_files
from coordlog.record.files import nothing_found as nothing_found
from coordlog.record.opening import File, load, naming
from coordlog.record.reader import probe, read_episode
from coordlog.spec import STEP_INDEX

_T = TypeVar("_T")

Columns = tuple[dict[str, Array], dict[str, Array], Array]
"""Columns of all steps and of all final states, and the lengths of the episodes."""

_GROUP = 16  # files decoded together: their blocks stay in the cache


def open(path_or_paths: File | Iterable[File], *, skip_broken: bool = False) -> Dataset:
    """Episodes of files and folders, as a lazy set; looks at both ends of each file and reads
    nothing else.

    Args:
        path_or_paths: Files, or folders that are searched at any depth for `*.mcap`.
        skip_broken: List files that are not finished episodes in `skipped`, and those found damaged
            when they are read.

    Raises:
        StorageError: if a path does not exist.
        FormatError: if a file is not a finished episode, and they are not to be skipped.
    """
    files = find_files(path_or_paths)
    dataset = Dataset((), parts=files.parts, skip_broken=skip_broken)
    if files.skipped and not skip_broken:
        path, reason = files.skipped[0]
        raise StorageError(f"{path}: {reason}; skip_broken leaves it out")
    dataset.skipped += files.skipped
    dataset.paths = tuple(path for path in files.paths if dataset.attempt(path, probe) is not None)
    return dataset


class Dataset(Sequence[Episode]):
    """Episodes by index, in the order of `paths`."""

    def __init__(
        self, paths: tuple[Path, ...], *, parts: tuple[Path, ...] = (), skip_broken: bool = False
    ) -> None:
        """For use by `open`."""
        self.paths, self.parts = paths, parts
        self.skipped: list[Skipped] = []
        self._broken: set[Path] = set()
        self._skip_broken = skip_broken

    def __len__(self) -> int:
        return len(self.paths)

    @overload
    def __getitem__(self, index: int) -> Episode: ...
    @overload
    def __getitem__(self, index: slice) -> Dataset: ...
    def __getitem__(self, index: int | slice) -> Episode | Dataset:
        """One episode, read now; or the set of some of them."""
        if isinstance(index, slice):
            return Dataset(self.paths[index], parts=self.parts, skip_broken=self._skip_broken)
        return read_episode(self.paths[index])

    def __iter__(self) -> Iterator[Episode]:
        """Read one episode after the other; damaged ones are raised or skipped as asked."""
        for path in self.paths:
            episode = self.attempt(path, read_episode)
            if episode is not None:
                yield episode

    def to_table(self) -> pa.Table:
        """All steps of all episodes: the columns of `Header.fields`, `step`, and `episode`, the
        index into `paths`.

        Raises:
            SpecError: if the episodes are of different robots or tasks.
            FormatError: if a file is damaged, and they are not to be skipped.
        """
        batches: list[pa.RecordBatch] = []
        first: _Loaded | None = None
        for start in range(0, len(self.paths), _GROUP):
            tried = [
                self.attempt(path, partial(_Loaded, index))
                for index, path in enumerate(self.paths[start : start + _GROUP], start)
            ]
            group = [loaded for loaded in tried if loaded is not None]
            for loaded in group:
                first = first or loaded
                first.require_same(loaded)
            batches += self.converted(group, _step_batch) if group else []
        if not batches:
            raise SpecError("no episodes: there are no columns to make a table of")
        return pa.Table.from_batches(batches)

    def attempt(self, path: Path, read: Callable[[Path], _T]) -> _T | None:
        """What `read` made of a file.

        One that is broken is raised, or listed in `skipped` and None.
        """
        try:
            return read(path)
        except (FormatError, StorageError) as error:
            if not self._skip_broken:
                raise
            if path not in self._broken:
                self._broken.add(path)
                self.skipped.append(Skipped(path, str(error).removeprefix(f"{path}: ")))
            return None

    def converted(self, group: list[_Loaded], convert: Callable[[list[_Loaded]], _T]) -> list[_T]:
        """What some files become together, or one by one if one of them turns out to be broken."""
        try:
            return [convert(group)]
        except FormatError:  # some file of the group: one at a time tells which
            tried = [
                self.attempt(loaded.path, lambda _, loaded=loaded: convert([loaded]))  # type: ignore[misc]
                for loaded in group
            ]
            return [made for made in tried if made is not None]


class _Loaded:
    """A file's records, waiting to be decoded together with those of others."""

    def __init__(self, index: int, path: Path) -> None:
        data = load(path)
        with naming(path):
            self.found = contents(data, rows=True)
            self.header, self.result = opened_episode(self.found)
        self.sha256 = hashlib.sha256(data).hexdigest()
        self.index, self.path = index, path
        self.layout, self.arms = self.header.layout, self.header.arms
        self.fields = self.header.fields
        self.kind = repr((self.layout, self.arms, self.fields))

    def require_same(self, other: _Loaded) -> None:
        """Refuse to mix robots or tasks in one table."""
        for name in ("layout", "arms", "fields"):
            mine, its = getattr(self, name), getattr(other, name)
            if mine != its:
                raise SpecError(
                    f"{other.path}: expected the {name} of {self.path.name}, {mine}, got {its}; "
                    "open them as separate sets"
                )


def _decoded(group: list[_Loaded]) -> Columns:
    """Columns of all steps and of all final states of a group, and the lengths of its episodes."""
    with naming(group[0].path):
        return joined(
            [loaded.found for loaded in group],
            group[0].header,
            [loaded.result for loaded in group],
        )


def _step_batch(group: list[_Loaded], columns: Columns | None = None) -> pa.RecordBatch:
    steps, _, lengths = columns or _decoded(group)
    episode = np.repeat(np.array([loaded.index for loaded in group], np.int32), lengths)
    fields = [item for item in (STEP_INDEX, *group[0].fields) if item.name in steps]
    return record_batch(
        [EPISODE_INDEX, *(arrow_field(item, group[0].layout) for item in fields)],
        {"episode": episode, **steps},
    )


class Decoded(NamedTuple):
    """Episodes of one kind (robot and task), decoded in one go."""

    steps: pa.Table
    """as `Dataset.to_table`"""
    finals: pa.Table
    """One row per episode: the "state" after its last action, and its "length"."""
    headers: tuple[Header, ...]
    digests: tuple[str, ...]
    """sha256 of the files"""


def decoded(
    paths: Sequence[Path],
    *,
    skipped: list[Skipped],
    digests: dict[Path, str],
    known: frozenset[str] = frozenset(),
) -> list[Decoded]:
    """Files decoded kind by kind; each is read once.

    Args:
        paths: Files that may be episodes.
        skipped: Those that are not are added here.
        digests: The sha256 of those that are is added here.
        known: Digests of files that need no decoding.
    """
    dataset = Dataset((), skip_broken=True)
    kinds: dict[str, list[_Both]] = {}
    seen = set(known)
    for start in range(0, len(paths), _GROUP):
        alike: dict[str, list[_Loaded]] = {}
        for path in paths[start : start + _GROUP]:
            loaded = dataset.attempt(path, partial(_Loaded, 0))
            if loaded is None:
                continue
            digests[path] = loaded.sha256
            if loaded.sha256 not in seen and loaded.result.length:
                alike.setdefault(loaded.kind, []).append(loaded)
                seen.add(loaded.sha256)
        for kind, group in alike.items():
            kinds.setdefault(kind, []).extend(dataset.converted(group, _both))
    skipped += dataset.skipped
    for item in dataset.skipped:
        digests.pop(item.path, None)
    return [
        Decoded(
            pa.Table.from_batches([part.steps for part in parts]),
            pa.Table.from_batches([part.finals for part in parts]),
            tuple(loaded.header for part in parts for loaded in part.group),
            tuple(loaded.sha256 for part in parts for loaded in part.group),
        )
        for parts in kinds.values()
        if parts
    ]


class _Both(NamedTuple):
    group: list[_Loaded]
    steps: pa.RecordBatch
    finals: pa.RecordBatch


def _both(group: list[_Loaded]) -> _Both:
    columns = _decoded(group)
    _, final, lengths = columns
    field = arrow_field(next(i for i in group[0].fields if i.name == "state"), group[0].layout)
    finals = record_batch([field], {"state": final["state"]})
    return _Both(
        group, _step_batch(group, columns), finals.append_column("length", pa.array(lengths))
    )
