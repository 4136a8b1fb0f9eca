"""The sha256 of files, remembered by path, size, mtime and inode: of a file that has not changed no
byte is read again.
"""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path

from coordlog.episode import Json
from coordlog.record.addresses import is_elsewhere, size_and_time
from coordlog.record.storage import translated
from coordlog.version import __version__

EDITION = f"{__version__}-4"
"""Shards of another edition are not read."""
DIGESTS = "digests.json"
FRESH = 100_000_000
"""A file changed less than this long ago [ns] may change again within one tick of the clock: its
digest is not remembered."""
Stamp = tuple[int, ...]


def stamp_of(path: Path) -> Stamp | None:
    """What a file's content is taken to depend on; None if it cannot be told."""
    if is_elsewhere(path):
        return size_and_time(path)
    try:
        status = path.stat()
    except OSError:
        return None
    return (status.st_size, status.st_mtime_ns, status.st_ino, status.st_dev)


def remembered(folder: Path, stamps: dict[Path, Stamp | None]) -> dict[Path, str]:
    """Digests of the files that have not changed since they were read."""
    entries = read_json(folder / DIGESTS).get("files", {})
    found = {}
    for path, stamp in stamps.items():
        entry = entries.get(str(path)) if isinstance(entries, dict) else None
        if isinstance(entry, list) and stamp is not None and entry[:-1] == list(stamp):
            found[path] = str(entry[-1])
    return found


def remember(folder: Path, stamps: dict[Path, Stamp | None], digests: dict[Path, str]) -> None:
    """Keep what is known of files beside what was known before.

    Of a file that changed since its stamp was taken, or just before, nothing is kept.
    """
    before = read_json(folder / DIGESTS).get("files", {})
    entries = dict(before) if isinstance(before, dict) else {}
    now = _clock(folder)
    for path, digest in digests.items():
        stamp = stamps.get(path)
        entries.pop(str(path), None)
        if stamp is not None and stamp == stamp_of(path) and stamp[1] < now - FRESH:
            entries[str(path)] = [*stamp, digest]
    if entries != before:
        write_json(folder / DIGESTS, {"edition": EDITION, "files": entries})


def _clock(folder: Path) -> int:
    """What time a file written now would bear [ns]."""
    with tempfile.TemporaryFile(dir=folder) as stream:
        return os.fstat(stream.fileno()).st_mtime_ns


def write_json(path: Path, content: Json) -> None:
    """Write a record of the cache, at once or not at all."""
    replace_file(path, memoryview(json.dumps(content).encode()))


def replace_file(path: Path, content: memoryview) -> None:
    """Give a file new content, at once or not at all."""
    with translated(path, "write the cache"):
        handle, name = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(content)
            os.replace(name, path)
        except BaseException:
            os.unlink(name)
            raise


def read_json(path: Path) -> Json:
    """A record of the cache; empty if it is missing, damaged or of another edition."""
    try:
        content = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        return {}
    sound = isinstance(content, dict) and content.get("edition") == EDITION
    return content if sound else {}
