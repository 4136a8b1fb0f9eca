"""Episodes that are no files of their own: members of packs, objects of a store, and what a
manifest lists.

Each has an address that goes wherever a path goes: `PACK/shard-000000.tar/NAME.mcap`,
`s3://BUCKET/PREFIX/NAME.mcap`. `expand` finds them in what a user named; `fetch` gets the bytes of
one.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from coordlog.errors import StorageError
from coordlog.record import manifest
from coordlog.record.buckets import Bucket
from coordlog.record.packs import Pack, is_shard, members_of
from coordlog.record.places import Entry, Folder, Place, is_url, split_url
from coordlog.record.storage import translated

EPISODE = ".mcap"
SECOND = 10**9  # ns

_MEMBER = re.compile(r"(^|/)shard-\d{6,}\.tar(/|$)")

File = str | os.PathLike[str]


class Expanded(NamedTuple):
    """The episodes that an address stands for."""

    paths: tuple[Path, ...]
    left_out: tuple[tuple[Path, str], ...]
    """What is missing or broken, and why."""


class _Inside(NamedTuple):
    """A member of a pack, or an object."""

    place: str
    shard: str
    """"" for an object of its own"""
    name: str


def expand(path: Path, *, search: Callable[[Sequence[Path]], Iterable[Path]]) -> Expanded | None:
    """The episodes of a pack, an object store's prefix or a manifest; None for any other path.

    Args:
        path: What a user named.
        search: The files in some folders or stores, for episodes of a manifest that have moved.

    Raises:
        StorageError: if there is no such pack, prefix or manifest.
        FormatError: if a pack's index or a manifest is damaged.
    """
    if manifest.is_manifest(path):
        found = manifest.resolve(
            path,
            stat=size_and_time,
            digest=sha256,
            search=lambda sources: search([each for each in sources if _is_there(each)]),
        )
        gone = tuple(
            (Path(each.path), f"gone: no file with the sha256 {each.digest[:12]} was found")
            for each in found.gone
        )
        return Expanded(found.paths, gone)
    if is_elsewhere(path):
        inside = _inside(path)
        if inside.shard and inside.name:
            return Expanded((path,), ())
        if inside.shard:
            return _of_pack(pack_at(inside.place), Path(inside.place), only=inside.shard)
        return _of_bucket(path)
    if is_pack(path):
        return _of_pack(pack_at(str(path)), path)
    return None


def is_elsewhere(path: File) -> bool:
    """Whether an address is of a shard, a member of one, or an object, by its spelling."""
    text = os.fspath(path)
    return is_url(text) or _MEMBER.search(text) is not None


def is_single(path: File) -> bool:
    """Whether an address names one file, not a folder, a pack, a store or a manifest of many."""
    if manifest.is_manifest(path):
        return False
    return os.fspath(path).endswith(EPISODE) if is_elsewhere(path) else not os.path.isdir(path)


def _is_there(path: Path) -> bool:
    return is_elsewhere(path) or path.exists()


def is_pack(path: Path) -> bool:
    """Whether a folder of this machine holds shards."""
    try:
        with os.scandir(path) as entries:
            return any(is_shard(entry.name) for entry in entries)
    except OSError:
        return False


def fetch(path: File) -> bytes:
    """The bytes of a member or an object: one read, or one request.

    Raises:
        StorageError: if there is none, or it cannot be read.
    """
    inside = _inside(path)
    if inside.shard:
        return pack_at(inside.place).read(inside.shard, inside.name)
    return place_at(inside.place).read(inside.name)


def contents_of(path: File) -> bytes:
    """All bytes of an episode, wherever it lies.

    Raises:
        StorageError: if it cannot be read.
    """
    if is_elsewhere(path):
        return fetch(path)
    with translated(Path(path), "read"):
        return Path(path).read_bytes()


def sha256(path: File) -> str:
    """The digest of an episode file, wherever it lies.

    Raises:
        StorageError: if it cannot be read.
    """
    return hashlib.sha256(contents_of(path)).hexdigest()


def size_and_time(path: File) -> tuple[int, int] | None:
    """Size and mtime [ns] of an episode, wherever it lies; None if there is none."""
    if not is_elsewhere(path):
        try:
            status = os.stat(path)
        except OSError:
            return None
        return status.st_size, status.st_mtime_ns
    inside = _inside(path)
    try:
        if inside.shard:
            member = pack_at(inside.place).member(inside.shard, inside.name)
            return member.size, member.mtime * SECOND
        entry = place_at(inside.place).entry(inside.name)
    except StorageError:
        return None
    return None if entry is None else (entry.size, entry.mtime)


def name_within(path: Path, named: Path, *, several: bool) -> str:
    """What an episode is called in another store: its path from what was named on.

    Args:
        path: The episode.
        named: The folder, pack, prefix, manifest or file that it was found by.
        several: More than one was named: the folder's own name goes before.
    """
    if is_elsewhere(path):
        name = _inside(path).name
        if is_url(path) and not _inside(path).shard:
            name = bucket_key(path).removeprefix(bucket_key(named)).strip("/") or path.name
    elif named in path.parents:
        name = path.relative_to(named).as_posix()
    elif manifest.is_manifest(named):
        name = os.path.relpath(path, manifest.split_name(named)[0].parent)
        while name.startswith("../"):
            name = name[3:]
    else:
        return path.name
    return f"{named.resolve().name}/{name}" if several and named.suffix != manifest.SUFFIX else name


def bucket_key(url: File) -> str:
    """The key of an object within its bucket."""
    return split_url(url)[1].partition("/")[2].strip("/")


def listed(path: Path) -> list[Entry]:
    """The episodes of a pack or an object store's prefix, their names from it on, by name.

    Raises:
        StorageError: if it cannot be listed.
    """
    if not is_url(path):
        return _members(pack_at(str(path)))
    scheme, rest = split_url(path)
    bucket = _bucket(f"{scheme}://{rest}".rstrip("/"))
    found = bucket.everything()
    if any(is_shard(entry.name) for entry in found):
        return _members(Pack(bucket))
    return [entry for entry in found if entry.name.endswith(EPISODE)]


def place_at(address: str) -> Place:
    """The folder or bucket at an address."""
    return _bucket(address) if is_url(address) else Folder(address)


def pack_at(address: str) -> Pack:
    """The pack at an address; what a store says of its shards is believed while we run."""
    return _pack(address) if is_url(address) else Pack(Folder(address))


@lru_cache(maxsize=16)
def _bucket(address: str) -> Bucket:
    return Bucket(address)


@lru_cache(maxsize=16)
def _pack(address: str) -> Pack:
    return Pack(_bucket(address))


def _inside(path: File) -> _Inside:
    """Take an address apart."""
    text = os.fspath(path)
    root, key = "", text
    if is_url(text):
        scheme, rest = split_url(text)
        bucket, _, key = rest.partition("/")
        root = f"{scheme}://{bucket}"
    parts = key.split("/")
    for at, part in enumerate(parts):
        if is_shard(part):
            folder = "/".join(parts[:at])
            place = f"{root}/{folder}".rstrip("/") if root else folder or "."
            return _Inside(place, part, "/".join(parts[at + 1 :]))
    return _Inside(root, "", key)


def _members(pack: Pack) -> list[Entry]:
    return sorted(
        Entry(f"{shard}/{member.name}", member.size, member.mtime * SECOND)
        for shard, member in members_of(pack)
    )


def _of_pack(pack: Pack, folder: Path, *, only: str = "") -> Expanded:
    paths = []
    left_out = []
    for shard in pack.shards():
        if only and shard.name != only:
            continue
        index = pack.index(shard.name)
        at = folder / shard.name
        paths += [at / member.name for member in index.members]
        if index.lost:
            left_out.append((at, f"cut off: its last {index.lost} bytes are no complete episode"))
    return Expanded(tuple(paths), tuple(left_out))


def _of_bucket(path: Path) -> Expanded:
    """Everything below a prefix; the object itself if the address ends like an episode."""
    if path.name.endswith(EPISODE):
        return Expanded((path,), ())
    scheme, rest = split_url(path)
    bucket = _bucket(f"{scheme}://{rest}".rstrip("/"))
    found = bucket.everything()
    if any(is_shard(entry.name) for entry in found):
        return _of_pack(Pack(bucket), path)
    if not found:
        raise StorageError(f"{bucket.address}: nothing there")
    names = [entry.name for entry in found if entry.name.endswith(EPISODE)]
    return Expanded(tuple(path / name for name in names), ())
