"""Decoded columns kept on disk, so that no file is decoded twice. Deleting the cache only costs
time.

A shard is two Arrow IPC files: the steps of some episodes (memory-mapped when read) and, written
last, one row per episode with its final state, its result, what its header says and the sha256 of
its file. A shard's name is a digest of the episodes in it: two processes that build the same shard
write the same file, and either may win. There is no index that could be wrong: the rows say what is
there.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa

from coordlog.episode import Json
from coordlog.errors import FormatError, SpecError
from coordlog.record.dataset import Skipped
from coordlog.record.dataset import open as open_logs
from coordlog.record.reader import read_summary
from coordlog.record.storage import translated
from coordlog.version import __version__

SHARD = 128
"""Episodes in a shard."""
EDITION = f"{__version__}-1"
"""Shards of another edition are not read."""
STEPS, EPISODES = ".steps.arrow", ".episodes.arrow"
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
"""What training reads; the rest stays in the files."""

Run = Callable[[Callable[[Sequence[Path]], "Built"], Sequence[Sequence[Path]]], Iterable["Built"]]
"""Maps a function over groups of files, on as many processes as it likes."""


@dataclass(frozen=True)
class Built:
    """What became of a group of files."""

    files: int
    skipped: tuple[Skipped, ...]


@dataclass(frozen=True, eq=False)
class Logs:
    """Columns of a set of episodes, in the order of their files."""

    steps: pa.Table
    """One row per step: STEP_COLUMNS."""
    episodes: pa.Table
    """One row per episode: state (final), length, success, clean, collided, fell, aborted, scene,
    split, seed, index, robot, policy, noise, start, transform, returns, file, digest, and env (the
    `coordlog.env` record as JSON)."""
    skipped: tuple[Skipped, ...]

    def __len__(self) -> int:
        """Number of episodes."""
        return int(self.episodes.num_rows)

    def env(self, episode: int) -> Json:
        """The `coordlog.env` record of one episode."""
        record: Json = json.loads(self.episodes.column("env")[episode].as_py())
        return record

    def select(self, rows: Sequence[int]) -> Logs:
        """Some of the episodes."""
        lengths = np.asarray(self.episodes.column("length"))
        starts = np.cumsum(lengths) - lengths
        parts = [self.steps.slice(int(starts[row]), int(lengths[row])) for row in rows]
        steps = pa.concat_tables(parts) if parts else self.steps.slice(0, 0)
        return Logs(steps, self.episodes.take(pa.array(rows, pa.int64())), self.skipped)


def load(paths: Sequence[Path], folder: Path, *, run: Run) -> Logs:
    """Columns of episode files, decoding only those that the cache does not know yet.

    Args:
        paths: Finished episode files.
        folder: The cache; made if missing.
        run: Maps over groups of files that are to be decoded; see Run.

    Raises:
        SpecError: if no episode is left.
        StorageError: if the cache cannot be written.
    """
    with translated(folder, "make the cache folder"):
        folder.mkdir(parents=True, exist_ok=True)
    digests = {path: file_digest(path) for path in paths}
    known = _known(folder)
    missing = list(
        {digest: path for path, digest in digests.items() if digest not in known}.values()
    )  # of copies, one
    groups, skipped = _alike(missing)
    for built in run(partial(build, folder=folder), groups):
        skipped += built.skipped
    known = _known(folder) if missing else known
    places = [known[digest] for digest in digests.values() if digest in known]
    if not places:
        why = f"; {skipped[0].path}: {skipped[0].reason}" if skipped else ""
        raise SpecError(
            f"no logs: expected at least one finished episode to learn from, got none in {len(paths)} files{why}"
        )
    return _gathered(folder, places, tuple(skipped))


def build(paths: Sequence[Path], *, folder: Path) -> Built:
    """Decode some files into a shard; broken files are left out and named.

    Raises:
        StorageError: if the cache cannot be written.
    """
    dataset = open_logs(paths, skip_broken=True)
    try:
        steps, finals = dataset.to_table(), dataset.finals()
    except SpecError:  # not one of them can be read
        return Built(len(paths), tuple(dataset.skipped))
    episodes = _described(finals, steps)
    name = hashlib.sha256(
        (EDITION + "".join(episodes.column("digest").to_pylist())).encode()
    ).hexdigest()[:24]
    _write(folder / f"{name}{STEPS}", steps.select(STEP_COLUMNS))
    _write(folder / f"{name}{EPISODES}", episodes)
    return Built(len(paths), tuple(dataset.skipped))


def file_digest(path: Path) -> str:
    """sha256 of a file.

    Raises:
        StorageError: if it cannot be read.
    """
    with translated(path, "read the file"), path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _alike(paths: Sequence[Path]) -> tuple[list[list[Path]], list[Skipped]]:
    """Files in groups of one layout and at most SHARD, and those that are no episodes."""
    groups: dict[str, list[Path]] = {}
    skipped: list[Skipped] = []
    for path in paths:
        try:
            summary = read_summary(path)
        except FormatError as error:
            skipped.append(Skipped(path, str(error).removeprefix(f"{path}: ")))
            continue
        if summary.result.length:
            groups.setdefault(repr((summary.header.layout, summary.header.arms)), []).append(path)
    return [
        group[i : i + SHARD] for group in groups.values() for i in range(0, len(group), SHARD)
    ], skipped


def _described(finals: pa.Table, steps: pa.Table) -> pa.Table:
    """Rows of `Logs.episodes`."""
    starts = np.concatenate([[0], np.cumsum(finals.column("length"))[:-1]]).astype(np.int64)
    rows = []
    for name in finals.column("file").to_pylist():
        header = read_summary(name).header
        policy = header.policy
        row = {
            key: header.episode[key]
            for key in ("scene", "split", "seed", "index", "robot", "start")
        }
        row |= {
            "policy": policy["name"],
            "noise": float(policy["noise"].get("sigma", 0.0)),
            "transform": header.lineage["transform"],
        }
        rows.append({**row, "env": json.dumps(header.env), "digest": file_digest(Path(name))})
    table = finals.select(
        [
            "state",
            "length",
            "success",
            "clean",
            "terminated",
            "truncated",
            "aborted",
            "returns",
            "file",
        ]
    )
    for column, flag in (("collided", "collision"), ("fell", "instability")):
        values = np.logical_or.reduceat(steps.column(flag).to_numpy(zero_copy_only=False), starts)
        table = table.append_column(column, pa.array(values))
    described = pa.Table.from_pylist(rows)
    for column in described.column_names:
        table = table.append_column(column, described.column(column))
    return table.combine_chunks()


def _write(path: Path, table: pa.Table) -> None:
    """Write an Arrow IPC file at once or not at all."""
    with translated(path, "write the cache"):
        handle, name = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
        os.close(handle)
        try:
            with pa.OSFile(name, "wb") as sink, pa.ipc.new_file(sink, table.schema) as writer:
                writer.write_table(table.combine_chunks())
            os.replace(name, path)
        except BaseException:
            os.unlink(name)
            raise


def _known(folder: Path) -> dict[str, tuple[str, int]]:
    """Shard and row of every episode in the cache, by the digest of its file."""
    known: dict[str, tuple[str, int]] = {}
    for path in sorted(folder.glob(f"*{EPISODES}")):
        shard = path.name.removesuffix(EPISODES)
        for row, digest in enumerate(_mapped(path).column("digest").to_pylist()):
            known[digest] = (shard, row)
    return known


def _mapped(path: Path) -> pa.Table:
    """A shard's table over the memory-mapped file."""
    with translated(path, "read the cache", "delete the cache folder; that only costs time"):
        return pa.ipc.open_file(pa.memory_map(str(path))).read_all()


def _gathered(
    folder: Path, places: Sequence[tuple[str, int]], skipped: tuple[Skipped, ...]
) -> Logs:
    """The episodes at these places, over the memory of the shards."""
    shards = {
        name: Logs(_mapped(folder / f"{name}{STEPS}"), _mapped(folder / f"{name}{EPISODES}"), ())
        for name, _ in set(places)
    }
    parts: list[Logs] = []
    for name, members in _runs(places):
        whole = shards[name]
        parts.append(whole if members == list(range(len(whole))) else whole.select(members))
    widths = {part.episodes.schema.field("state").type for part in parts} | {
        part.steps.schema for part in parts
    }
    if len(widths) > 2:
        names = sorted(
            {str(name) for part in parts for name in part.episodes.column("robot").to_pylist()}
        )
        raise SpecError(
            f"logs of several layouts (robots: {', '.join(names)}): learn from one robot and one state layout at a time"
        )
    return Logs(
        pa.concat_tables([part.steps for part in parts]),
        pa.concat_tables([part.episodes for part in parts]),
        skipped,
    )


def _runs(places: Sequence[tuple[str, int]]) -> Iterator[tuple[str, list[int]]]:
    """Consecutive places in one shard, together."""
    members: list[int] = []
    shard = ""
    for name, row in places:
        if name != shard and members:
            yield shard, members
            members = []
        shard = name
        members.append(row)
    if members:
        yield shard, members
