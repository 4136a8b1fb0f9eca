"""Episode files into packs, and out of them again, byte for byte."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from coordlog.errors import StorageError
from coordlog.record.addresses import contents_of, sha256, size_and_time
from coordlog.record.beside import Beside, copy_beside
from coordlog.record.pack_writer import SHARD_BYTES, PackWriter, fits
from coordlog.record.places import Folder

SECOND = 10**9  # ns


class Packed(NamedTuple):
    """What was written."""

    files: int
    size: int
    """bytes"""
    there: int
    """Files that were there already, with the same bytes."""
    left_out: tuple[str, ...] = ()
    """Files that could not be read or not be packed, and why."""


def pack_files(
    files: Sequence[tuple[Path, str]],
    out: Path,
    *,
    shard_bytes: int = SHARD_BYTES,
    tell: Callable[[], None] = lambda: None,
    stop: Callable[[], bool] = lambda: False,
) -> Packed:
    """Append episode files to a pack, under their names; those that cannot be are left out.

    Args:
        files: Addresses, and names within the pack.
        out: Folder of the pack.
        shard_bytes: Size at which a shard is closed.
        tell: Called after each file.
        stop: Asked before each file; True leaves a sound pack of those before it.

    Raises:
        StorageError: if two files have one name, none has a name that a pack can hold, the pack has
            other bytes under a name, or the file system refuses.
    """
    _require_names(files)
    fitting = [(path, name) for path, name in files if fits(name)]
    refused = [path for path, name in files if not fits(name)]
    left_out = [f"{path}: a pack holds names of one line only; rename it" for path in refused]
    if files and not fitting:
        raise StorageError(f"nothing to pack; {left_out[0]}")
    count, size, there = 0, 0, 0
    with PackWriter(out, shard_bytes=shard_bytes) as writer:
        for path, name in fitting:
            if stop():
                break
            try:
                data = contents_of(path)
            except StorageError as error:
                left_out.append(str(error))
                continue
            known = writer.digest(name)
            if known is not None and known == hashlib.sha256(data).hexdigest():
                there += 1
            else:
                writer.append(name, data, mtime=(size_and_time(path) or (0, 0))[1] // SECOND)
                count, size = count + 1, size + len(data)
            tell()
    _copy_looks(fitting, out)
    return Packed(count, size, there, tuple(left_out))


def unpack_files(
    files: Sequence[tuple[Path, str]],
    out: Path,
    *,
    tell: Callable[[], None] = lambda: None,
    stop: Callable[[], bool] = lambda: False,
) -> Packed:
    """Write episodes as files of a folder, under their names and with their times.

    Args:
        files: Addresses, and names within the folder.
        out: The folder; made if missing.
        tell: Called after each file.
        stop: Asked before each file.

    Raises:
        StorageError: if two files have one name, one leads out of the folder, the folder has other
            bytes under a name, or the file system refuses.
    """
    _require_names(files)
    folder = Folder(out)
    count, size, there = 0, 0, 0
    for path, name in files:
        if stop():
            break
        data, target = contents_of(path), out / name
        if target.exists() and sha256(target) == hashlib.sha256(data).hexdigest():
            there += 1
        else:
            folder.create(name, data)
            time = (size_and_time(path) or (0, 0))[1]
            os.utime(target, ns=(time, time))
            count, size = count + 1, size + len(data)
        tell()
    _copy_looks(files, out)
    return Packed(count, size, there)


def _copy_looks(files: Sequence[tuple[Path, str]], out: Path) -> None:
    """Copy what robots wear in pictures, once for each folder or shard."""
    for log in {path.parent: path for path, _ in files}.values():
        copy_beside(log, out, Beside(log).names())


def _require_names(files: Sequence[tuple[Path, str]]) -> None:
    seen: dict[str, Path] = {}
    for path, name in files:
        if name.startswith("/") or ".." in name.split("/"):
            raise StorageError(f"{path}: its name, {name}, leads out of the folder; it is refused")
        if name in seen and seen[name] != path:
            raise StorageError(f"{path} and {seen[name]} would both become {name}; do them apart")
        seen[name] = path
