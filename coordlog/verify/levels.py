"""Check files at a level: structure, values, physics; each level takes in those before it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

from coordlog.errors import (
    ConfigError,
    FormatError,
    NewerError,
    StorageError,
    TruncatedError,
    unknown,
)
from coordlog.monitor import Monitor
from coordlog.parallel import batches, mapped, shard
from coordlog.verify.finding import Finding

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping


LEVELS = ("file", "content", "replay")
BATCH = 32
"""Files that are replayed together: one simulation each."""


class Checked(NamedTuple):
    """What was found in some files.

    Example:
        >>> check_files([Path("logs/a.mcap")], level="replay").findings    # doctest: +SKIP
        []
    """

    findings: list[Finding]
    inexact: dict[str, str]
    """Files whose physics could only be compared within tolerances, and why."""
    files: int
    steps: int
    """Steps that were simulated again."""
    notes: tuple[str, ...] = ()
    """What else is worth knowing: files that another program has written anew."""
    skipped: Mapping[str, str] = MappingProxyType({})
    """Files that are no episodes, and why."""
    unfinished: tuple[str, ...] = ()
    """Parts that no writer has finished."""


def check_logs(
    paths: Sequence[Path],
    *,
    level: str = "replay",
    share: str = "",
    jobs: int | str = 0,
    monitor: Monitor | None = None,
) -> Checked:
    """Check the episodes that are named, or lie in folders that are named, at any depth.

    Args:
        paths: Files and folders.
        level: "file": structure and checksums. "content": and values. "replay": and the physics,
            bit for bit.
        share: "I/N": the I-th of N equal shares of the files; "" for all.
        jobs: Processes, 0 for one per core; or a cluster, see `parallel.mapped`.
        monitor: Hears of progress.

    Raises:
        ConfigError: for an unknown level, or a share without an episode.
        FormatError: if there is no episode: a proof that looked at nothing is none.
        StorageError: if a path does not exist.
    """
    from coordlog.record.files import find_files, nothing_found

    if level not in LEVELS:
        raise unknown("level", level, LEVELS)
    heard = Monitor() if monitor is None else monitor
    files = find_files(paths)
    wanted = shard(files.paths, share)
    if files.paths and not wanted:
        raise ConfigError(
            f"--shard {share}: none of {len(files.paths)} episodes is in it; take fewer shares"
        )
    left_out = {str(item.path): f"{item.path}: {item.reason}" for item in files.skipped}
    total = Checked([], {}, 0, 0, skipped=left_out, unfinished=tuple(map(str, files.parts)))
    with heard.progress(f"checking ({level})", len(wanted)) as progress:
        work = batches(wanted, BATCH)
        for group, each in zip(
            work, mapped(partial(check_files, level=level), work, jobs=jobs), strict=True
        ):
            total = total._replace(
                findings=total.findings + each.findings,
                inexact=total.inexact | each.inexact,
                files=total.files + each.files,
                steps=total.steps + each.steps,
                notes=total.notes + each.notes,
                skipped={**total.skipped, **each.skipped},
            )
            count = len(total.findings)
            progress.advance(len(group), f"{count} findings" if count else "")
    if len(paths) == 1 and str(paths[0]) in total.skipped:
        raise FormatError(total.skipped[str(paths[0])])
    if not total.files and not total.findings:
        for text in left_out_lines(total.skipped.values(), total.unfinished):
            heard.note(text)
        raise nothing_found(paths, files._replace(skipped=()))
    return total


def left_out_lines(skipped: Iterable[str], unfinished: Iterable[object]) -> list[str]:
    """A line for each file that was left out."""
    return [
        *(f"skipped: {reason}" for reason in skipped),
        *(f"unfinished: {name}; `coordlog recover` makes an episode of it" for name in unfinished),
    ]


def _recognised(path: Path, found: list[Finding]) -> tuple[list[Finding], str]:
    """What was found in a file, if it is an episode, however damaged, or why it is none."""
    from coordlog.record.opening import looks_ours
    from coordlog.record.reader import probe

    try:
        probe(path)
    except TruncatedError as error:
        return [Finding(str(path), "file", None, "file", "a finished episode", str(error))], ""
    except (FormatError, StorageError) as error:
        later = isinstance(error, NewerError) and str(error).endswith(found[0].got)
        if isinstance(error, StorageError) or later or not looks_ours(path):
            return [], str(error)
    return found, ""


def check_files(paths: Sequence[Path], *, level: str) -> Checked:
    """Check some files at a level; runs in a process of its own.

    Args:
        paths: Episode files.
        level: "file": structure and checksums. "content": and values. "replay": and the physics,
            bit for bit.
    """
    from coordlog.record.recording import Recording
    from coordlog.verify.file import check as check_one
    from coordlog.verify.file import rewritten
    from coordlog.verify.observed import judged

    findings: list[Finding] = []
    notes: list[str] = []
    observed: dict[str, str] = {}
    skipped: dict[str, str] = {}
    for path in paths:
        recording, why = Recording(path), ""
        try:
            found = check_one(recording, level="file" if level == "file" else "content")
            if any(item.level == "file" for item in found):
                found, why = _recognised(path, found)
            findings += found
            if not found and not why and (note := rewritten(recording)):
                notes.append(f"{path}: {note}")
            if not found and not why and level != "replay" and recording.observed:
                observed[str(path)] = judged(recording)
        except StorageError as error:
            why = str(error)
        if why:
            skipped[str(path)] = why
    whole = [path for path in paths if str(path) not in skipped]
    checked = Checked(findings, observed, len(whole), 0, tuple(notes), skipped)
    if level != "replay":
        return checked
    from coordlog.verify.physics import check_replay
    from coordlog.verify.trial import runnable

    damaged = {item.path for item in findings if item.level == "file"}
    tried = runnable([path for path in whole if str(path) not in damaged])
    findings += tried
    damaged |= {item.path for item in tried}
    replays = check_replay([path for path in whole if str(path) not in damaged])
    findings += replays.findings
    return checked._replace(inexact=replays.inexact, steps=replays.steps)
