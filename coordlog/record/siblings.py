"""The raw episode of a smoothed one, and the other way round, by lineage."""

from __future__ import annotations

import os
from collections import deque
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from coordlog.errors import CoordlogError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from coordlog.episode import Header

MOST = 20_000
"""Files and folders that are looked at before giving up."""
MOST_SIZED = 2_000
"""Files whose header is read before giving up."""


def sibling(path: Path) -> tuple[Path, Path] | None:
    """The raw and the smoothed file of the pair that an episode belongs to, if the other is in the
    same tree.

    The tree is the folder above the file's own. Only the ends of files are read; a digest is
    computed where the header fits.
    """
    from coordlog.record.addresses import sha256

    own = _header(path)
    if own is None:
        return None
    parents = own.lineage["parents"]
    digest = None if parents else sha256(path)
    for candidate in _near(path.resolve()):
        other = _header(candidate)
        if other is None or _drawn(other) != _drawn(own):
            continue
        if parents and sha256(candidate) in parents:
            return candidate, path
        if digest in other.lineage["parents"]:
            return path, candidate
    return None


def _near(own: Path) -> Iterator[Path]:
    """Episode files in the folder above a file's own, its namesakes first.

    A smoothed file has the name of its raw one in a folder laid out alike; beyond those the search
    goes level by level and ends after so many entries: the folder above may be a whole disk.
    """
    waiting, entries = deque([own.parent.parent]), 0
    others: list[Path] = []
    while waiting and entries < MOST:
        try:
            with os.scandir(waiting.popleft()) as listing:
                for entry in islice(listing, MOST - entries):
                    entries += 1
                    path = Path(entry.path)
                    if entry.is_dir(follow_symlinks=False):
                        waiting.append(path)
                    elif not entry.name.endswith(".mcap") or path == own or not entry.is_file():
                        continue
                    elif entry.name == own.name:
                        yield path
                    elif len(others) < MOST_SIZED:
                        others.append(path)
        except OSError:  # of no concern to who looks at another file
            continue
    yield from sorted(others)


def _header(path: Path) -> Header | None:
    from coordlog.record.reader import read_header

    try:
        return read_header(path)
    except CoordlogError:
        return None


def _drawn(header: Header) -> tuple[object, ...]:
    """What a smoothed episode has in common with its raw one."""
    return tuple(header.episode[key] for key in ("scene", "split", "seed", "index"))
