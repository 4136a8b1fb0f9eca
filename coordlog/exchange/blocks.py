"""An export: episodes in fixed blocks, each block written once, all assembled and renamed at the
end.

The set grows in a folder beside its name, `.NAME.part`. A block is done when its journal is there;
an export that was killed goes on with the first block that is not. Which episodes make a block
depends on nothing but their order, so that the same episodes give the same bytes, with however many
processes and interruptions.
"""

from __future__ import annotations

import fcntl
import hashlib
import importlib
import json
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple, Protocol

from coordlog.episode import Json
from coordlog.errors import ConfigError, StorageError, unknown
from coordlog.exchange import FORMATS, WITH_ARRAYS, WITH_IMAGES
from coordlog.exchange.source import Entry, Loaded, fps_of, task_text
from coordlog.parallel import mapped
from coordlog.record.storage import translated
from coordlog.version import __version__

BLOCK = 256
"""Episodes in a block: some seconds of work, and some ten megabytes of state."""
BLOCK_WITH_IMAGES = 16
STORAGES = ("mcap", "sqlite3")
"""Of a ROS 2 bag."""
MARKER = "coordlog_export.json"
"""File in the finished set that says which episodes it was made of."""
_JOURNALS = "journals"


@dataclass(frozen=True)
class Options:
    """What an export is asked for, apart from the episodes.

    Example:
        `Options(to="lerobot", cameras=("overhead",), width=224, height=224)`
    """

    to: str
    """one of `exchange.FORMATS`"""
    cameras: tuple[str, ...] = ()
    """cameras of the model that are rendered from the replayed states"""
    width: int = 224
    height: int = 224
    storage: str = "mcap"
    """of a rosbag2: mcap or sqlite3"""


class Block(NamedTuple):
    """Consecutive episodes that are written together."""

    number: int
    folder: Path
    """where the set grows"""
    paths: tuple[Path, ...]
    first_episode: int
    first_frame: int
    """steps of all blocks before"""
    options: Options
    tasks: tuple[str, ...]
    """what robots were to do, over the whole set; the place of a text is its number"""

    def loaded(self) -> Iterator[Loaded]:
        """Read the episodes one after the other."""
        return map(Loaded, self.paths)


class Format(Protocol):
    """What the module of a format must have."""

    def write_block(self, block: Block) -> Json:
        """Write the files of a block below its folder; returns what `assemble` needs of it."""

    def assemble(self, folder: Path, journals: Sequence[Json], options: Options) -> None:
        """Write what stands once per set, given every block's journal in order."""


class Done(NamedTuple):
    """What an export did."""

    episodes: int
    steps: int
    resumed: int
    """blocks that were there from an interrupted export"""
    blocks: int
    unchanged: bool
    """True if the very set was there already"""


def export(
    chosen: Sequence[Entry],
    out: Path,
    options: Options,
    *,
    jobs: int | str = 1,
    force: bool = False,
    advance: Callable[[int], None] = lambda episodes: None,
) -> Done:
    """Write episodes as a set of another program's.

    Args:
        chosen: Episodes, in the order they get their numbers.
        out: Folder of the set; appears when the set is complete.
        options: Format and cameras.
        jobs: See `parallel.mapped`.
        force: Replace what is at `out`.
        advance: Called with the number of episodes each time a block is there.

    Raises:
        ConfigError: if the format is unknown or the episodes do not fit in one set.
        StorageError: if something else is at `out`, or the file system refuses.
    """
    module = format_of(options.to)
    if options.cameras and options.to not in WITH_IMAGES:
        raise ConfigError(f"--to {options.to} holds no images; these do: {', '.join(WITH_IMAGES)}")
    other = [camera for camera in options.cameras if camera.endswith((":depth", ":segmentation"))]
    if other and options.to not in WITH_ARRAYS:
        raise ConfigError(
            f"--camera {other[0]}: videos hold colours alone; these hold arrays: "
            f"{', '.join(WITH_ARRAYS)}"
        )
    if options.storage not in STORAGES:
        raise unknown("storage", options.storage, STORAGES)
    plan = _plan(chosen, options)
    done = Done(len(chosen), sum(entry.result.length for entry in chosen), 0, 0, True)
    if _is_there(out, plan) and not force:
        return done
    refuse_taken(out, force=force)
    part = out.parent / f".{out.name}.part"
    with growing(part, plan):
        blocks = _blocks(chosen, part, options)
        missing = [block for block in blocks if not _journal(block).exists()]
        advance(sum(len(block.paths) for block in blocks if block not in missing))
        for count in mapped(partial(_write, name=FORMATS[options.to]), missing, jobs=jobs):
            advance(count)
        journals = [json.loads(_journal(block).read_text("utf-8")) for block in blocks]
        module.assemble(part, journals, options)
        publish(part, out, plan)
    return done._replace(resumed=len(blocks) - len(missing), blocks=len(blocks), unchanged=False)


def format_of(name: str) -> Format:
    """The module of a format.

    Raises:
        ConfigError: if there is none of this name, or a library that it needs is not installed.
    """
    if name not in FORMATS:
        raise unknown("format", name, FORMATS)
    try:
        return importlib.import_module(FORMATS[name])
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"--to {name} needs {error.name}: pip install 'coordlog[exchange]'"
        ) from error


def _plan(chosen: Sequence[Entry], options: Options) -> Json:
    """What decides about every byte of the set: episodes by content, options, version."""
    shapes = {json.dumps(entry.header.env["layout"], sort_keys=True) for entry in chosen}
    if len(shapes) > 1 or len({entry.header.arms for entry in chosen}) > 1:
        raise ConfigError(
            "episodes of several robots or tasks: expected one, got layouts "
            f"{', '.join(sorted(shapes))}; choose one with --where"
        )
    rates = {fps_of(entry.header) for entry in chosen} if options.to.startswith("lerobot") else ()
    if len(rates) > 1:
        raise ConfigError(
            "episodes of several rates: expected one, got "
            f"{', '.join(f'{rate:g}' for rate in sorted(rates))} Hz; choose one with --where "
            "control_period = …, or import them with --resample"
        )
    empty = [entry.path for entry in chosen if not entry.result.length]
    if empty:
        raise ConfigError(
            f"{empty[0]}: an episode without a step, which no other format can hold; leave it out "
            "with --where 'length > 0'"
        )
    if options.to == "rosbag2":
        _require_own_names(chosen)
    digest = hashlib.sha256()
    for entry in chosen:
        about = json.dumps(entry.row, sort_keys=True)
        digest.update(f"{about}\0{entry.result.digest}\n".encode())
    return {
        "options": asdict(options) | {"cameras": list(options.cameras)},
        "episodes": len(chosen),
        "of": digest.hexdigest(),
        "coordlog_version": __version__,
    }


def _require_own_names(chosen: Sequence[Entry]) -> None:
    """A bag is named as its log: no two may have one name."""
    seen: dict[str, Path] = {}
    for entry in chosen:
        other = seen.setdefault(entry.path.stem, entry.path)
        if other is not entry.path:
            raise ConfigError(
                f"{entry.path} and {other} would both become the bag {entry.path.stem}; export "
                "them into separate folders"
            )


def _is_there(out: Path, plan: Json) -> bool:
    try:
        return bool(json.loads((out / MARKER).read_text("utf-8")) == plan)
    except (OSError, ValueError):
        return False


def refuse_taken(out: Path, *, force: bool) -> None:
    """Never write over what is there, unless told.

    Raises:
        StorageError: if there is something of this name.
    """
    if os.path.lexists(out) and not force:
        raise StorageError(
            f"{out}: exists and is not overwritten; choose another folder, or pass --force"
        )


@contextmanager
def growing(part: Path, plan: Json) -> Iterator[None]:
    """Hold the growing folder for this process alone; begin anew unless it is of this very plan."""
    with translated(part, "create the folder"):
        part.parent.mkdir(parents=True, exist_ok=True)
        if part.exists() and not (part / MARKER).exists() and any(part.iterdir()):
            raise StorageError(f"{part}: not left by an export; move it away")
        if part.exists() and not _is_there(part, plan):
            shutil.rmtree(part)
        (part / _JOURNALS).mkdir(parents=True, exist_ok=True)
        (part / MARKER).write_text(json.dumps(plan, indent=1) + "\n", "utf-8")
        lock = os.open(part / _JOURNALS, os.O_RDONLY | os.O_CLOEXEC)
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise StorageError(f"{part}: another export is writing this set; wait for it") from None
        yield
    finally:
        os.close(lock)


def _blocks(chosen: Sequence[Entry], part: Path, options: Options) -> list[Block]:
    size = BLOCK_WITH_IMAGES if options.cameras else BLOCK
    blocks, frame = [], 0
    tasks = tuple(dict.fromkeys(task_text(entry.header) for entry in chosen))
    for number, first in enumerate(range(0, len(chosen), size)):
        group = chosen[first : first + size]
        paths = tuple(entry.path for entry in group)
        blocks.append(Block(number, part, paths, first, frame, options, tasks))
        frame += sum(entry.result.length for entry in group)
    return blocks


def _journal(block: Block) -> Path:
    return block.folder / _JOURNALS / f"{block.number:05d}.json"


def _write(block: Block, *, name: str) -> int:
    """Write one block and then its journal; runs in a process of its own."""
    module: Format = importlib.import_module(name)
    with translated(block.folder, "write"):
        journal = json.dumps(module.write_block(block), ensure_ascii=False)
        path = _journal(block)
        growing = path.with_suffix(".part")
        growing.write_text(journal, "utf-8")
        os.replace(growing, path)
    return len(block.paths)


def publish(part: Path, out: Path, plan: Json) -> None:
    """Give the finished folder its name; what was there goes when the new one is in place."""
    with translated(out, "publish the set"):
        shutil.rmtree(part / _JOURNALS)
        (part / MARKER).write_text(json.dumps(plan, indent=1) + "\n", "utf-8")
        os.sync()
        if not os.path.lexists(out):
            os.rename(part, out)
            return
        old = out.parent / f".{out.name}.old"
        os.rename(out, old)
        os.rename(part, out)
        if old.is_dir() and not old.is_symlink():
            shutil.rmtree(old)
        else:
            old.unlink()
