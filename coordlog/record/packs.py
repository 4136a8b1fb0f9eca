"""Packs: many episode files, unchanged, in a few large ones.

A pack is a folder (or a prefix of an object store) of shards, `shard-000000.tar`, …: uncompressed
tar archives that every tar program opens. Beside a finished shard lies its index,
`shard-000000.index`, a line per member: where it begins, its size, its sha256, its name. One range
read gets one episode.

A shard without an index is being written, or its writer was stopped: its members are found by their
tar headers, and at most the last one is incomplete. It is left as it is; whoever goes on writes the
next shard.
"""

from __future__ import annotations

import hashlib
import io
import os
import re
import tarfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

from coordlog.errors import FormatError, StorageError
from coordlog.record.places import Entry, Folder, Place

SHARD, INDEX = ".tar", ".index"

_NAME = re.compile(r"^shard-\d{6,}\.tar$")
_LINE = re.compile(r"(\d{1,15}) (\d{1,15}) ([0-9a-f]{64}) (-?\d{1,12}) (.+)", re.ASCII)
BLOCK = tarfile.BLOCKSIZE


class Member(NamedTuple):
    """One episode file within a shard."""

    start: int
    size: int
    digest: str
    """sha256; "" in a shard that has no index yet"""
    mtime: int
    """s since the epoch"""
    name: str


@dataclass(frozen=True)
class Index:
    """The members of one shard."""

    members: tuple[Member, ...]
    lost: int
    """Bytes at the end that are no complete member."""

    @cached_property
    def by_name(self) -> dict[str, Member]:
        """The members by their names."""
        return {member.name: member for member in self.members}


class Pack:
    """The shards of a pack, for reading.

    Example:
        >>> pack = Pack(Folder("PACK"))  # doctest: +SKIP
        >>> data = pack.read("shard-000000.tar", "a.mcap")  # doctest: +SKIP
    """

    def __init__(self, place: Place) -> None:
        self.place = place

    def shards(self) -> list[Entry]:
        """The shards, in order."""
        return [entry for entry in self.place.entries() if is_shard(entry.name)]

    def index(self, shard: str) -> Index:
        """The members of one shard, in the order in which they were written.

        Raises:
            StorageError: if there is no such shard.
            FormatError: if the index is damaged; deleting it makes the shard be searched instead.
        """
        entry = self._entry(shard)
        if entry is None:
            raise StorageError(f"{self.place.address}/{shard}: no such shard")
        return _index(_Ref(self.place), entry, self._entry(shard.removesuffix(SHARD) + INDEX))

    def member(self, shard: str, name: str) -> Member:
        """One episode file.

        Raises:
            StorageError: if there is no such member.
        """
        member = self.index(shard).by_name.get(name)
        if member is None:
            raise StorageError(f"{self.place.address}/{shard}/{name}: the shard has no such member")
        return member

    def read(self, shard: str, name: str) -> bytes:
        """The bytes of one episode file, in one range read.

        Raises:
            StorageError: if there is no such member, or it cannot be read.
        """
        member = self.member(shard, name)
        return self.place.read(shard, member.start, member.size)

    def _entry(self, name: str) -> Entry | None:
        if isinstance(self.place, Folder):
            return self.place.entry(name)
        return self._listing.get(name)

    @cached_property
    def _listing(self) -> dict[str, Entry]:
        """What a store has, asked once: a request for each read would double their number."""
        return {entry.name: entry for entry in self.place.entries()}


class _Ref:
    """A place as a key of the cache: equal where the address is."""

    def __init__(self, place: Place) -> None:
        self.place = place

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Ref) and other.place.address == self.place.address

    def __hash__(self) -> int:
        return hash(self.place.address)


@lru_cache(maxsize=64)
def _index(ref: _Ref, shard: Entry, beside: Entry | None) -> Index:
    """Sizes and times are part of the key: a shard that has grown is looked at again."""
    if beside is None:
        return scan(ref.place, shard)
    where = f"{ref.place.address}/{beside.name}"
    found = decode_index(ref.place.read(beside.name), where)
    if any(member.start + member.size > shard.size for member in found.members):
        raise FormatError(
            f"{where}: members that lie beyond the shard's end: it was cut off, or the index is of "
            "another; delete the index, and the shard is searched"
        )
    return found


def scan(place: Place, shard: Entry) -> Index:
    """The complete members of a shard, found by their tar headers alone.

    Raises:
        FormatError: if it is no tar archive.
    """
    members: list[Member] = []
    end = 0
    stream = io.BufferedReader(_Reader(place, shard), buffer_size=1 << 16)
    try:
        with tarfile.open(fileobj=stream, mode="r:") as archive:
            for info in archive:
                end = info.offset_data + -(-info.size // BLOCK) * BLOCK
                if end > shard.size:
                    return Index(tuple(members), shard.size - info.offset)
                members.append(Member(info.offset_data, info.size, "", int(info.mtime), info.name))
    except tarfile.ReadError:  # cut off within a header, or no archive at all
        _require_tar(place, shard)
    rest = place.read(shard.name, end, shard.size - end) if shard.size > end else b""
    return Index(tuple(members), len(rest) if any(rest) else 0)


def _require_tar(place: Place, shard: Entry) -> None:
    if shard.size < BLOCK:
        return
    try:
        first = place.read(shard.name, 0, BLOCK)
        tarfile.TarInfo.frombuf(first, "utf-8", "surrogateescape")
    except tarfile.HeaderError as error:
        raise FormatError(
            f"{place.address}/{shard.name}: expected a tar archive, got: {error}"
        ) from None


class _Reader(io.RawIOBase):
    """A shard as a file that tarfile can walk through."""

    def __init__(self, place: Place, shard: Entry) -> None:
        super().__init__()
        self._place, self._shard, self._at = place, shard, 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        origin = {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._shard.size}[whence]
        self._at = max(origin + offset, 0)
        return self._at

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]
        size = min(len(buffer), max(self._shard.size - self._at, 0))
        if size:
            buffer[:size] = self._place.read(self._shard.name, self._at, size)
            self._at += size
        return size


def is_shard(name: str) -> bool:
    """Whether a file of this name is a shard of a pack."""
    return _NAME.match(name) is not None


def encode_index(members: list[Member]) -> bytes:
    """An index file: a line per member, names last, since they may hold anything but a line's end.

    The last line holds the sha256 of those before it.
    """
    lines = [
        f"{each.start} {each.size} {each.digest} {each.mtime} {each.name}\n" for each in members
    ]
    body = "".join(lines).encode(errors="surrogateescape")
    return body + f"sha256 {hashlib.sha256(body).hexdigest()}\n".encode()


def decode_index(data: bytes, where: str) -> Index:
    """The inverse of `encode_index`.

    Raises:
        FormatError: if it is damaged.
    """
    body, found, seal = data.rpartition(b"sha256 ")
    if not found or seal.decode("ascii", "replace") != hashlib.sha256(body).hexdigest() + "\n":
        raise FormatError(f"{where}: the index is damaged; delete it, and the shard is searched")
    lines = body.decode(errors="surrogateescape").split("\n")
    members = [_LINE.fullmatch(line) for line in lines[:-1]]
    if not all(members) or lines[-1]:
        raise FormatError(
            f"{where}: expected lines of start, size, sha256, time and name; delete it, and the "
            "shard is searched"
        )
    return Index(
        tuple(Member(int(m[1]), int(m[2]), m[3], int(m[4]), m[5]) for m in members if m), 0
    )


def members_of(pack: Pack) -> Iterator[tuple[str, Member]]:
    """Every member of a pack with the name of its shard, in order."""
    for shard in pack.shards():
        for member in pack.index(shard.name).members:
            yield shard.name, member
