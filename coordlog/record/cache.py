"""Decoded columns kept on disk, so that no file is decoded twice. Deleting the cache only costs
time.

A shard is two Arrow IPC files: the steps of some episodes (memory-mapped when read) and one row per
episode with its final state, its result, what its header says and the sha256 of its file; and,
written last, a file of their sizes and CRCs. What does not agree with its CRC is decoded anew. A
shard's name is a digest of the episodes in it: two processes that build the same shard write the
same files, and either may win. A folder that others may write to is not used. Packs cannot take its
place: they hold files, and decoding those is what is saved here.
"""

from __future__ import annotations

import hashlib
import json
import mmap
import os
import stat
import tempfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa

from coordlog.episode import Header, Json
from coordlog.errors import SpecError
from coordlog.record.dataset import Decoded, decoded
from coordlog.record.digests import (
    EDITION,
    read_json,
    remember,
    remembered,
    replace_file,
    stamp_of,
    write_json,
)
from coordlog.record.files import Skipped
from coordlog.record.storage import translated
from coordlog.spec import LEARNT, REWARDED, names

SHARD = 128
"""Episodes in a shard."""
STEPS, EPISODES, SUMS = ".steps.arrow", ".episodes.arrow", ".sums.json"
TRIES = 3  # a shard that is still damaged when it was made so often is not used
Run = Callable[[Callable[[Sequence[Path]], "Built"], Sequence[Sequence[Path]]], Iterable["Built"]]
"""Maps a function over groups of files, on as many processes as it likes."""


@dataclass(frozen=True)
class Built:
    """What became of a group of files."""

    files: int
    skipped: tuple[Skipped, ...]
    digests: dict[Path, str] = field(default_factory=dict)
    """sha256 of those that are episodes."""


@dataclass(frozen=True, eq=False)
class Logs:
    """Columns of a set of episodes, in the order of their files."""

    steps: pa.Table
    """One row per step: what `spec.LEARNT` names, or `REWARDED` where no task of ours judged; the
    rest stays in the files."""
    episodes: pa.Table
    """One row per episode: scene, split, robot, start, seed, index, env (the `coordlog.env` record
    as JSON), state (final), length, digest, file. The catalogue says the rest."""
    skipped: tuple[Skipped, ...]
    notes: tuple[str, ...] = ()
    """What is worth knowing about how they were read."""

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
        episodes = self.episodes.take(pa.array(rows, pa.int64()))
        return replace(self, steps=steps, episodes=episodes)


def load(paths: Sequence[Path], folder: Path, *, run: Run, verify: bool = False) -> Logs:
    """Columns of episode files, decoding only those that the cache does not know yet.

    Args:
        paths: Finished episode files.
        folder: The cache; made if missing.
        run: Maps over groups of files that are to be decoded; see Run.
        verify: Read every file again to see whether it is still the one that was decoded.

    Raises:
        SpecError: if no episode is left.
        StorageError: if the cache cannot be written.
    """
    skipped: dict[Path, Skipped] = {}
    with _trusted(folder) as (place, notes):
        stamps = {path: stamp_of(path) for path in paths}
        digests = {} if verify else remembered(place, stamps)
        known, tried = _known(place), set[Path]()
        for _ in range(TRIES):
            missing = [path for path in paths if digests.get(path) not in known]
            missing = [path for path in missing if path not in tried]
            groups = [missing[i : i + SHARD] for i in range(0, len(missing), SHARD)]
            for built in run(partial(build, folder=place), groups):
                skipped |= {item.path: item for item in built.skipped}
                digests |= built.digests
            tried |= {*missing}
            known = _known(place) if missing else known
            used = {known[digest][0] for digest in digests.values() if digest in known}
            broken = [shard for shard in sorted(used) if not _agrees(place, shard, STEPS)]
            if not broken:
                break
            notes = (*notes, f"{place}: {len(broken)} damaged parts of the cache are made anew")
            _remove(place, broken)
            known = {key: at for key, at in known.items() if at[0] not in broken}
            tried = {*skipped}
        remember(place, stamps, digests)
        here = [path for path in paths if digests.get(path) in known]
        if not here:
            first = next(iter(skipped.values()), None)
            why = f"; {first.path}: {first.reason}" if first else ""
            raise SpecError(
                "no logs: expected at least one finished episode to learn from, got none in "
                f"{len(paths)} files{why}"
            )
        logs = _gathered(place, [known[digests[path]] for path in here], tuple(skipped.values()))
    files = pa.array([str(path) for path in here])
    return replace(logs, episodes=logs.episodes.append_column("file", files), notes=notes)


def build(paths: Sequence[Path], *, folder: Path) -> Built:
    """Read and decode some files, each once, into shards; broken files are left out and named."""
    skipped: list[Skipped] = []
    digests: dict[Path, str] = {}
    known = frozenset(_known(folder))
    for part in decoded(paths, skipped=skipped, digests=digests, known=known):
        episodes = _described(part)
        ours = "distance" in part.steps.column_names
        learnt = names(LEARNT if ours else REWARDED)
        kept = [name for name in learnt if name in part.steps.column_names]
        name = hashlib.sha256((EDITION + "".join(part.digests)).encode()).hexdigest()[:24]
        sums = {
            STEPS: _write(folder / f"{name}{STEPS}", part.steps.select(kept)),
            EPISODES: _write(folder / f"{name}{EPISODES}", episodes),
        }
        write_json(folder / f"{name}{SUMS}", {"edition": EDITION, "sums": sums})
    return Built(len(paths), tuple(skipped), digests)


@contextmanager
def _trusted(folder: Path) -> Iterator[tuple[Path, tuple[str, ...]]]:
    """The cache folder if nobody else can have written to it, else an empty one for this time."""
    with translated(folder, "make the cache folder"):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.stat()
    if status.st_uid == os.geteuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        yield folder, ()
        return
    why = "belongs to another user" if status.st_uid != os.geteuid() else "others may write to it"
    with tempfile.TemporaryDirectory(prefix="coordlog-") as apart:  # mapped files outlive it
        yield Path(apart), (f"{folder}: the cache is not used: {why}; logs are decoded anew",)


def _described(part: Decoded) -> pa.Table:
    """Rows of `Logs.episodes`, without the file's name: it may change."""
    rows = [_said(header) for header in part.headers]
    table = pa.Table.from_pylist(rows, schema=_SAID)
    for name in ("state", "length"):
        table = table.append_column(name, part.finals.column(name))
    return table.append_column("digest", pa.array(list(part.digests))).combine_chunks()


_SAID = pa.schema(
    {
        **dict.fromkeys(("scene", "split", "robot", "start"), pa.string()),
        **dict.fromkeys(("seed", "index"), pa.int64()),
        "env": pa.string(),
    }
)


def _said(header: Header) -> Json:
    """What a header says, for the columns of `_SAID`."""
    about = header.episode
    row: Json = {key: _text(about.get(key)) for key in ("scene", "split", "robot", "start")}
    row |= {key: _whole(about.get(key)) for key in ("seed", "index")}
    return row | {"env": json.dumps(header.env)}


def _text(value: object) -> str:
    return value if isinstance(value, str) else ""


def _whole(value: object) -> int | None:
    return value if type(value) is int and abs(value) < 1 << 63 else None


def _write(path: Path, table: pa.Table) -> list[int]:
    """Write an Arrow IPC file at once or not at all; its size and CRC."""
    sink = pa.BufferOutputStream()
    with pa.ipc.new_file(sink, table.schema) as writer:
        writer.write_table(table.combine_chunks())
    content = sink.getvalue()
    replace_file(path, memoryview(content))
    return [content.size, zlib.crc32(content)]


def _known(folder: Path) -> dict[str, tuple[str, int]]:
    """Shard and row of every episode in the cache, by the digest of its file."""
    known: dict[str, tuple[str, int]] = {}
    for path in sorted(folder.glob(f"*{SUMS}")):
        shard = path.name.removesuffix(SUMS)
        if not _agrees(folder, shard, EPISODES):
            continue
        with suppress(pa.ArrowException, KeyError):
            digests = _mapped(folder / f"{shard}{EPISODES}").column("digest").to_pylist()
            known |= {digest: (shard, row) for row, digest in enumerate(digests)}
    return known


def _agrees(folder: Path, shard: str, kind: str) -> bool:
    """Whether a file of a shard has the size and the CRC that were noted when it was written."""
    sums = read_json(folder / f"{shard}{SUMS}").get("sums", {})
    try:
        with (folder / f"{shard}{kind}").open("rb") as stream:
            size = os.fstat(stream.fileno()).st_size
            if size == 0 or sums.get(kind, [])[:1] != [size]:
                return False
            with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
                return bool(sums[kind] == [size, zlib.crc32(content)])
    except (OSError, TypeError, AttributeError):
        return False


def _remove(folder: Path, shards: Iterable[str]) -> None:
    """Forget some shards; the record of their sums goes first."""
    for shard in shards:
        for kind in (SUMS, EPISODES, STEPS):
            with suppress(OSError):
                (folder / f"{shard}{kind}").unlink()


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
        robots = sorted(
            {str(name) for part in parts for name in part.episodes.column("robot").to_pylist()}
        )
        raise SpecError(
            f"logs of several layouts (robots: {', '.join(robots)}): learn from one robot and one "
            "state layout at a time"
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
