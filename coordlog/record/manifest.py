"""Manifests: named lists of episodes by the sha256 of their files, to be used where a folder is.

A manifest is a text file: one line of JSON about the list, a line `---`, then a line per episode,
tab-separated, sorted by digest: digest, part (such as train), label, size, mtime [ns], path. Paths
say where the file was seen last, from the manifest's folder on; they may be wrong and are not part
of the hash. The hash is over digests, parts and labels alone: it names what was selected, whatever
order it was found in and wherever it lies.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

from coordlog.errors import FormatError, SpecError, StorageError, unknown
from coordlog.record.declared import MANIFEST, require
from coordlog.record.places import Folder, is_url
from coordlog.record.storage import translated
from coordlog.strangers import recognise

SUFFIX = ".manifest"
EDITION = 1

_RULE = "---"
_DIGITS = 20  # of a size or a time


class Chosen(NamedTuple):
    """One episode of a manifest."""

    digest: str
    """sha256 of the file"""
    part: str
    """of a split, such as train; "" without one"""
    label: str
    size: int
    """bytes"""
    mtime: int
    """ns since the epoch"""
    path: str
    """from the manifest's folder on, or absolute, or an address of a store"""


@dataclass(frozen=True)
class Manifest:
    """A list of episodes, by digest.

    Example:
        >>> manifest = read("clean.manifest")  # doctest: +SKIP
        >>> manifest.hash, len(manifest.chosen)  # doctest: +SKIP
    """

    name: str
    chosen: tuple[Chosen, ...]
    version: int = 1
    parent: str = ""
    """hash of the version before; "" for the first"""
    about: dict[str, Any] = field(default_factory=dict)
    """How it was selected: sources, where, split, …"""

    @property
    def hash(self) -> str:
        """sha256 of what was selected: digests, parts and labels, in no order."""
        rows = sorted((each.digest, each.part, each.label) for each in self.chosen)
        text = "".join(f"{digest}\t{part}\t{label}\n" for digest, part, label in rows)
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def parts(self) -> dict[str, int]:
        """How many episodes each part has."""
        counts: dict[str, int] = defaultdict(int)
        for each in self.chosen:
            counts[each.part] += 1
        return dict(sorted(counts.items()))

    def only(self, part: str) -> Manifest:
        """The episodes of one part.

        Raises:
            ConfigError: if there is no such part.
        """
        if part not in self.parts:
            raise unknown(
                f"part of {self.name}{SUFFIX}", part, [each or "''" for each in self.parts]
            )
        return replace(self, chosen=tuple(each for each in self.chosen if each.part == part))


class Resolved(NamedTuple):
    """Where the episodes of a manifest are now."""

    paths: tuple[Path, ...]
    gone: tuple[Chosen, ...]


def split_name(path: str | os.PathLike[str]) -> tuple[Path, str]:
    """File and part out of NAME.manifest:PART."""
    text = os.fspath(path)
    head, found, part = text.rpartition(SUFFIX + ":")
    return (Path(head + SUFFIX), part) if found else (Path(text), "")


def is_manifest(path: str | os.PathLike[str]) -> bool:
    """Whether a path is one of a manifest, by its name."""
    return split_name(path)[0].suffix == SUFFIX


def encode(manifest: Manifest) -> bytes:
    """A manifest file."""
    head = {
        "coordlog_manifest": EDITION,
        "name": manifest.name,
        "version": manifest.version,
        "hash": manifest.hash,
        "parent": manifest.parent,
        "episodes": len(manifest.chosen),
        "about": manifest.about,
    }
    lines = [json.dumps(head, ensure_ascii=False), _RULE]
    for each in sorted(manifest.chosen):
        line = "\t".join(map(str, each))
        if line.count("\t") != len(each) - 1 or "\n" in line:
            raise SpecError(f"{each.path!r}: a manifest holds no names with tabs or line ends")
        lines.append(line)
    return ("\n".join(lines) + "\n").encode()


def decode(data: bytes) -> Manifest:
    """The inverse of `encode`.

    Raises:
        FormatError: if it is no manifest, of another edition, or not what its hash says.
    """
    try:
        first, rule, *lines = data.decode().removesuffix("\n").split("\n")
        head = json.loads(first)
        edition = head["coordlog_manifest"]
    except (ValueError, KeyError, TypeError, RecursionError):
        what = recognise(data, texts=False)
        raise FormatError(
            f"not a manifest{what and ', got '}{what}; `coordlog select` writes them"
        ) from None
    if edition != EDITION:
        raise FormatError(f"manifest of edition {edition}; this release reads edition {EDITION}")
    try:
        require(head, MANIFEST, "head of the manifest")
        if rule != _RULE or not data.endswith(b"\n"):
            raise ValueError
        manifest = Manifest(
            name=head["name"],
            chosen=tuple(_chosen(line) for line in lines),
            version=head["version"],
            parent=head["parent"],
            about=head["about"],
        )
    except (ValueError, KeyError, TypeError):
        raise FormatError("the manifest is damaged or was cut off") from None
    if manifest.hash != head["hash"] or len(lines) != head["episodes"]:
        raise FormatError(
            f"expected {head['episodes']} episodes with the hash {str(head['hash'])[:12]}, got"
            f" {len(lines)} with {manifest.hash[:12]}: the manifest was changed by hand or cut off"
        )
    return manifest


def _chosen(line: str) -> Chosen:
    digest, part, label, size, mtime, path = line.split("\t")
    if len(size) > _DIGITS or len(mtime) > _DIGITS or int(size) < 0 or "\0" in line:
        raise ValueError
    return Chosen(digest, part, label, int(size), int(mtime), path)


def read(path: str | os.PathLike[str]) -> Manifest:
    """A manifest, or one part of it by NAME.manifest:PART.

    Raises:
        StorageError: if it cannot be read.
        FormatError: if it is no manifest.
        ConfigError: if there is no such part.
    """
    file, part = split_name(path)
    if file.exists() and not file.is_file():
        raise FormatError(f"{file}: expected a manifest, got a folder, pipe or device")
    with translated(file, "read the manifest"):
        data = file.read_bytes()
    try:
        manifest = decode(data)
    except FormatError as error:
        raise FormatError(f"{file}: {error}") from None
    return manifest.only(part) if part else manifest


def write(path: Path, manifest: Manifest, *, force: bool = False) -> Manifest:
    """Write a manifest; one that is replaced is kept as NAME@HASH.manifest, as its parent.

    Returns:
        The manifest as written: its version follows that of the one it replaced.

    Raises:
        StorageError: if the file is there and `force` is not given, or the file system refuses.
        FormatError: if what is there is no manifest.
    """
    if os.path.lexists(path):
        if not force:
            raise StorageError(
                f"{path}: the file exists and is not overwritten; choose another name, or --force"
                " writes the next version and keeps this one"
            )
        before = read(path)
        if before.hash == manifest.hash:
            return before
        kept = path.with_name(f"{path.name.removesuffix(SUFFIX)}@{before.hash[:12]}{SUFFIX}")
        manifest = replace(manifest, version=before.version + 1, parent=before.hash)
        with translated(path, "keep the version before"):
            os.replace(path, kept)
    Folder(path.parent).create(path.name, encode(manifest))
    return manifest


def resolve(
    path: str | os.PathLike[str],
    *,
    stat: Callable[[Path], tuple[int, int] | None],
    digest: Callable[[Path], str],
    search: Callable[[Sequence[Path]], Iterable[Path]],
) -> Resolved:
    """Where the episodes of a manifest are.

    A file that has the size and the time that the manifest knows is believed; any other must have
    the digest. What is not where it was is searched for in the folders that were selected from.

    Args:
        path: NAME.manifest or NAME.manifest:PART.
        stat: Size and mtime [ns] of a file; None if it is not there.
        digest: sha256 of a file.
        search: The files in some folders or stores.
    """
    manifest, folder = read(path), split_name(path)[0].parent
    found: dict[str, Path] = {}
    missing: list[Chosen] = []
    for each in manifest.chosen:
        place = _from(folder, each.path)
        status = stat(place)
        if status == (each.size, each.mtime) or (
            status is not None and status[0] == each.size and digest(place) == each.digest
        ):
            found[each.digest] = place
        else:
            missing.append(each)
    if missing:
        sources = [_from(folder, source) for source in manifest.about.get("sources", [])]
        found |= dict(_moved(missing, search(sources), stat=stat, digest=digest))
    paths = tuple(found[each.digest] for each in manifest.chosen if each.digest in found)
    return Resolved(paths, tuple(each for each in missing if each.digest not in found))


def _from(folder: Path, path: str) -> Path:
    return Path(path) if is_url(path) else folder / path


def _moved(
    missing: Sequence[Chosen],
    candidates: Iterable[Path],
    *,
    stat: Callable[[Path], tuple[int, int] | None],
    digest: Callable[[Path], str],
) -> Iterator[tuple[str, Path]]:
    """Files elsewhere that have the digests; only those of a missing one's size are hashed."""
    wanted = {each.digest for each in missing}
    sizes = {each.size for each in missing}
    for path in candidates:
        status = stat(path)
        if status is None or status[0] not in sizes:
            continue
        got = digest(path)
        if got in wanted:
            wanted.discard(got)
            yield got, path
        if not wanted:
            return
