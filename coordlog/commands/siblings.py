"""The raw episode of a smoothed one, and the other way round, by lineage."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from coordlog.errors import FormatError

if TYPE_CHECKING:
    from coordlog.episode import Header

MOST = 20_000
"""Files that are looked at before giving up."""


def sibling(path: Path) -> tuple[Path, Path] | None:
    """The raw and the smoothed file of the pair that an episode belongs to, if the other is in the
    same tree.

    The tree is the folder above the file's own. Only the ends of files are read; a digest is
    computed where the header fits.
    """
    from coordlog.record.cache import file_digest

    own = _header(path)
    if own is None:
        return None
    parents = own.lineage["parents"]
    digest = None if parents else file_digest(path)
    for count, candidate in enumerate(sorted(path.resolve().parent.parent.rglob("*.mcap"))):
        if count == MOST:
            return None
        other = _header(candidate)
        if other is None or _drawn(other) != _drawn(own) or candidate == path.resolve():
            continue
        if parents and file_digest(candidate) in parents:
            return candidate, path
        if digest in other.lineage["parents"]:
            return path, candidate
    return None


def _header(path: Path) -> Header | None:
    from coordlog.record.reader import read_header

    try:
        return read_header(path)
    except FormatError:
        return None


def _drawn(header: Header) -> tuple[object, ...]:
    """What a smoothed episode has in common with its raw one."""
    return tuple(header.episode[key] for key in ("scene", "split", "seed", "index"))
