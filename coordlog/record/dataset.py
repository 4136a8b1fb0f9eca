"""A folder of logs as one set of episodes: sized, indexable, iterable; read when asked for.

    with_clean = [episode for episode in coordlog.record.dataset.open("logs/") if
    episode.result.clean] table = coordlog.record.dataset.open("logs/").to_table()      # pyarrow, one row per step

A file that is not a finished episode is an error that names it; with `skip_broken` it is listed in
`skipped` instead. Part files belong to recordings in progress or interrupted: they are listed in
`parts`, never read.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple, TypeVar, overload

import numpy as np
import pyarrow as pa

from coordlog.episode import Array, Episode, Result
from coordlog.errors import FormatError, SpecError, StorageError
from coordlog.record.addresses import expand
from coordlog.record.arrow import EPISODE_INDEX, arrow_field, record_batch
from coordlog.record.messages import decode_final, decode_steps
from coordlog.record.metadata import (
    ENV,
    EPISODE,
    RESULT,
    decode_layout,
    decode_result,
    require_version,
)
from coordlog.record.opening import File, load, naming
from coordlog.record.reader import Contents, contents, probe, read_episode, require_order
from coordlog.record.storage import PART
from coordlog.spec import FINAL, STEP

_T = TypeVar("_T")

SUFFIX = ".mcap"

_TOPICS = frozenset({STEP.topic, FINAL.topic})
_GROUP = 16  # files decoded together: their blocks stay in the cache


class Skipped(NamedTuple):
    """A file that was left out, and why."""

    path: Path
    reason: str


class Files(NamedTuple):
    """Episode files and part files, each sorted by name."""

    paths: tuple[Path, ...]
    parts: tuple[Path, ...]


def find_files(path_or_paths: File | Iterable[File]) -> Files:
    """The episode files that are named, or lie in the folders that are named, at any depth.

    Raises:
        StorageError: if a path does not exist.
    """
    given = [path_or_paths] if isinstance(path_or_paths, str | os.PathLike) else list(path_or_paths)
    paths: list[Path] = []
    parts: list[Path] = []
    for path in map(Path, given):
        found = expand(path, search=lambda sources: find_files(sources).paths)
        if found is not None:
            paths += found.paths
            continue
        if not path.exists():
            raise StorageError(f"{path}: no such file or folder")
        paths += _below(path, SUFFIX) if path.is_dir() else [path]
        parts += _below(path, SUFFIX + PART) if path.is_dir() else []
    return Files(tuple(paths), tuple(parts))


def _below(folder: Path, suffix: str) -> list[Path]:
    return sorted(path for path in folder.rglob("*" + suffix) if not path.is_dir())


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
        """All steps of all episodes: the columns of `spec.STEP` and `episode`, the index into
        `paths`.

        Raises:
            SpecError: if the episodes are of different robots or tasks.
            FormatError: if a file is damaged, and they are not to be skipped.
        """
        return self._table(_step_batch)

    def finals(self) -> pa.Table:
        """One row per episode: its final state and its result.

        Raises:
            SpecError: if the episodes are of different robots or tasks.
            FormatError: if a file is damaged, and they are not to be skipped.
        """
        return self._table(_final_batch)

    def attempt(self, path: Path, read: Callable[[Path], _T]) -> _T | None:
        """What `read` made of a file.

        One that is broken is raised, or listed in `skipped` and None.
        """
        try:
            return read(path)
        except (FormatError, StorageError) as error:
            if not self._skip_broken:
                raise
            if path not in (skipped.path for skipped in self.skipped):
                self.skipped.append(Skipped(path, str(error).removeprefix(f"{path}: ")))
            return None

    def _table(self, convert: Callable[[list[_Loaded]], pa.RecordBatch]) -> pa.Table:
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
            batches += self._converted(group, convert) if group else []
        if not batches:
            raise SpecError("no episodes: there are no columns to make a table of")
        return pa.Table.from_batches(batches)

    def _converted(
        self, group: list[_Loaded], convert: Callable[[list[_Loaded]], pa.RecordBatch]
    ) -> list[pa.RecordBatch]:
        try:
            return [convert(group)]
        except FormatError:  # some file of the group: one at a time tells which
            tried = [
                self.attempt(loaded.path, lambda _, loaded=loaded: convert([loaded]))
                for loaded in group
            ]  # type: ignore[misc]
            return [batch for batch in tried if batch is not None]


class _Loaded:
    """A file's records, waiting to be decoded together with those of others."""

    def __init__(self, index: int, path: Path) -> None:
        data = load(path)
        with naming(path):
            found: Contents = contents(data, only=_TOPICS)
            require_version(found.metadata.get(EPISODE, {}))
            self.layout, self.arms = decode_layout(found.metadata.get(ENV, {}))
            self.result: Result = decode_result(found.metadata.get(RESULT, {}))
        self.index, self.path = index, path
        self.steps, self.final = (
            found.messages.get(STEP.topic, []),
            found.messages.get(FINAL.topic, []),
        )

    def require_same(self, other: _Loaded) -> None:
        """Refuse to mix robots or tasks in one table."""
        for name in ("layout", "arms"):
            mine, its = getattr(self, name), getattr(other, name)
            if mine != its:
                raise SpecError(
                    f"{other.path}: expected the {name} of {self.path.name}, {mine}, got {its}; open them as separate sets"
                )


def _decoded(group: list[_Loaded]) -> tuple[dict[str, Array], dict[str, Array], Array]:
    """Columns of all steps and of all final states of a group, and the lengths of its episodes."""
    layout, lengths = group[0].layout, np.array([loaded.result.length for loaded in group])
    with naming(group[0].path):
        steps = decode_steps([record for loaded in group for record in loaded.steps], layout)
        final = decode_final([record for loaded in group for record in loaded.final], layout)
        require_order(steps["step"], final["step"], lengths)
    return steps, final, lengths


def _step_batch(group: list[_Loaded]) -> pa.RecordBatch:
    steps, _, lengths = _decoded(group)
    episode = np.repeat(np.array([loaded.index for loaded in group], np.int32), lengths)
    return record_batch(
        [EPISODE_INDEX, *(arrow_field(item, group[0].layout) for item in STEP.fields)],
        {"episode": episode, **steps},
    )


def _final_batch(group: list[_Loaded]) -> pa.RecordBatch:
    _, final, lengths = _decoded(group)
    fields = [EPISODE_INDEX, *(arrow_field(item, group[0].layout) for item in FINAL.fields[1:])]
    batch = record_batch(
        fields, {"episode": np.array([loaded.index for loaded in group], np.int32), **final}
    )
    rest = {
        "file": [str(loaded.path) for loaded in group],
        "length": lengths,
        "returns": pa.array(
            [loaded.result.returns for loaded in group], pa.list_(pa.float64(), group[0].layout.k)
        ),
    }
    for name in ("success", "clean", "terminated", "truncated", "aborted", "digest"):
        rest[name] = [getattr(loaded.result, name) for loaded in group]
    for name, values in rest.items():
        batch = batch.append_column(name, pa.array(values))
    return batch
