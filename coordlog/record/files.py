"""Which episode files there are: the one walk over folders that every command takes.

Links are followed, and each real file comes once, by whatever names it is reached. What cannot be
looked at, and what is no file (a pipe, a device), is named and never passed over in silence.
"""

from __future__ import annotations

import errno
import os
import stat
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

from coordlog.errors import CoordlogError, FormatError, SpecError, StorageError
from coordlog.record.addresses import expand
from coordlog.record.storage import NO_TEXT, PART, is_text
from coordlog.strangers import SUFFIXES, recognise

if TYPE_CHECKING:
    from coordlog.episode import Header

SUFFIX = ".mcap"
CATALOG = ".catalog"
"""The folder beside logs in which their catalogue is kept; no episodes are looked for there."""

File = str | os.PathLike[str]

PATH_OF_BAG = "_trajectory.mcap"
"""How the file ends that holds the path of a smoothed episode, beside the episode in its bag."""
_APPLE = "._"  # how macOS names its own file beside one
_EFFECTIVE = os.access in os.supports_effective_ids
_SHOWN = 3  # reasons that an error repeats


class Skipped(NamedTuple):
    """A file or a folder that was left out, and why."""

    path: Path
    reason: str


class Files(NamedTuple):
    """Episode files and part files, each sorted by name, and what was left out."""

    paths: tuple[Path, ...]
    parts: tuple[Path, ...]
    skipped: tuple[Skipped, ...] = ()
    others: tuple[tuple[str, int], ...] = ()
    """Kinds of logs of other programs that lie there, and how many of each."""
    stamps: Mapping[str, tuple[int, int]] = MappingProxyType({})
    """Size and mtime [ns] of the files of this machine, as the walk met them, by path."""

    def left_out(self) -> list[str]:
        """A sentence for each file that was left out, and for each that is unfinished."""
        return [f"{item.path}: {item.reason}" for item in self.skipped] + [
            f"{part}: unfinished; `coordlog recover` makes an episode of it" for part in self.parts
        ]


def find_files(path_or_paths: File | Iterable[File]) -> Files:
    """The episode files that are named, or lie in the folders that are named, at any depth.

    Of several paths one that cannot be read is left out and named, as those in folders are.

    Raises:
        StorageError: if a path that is named does not exist, or the only one may not be read.
        FormatError: if the only one is neither a file nor a folder.
    """
    given = [path_or_paths] if isinstance(path_or_paths, str | os.PathLike) else list(path_or_paths)
    walk = _Walk()
    paths: list[Path] = []
    for path in map(Path, given):
        try:
            if "\0" in str(path):
                raise StorageError(f"{path}: no such file or folder: a zero byte in its name")
            inside = expand(path, search=lambda sources: find_files(sources).paths)
            if inside is not None:
                paths += inside.paths
                walk.skipped += [Skipped(*item) for item in inside.left_out]
                continue
            status = _status(path)
            if stat.S_ISDIR(status.st_mode):
                walk.folder(path)
            else:
                walk.named(path, status)
        except (FormatError, StorageError) as error:
            if len(given) == 1 or "no such file" in str(error):
                raise
            walk.skip(path, reason_of(path, error))
        paths += walk.taken()
    others = tuple(sorted(walk.others.items()))
    return Files(tuple(paths), tuple(walk.parts), tuple(walk.skipped), others, walk.stamps)


def recovered_before(part: Path) -> Path | None:
    """The finished episode beside a part file that was made of it; None if there is none.

    Both headers bear one id, which is that of a single recording.
    """
    from coordlog.record.reader import read_header, read_summary

    target = part.with_suffix("")
    try:
        made = target.is_file() and _identity(read_summary(target).header) == _identity(
            read_header(part)
        )
    except CoordlogError:
        return None
    return target if made else None


def _identity(header: Header) -> tuple[object, ...]:
    return tuple(header.episode.get(key) for key in ("id", "run", "scene", "seed", "index"))


def nothing_found(
    given: Iterable[File], files: Files, *, wanted: str = "", skipped: Iterable[Skipped] = ()
) -> CoordlogError:
    """The error that says there is no episode where one was expected, and what there is instead.

    Args:
        given: The paths that were searched.
        files: What was found there.
        wanted: What for; starts the sentence.
        skipped: Files that were found and turned out to be no episodes.
    """
    where = ", ".join(os.fspath(path) for path in given)
    text = f"{wanted}no episodes ({SUFFIX}) under {where}"
    if files.parts:
        text += (
            f"; {len(files.parts)} unfinished ones are there: `coordlog recover` makes episodes"
            " of them"
        )
    for kind, count in files.others:
        text += f"; {count} {kind} are there: `coordlog import` takes those"
    left = [*files.skipped, *skipped]
    for item in left[:_SHOWN]:
        text += f"; {item.path}: {item.reason}"
    if len(left) > _SHOWN:
        text += f"; and {len(left) - _SHOWN} more that are no episodes"
    return SpecError(text)


def reason_of(path: Path, error: CoordlogError) -> str:
    """What an error says of a file, without the file's name in front."""
    return str(error).removeprefix(f"{path}: ")


def refused(skipped: Sequence[Skipped], advice: str) -> FormatError:
    """The error for files that could not be used where that was not allowed."""
    first, more = skipped[0], len(skipped) - 1
    text = f"{first.path}: {first.reason}"
    return FormatError(f"{text}{f'; and {more} more' if more else ''}; {advice}")


def _status(path: Path) -> os.stat_result:
    try:
        return path.stat()
    except FileNotFoundError:
        if path.is_symlink():
            raise StorageError(f"{path}: cannot read: a link to nothing") from None
        hint = "; addresses of stores begin with s3://, gs:// or az://" if ":" in str(path) else ""
        said = f"{path}: no such file or folder: No such file or directory{hint}"
        raise StorageError(said) from None
    except OSError as error:
        raise StorageError(f"{path}: cannot read: {error.strerror}") from None


def _kind(mode: int) -> str:
    kinds = (
        (stat.S_ISFIFO, "a pipe (FIFO)"),
        (stat.S_ISSOCK, "a socket"),
        (stat.S_ISBLK, "a block device"),
        (stat.S_ISCHR, "a device"),
        (stat.S_ISDIR, "a folder"),
    )
    return next((name for test, name in kinds if test(mode)), "something else")


@dataclass
class _Walk:
    """A walk over folders: what was seen, found and left out."""

    parts: list[Path] = field(default_factory=list)
    skipped: list[Skipped] = field(default_factory=list)
    others: Counter[str] = field(default_factory=Counter)
    stamps: dict[str, tuple[int, int]] = field(default_factory=dict)
    _paths: list[Path] = field(default_factory=list)
    _seen: set[tuple[int, int]] = field(default_factory=set)

    def is_new(self, status: os.stat_result) -> bool:
        """Whether this file or folder was not met before, by whatever name."""
        key = (status.st_dev, status.st_ino)
        known = key in self._seen
        self._seen.add(key)
        return not known

    def taken(self) -> list[Path]:
        """The files found since the last call, by name."""
        found, self._paths = sorted(self._paths), []
        self.parts.sort()
        self.skipped.sort()
        return found

    def named(self, path: Path, status: os.stat_result) -> None:
        """Take a file that was named itself, whatever it is called.

        Raises:
            FormatError: if it is no file.
            StorageError: if its name is no text.
        """
        if not stat.S_ISREG(status.st_mode):
            raise FormatError(f"{path}: expected a file or a folder, got {_kind(status.st_mode)}")
        if not is_text(path):
            raise StorageError(f"{path}: {NO_TEXT}")
        if self.is_new(status):
            self._take(path, status)

    def folder(self, top: Path) -> None:
        """Walk one tree.

        What is there in its own right comes before what is only linked to, so that a file goes by
        its own name.

        Raises:
            StorageError: if the folder itself may not be read.
        """
        waiting: list[Path] = [top]
        links: list[Path] = []
        while waiting or links:
            path = waiting.pop() if waiting else links.pop(0)
            try:
                status = path.stat()
                if not self.is_new(status):
                    continue
                if stat.S_ISDIR(status.st_mode):
                    own, linked = _entries(path)
                    waiting += own
                    links += linked
                elif _of_interest(path.name):
                    self._file(path, status)
            except FileNotFoundError:
                if _of_interest(path.name) or not path.suffix:  # it may have led to a folder
                    self.skip(path, "cannot read: a link to nothing")
            except OSError as error:
                if path == top:
                    raise StorageError(f"{path}: cannot read: {error.strerror}") from None
                if error.errno != errno.ELOOP or _of_interest(path.name):
                    self.skip(path, f"cannot read: {error.strerror}")

    def _file(self, path: Path, status: os.stat_result) -> None:
        kind = SUFFIXES.get(path.suffix.lower())
        if kind:
            self.others[kind] += 1
        elif not stat.S_ISREG(status.st_mode):
            self.skip(path, f"expected a file, got {_kind(status.st_mode)}")
        elif not os.access(path, os.R_OK, effective_ids=_EFFECTIVE):
            self.skip(path, "cannot read: Permission denied")
        elif path.name.startswith(_APPLE) and recognise(_head(path)).startswith("an AppleDouble"):
            self.skip(path, recognise(_head(path)))
        elif _is_path_of_bag(path):
            pass  # a part of its bag, as metadata.yaml is
        elif not path.name.endswith(PART):
            self._take(path, status)
        elif recovered_before(path) is None:
            self.parts.append(path)

    def _take(self, path: Path, status: os.stat_result) -> None:
        if not is_text(path):
            self.skip(path, NO_TEXT)
            return
        self._paths.append(path)
        self.stamps[os.fspath(path)] = (status.st_size, status.st_mtime_ns)

    def skip(self, path: Path, reason: str) -> None:
        """Leave something out, and remember why."""
        self.skipped.append(Skipped(path, reason))


def _entries(folder: Path) -> tuple[list[Path], list[Path]]:
    """What is worth a look in a folder: files and folders of its own, and links."""
    own: list[Path] = []
    linked: list[Path] = []
    with os.scandir(folder) as entries:
        for entry in sorted(entries, key=lambda entry: entry.name):
            if entry.name == CATALOG:
                continue
            if entry.is_symlink():
                linked.append(folder / entry.name)
            elif _of_interest(entry.name) or entry.is_dir(follow_symlinks=False):
                own.append(folder / entry.name)
    return own[::-1], linked


def _is_path_of_bag(path: Path) -> bool:
    """Whether a file is what `coordlog export --to rosbag2` puts beside a smoothed episode."""
    bag = path.parent
    others = (bag / f"{bag.name}{SUFFIX}", bag / "metadata.yaml")
    return path.name == bag.name + PATH_OF_BAG and all(other.is_file() for other in others)


def _of_interest(name: str) -> bool:
    return name.endswith((SUFFIX, SUFFIX + PART)) or os.path.splitext(name)[1].lower() in SUFFIXES


def _head(path: Path) -> bytes:
    with path.open("rb") as stream:
        return stream.read(16)
