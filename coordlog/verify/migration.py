"""Episodes of an older schema version as new files of the present one; the old files stay.

What the new version logs besides (`ctrl`, `torque`) is simulated again from the file alone, and
only taken if everything that was logged comes back bit for bit. Where it does not the episode is
written with what it had, and that is said.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from coordlog.episode import MODEL_MJB, Array, Header
from coordlog.errors import CoordlogError, FormatError, StorageError, TruncatedError
from coordlog.record.reader import read_header
from coordlog.record.recording import Recording
from coordlog.record.storage import PART, locked
from coordlog.record.writer import write_episode
from coordlog.sim.replay import Log, exact_here, replay
from coordlog.spec import JOINT_STATE_TOPIC, SCHEMA_VERSION

MIGRATED = "migrate"
"""The lineage's name for an episode that was written again in a later schema version."""


class Migrated(NamedTuple):
    """What became of one file."""

    path: Path
    filled: bool
    """Whether `ctrl` and `torque` were simulated again."""
    reason: str
    """Why not; "" if they were."""


def migrate(source: Recording, target: Path) -> Migrated:
    """Write an episode of an older schema version as a new file of the present one.

    Its lineage names the old file by its digest, and keeps the lineage that it had.

    Args:
        source: The episode.
        target: Name of the new file.

    Raises:
        FormatError: if it is of the present version already, or cannot be read.
        StorageError: if the new file exists or cannot be written.

    Example:
        >>> migrate(Recording("old/a.mcap"), Path("new/a.mcap")).filled     # doctest: +SKIP
        True
    """
    old = source.header
    if needs_none(source):
        raise FormatError(f"{source.source}: of schema version {SCHEMA_VERSION} already")
    columns, reason = _simulated(source)
    header = old.current(n_c=columns["ctrl"].shape[1] if columns else 0)
    lineage = {
        "parents": [source.digest],
        "transform": MIGRATED,
        "parameters": {
            "schema_version": old.version,
            "lineage": old.lineage,
            "simulated_again": not reason,
            "reason": reason,
        },
    }
    episode = replace(
        source.episode,
        header=replace(header, lineage=lineage),
        columns={**source.episode.columns, **columns},
    )
    kept = {name: data for name, data in source.attachments.items() if name != MODEL_MJB}
    _discard_killed(source, target)
    try:
        write_episode(target, episode, attachments=kept, display=source.has(JOINT_STATE_TOPIC))
    except StorageError as error:
        _discard_killed(source, target)
        refused = getattr(error.__cause__, "strerror", None)
        raise StorageError(
            f"{target}: cannot write: {refused}" if refused else str(error)
        ) from error
    return Migrated(target, not reason, reason)


def needs_none(source: Recording) -> bool:
    """Whether an episode is of the present schema version."""
    return source.header.version == SCHEMA_VERSION


def migrated_before(source: Recording, target: Path) -> bool:
    """Whether a file is what migrating an episode made."""
    try:
        lineage = read_header(target).lineage
    except CoordlogError:
        return False
    return bool(lineage["transform"] == MIGRATED and lineage["parents"] == [source.digest])


def _discard_killed(source: Recording, target: Path) -> None:
    """Delete the part file that an earlier try to migrate this episode left: it has nothing that
    the source has not.
    """
    part = target.with_name(target.name + PART)
    with suppress(StorageError, OSError), locked(part) as ours:
        if ours and (migrated_before(source, part) or _holds_nothing(part)):
            part.unlink()


def _holds_nothing(part: Path) -> bool:
    """Whether a part file ends before it says of what it is."""
    try:
        read_header(part)
    except FormatError as error:
        return isinstance(error, TruncatedError) or not part.stat().st_size
    return False


def _simulated(source: Recording) -> tuple[dict[str, Array], str]:
    """`ctrl` and `torque` of an episode that comes back bit for bit; or none, and why."""
    episode = source.episode
    reason = exact_here(source.header)
    if reason:
        return {}, reason
    try:
        header = _with_actuators(source.header, source.model.nu)
        start = source.initial_state
        (trace,) = replay([Log.of(episode, source.model, start)._replace(header=header)])
    except (CoordlogError, KeyError, IndexError, ValueError) as error:
        return {}, f"it cannot be simulated again: {error}"
    for name, logged in episode.columns.items():
        if name != "action" and logged.tobytes() != trace.columns[name].tobytes():
            return {}, f"simulated again, {name} differs from what was logged"
    return {name: trace.columns[name] for name in ("ctrl", "torque")}, ""


def _with_actuators(header: Header, count: int) -> Header:
    return header.current(n_c=count)
