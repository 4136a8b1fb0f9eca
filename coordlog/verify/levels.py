"""Check files at a level: structure, values, physics; each level takes in those before it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

from coordlog.errors import FormatError, StorageError, TruncatedError, unknown
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
        ConfigError: for an unknown level.
        FormatError: if there is no episode: a proof that looked at nothing is none.
        StorageError: if a path does not exist.
    """
    from coordlog.record.files import find_files, nothing_found

    if level not in LEVELS:
        raise unknown("level", level, LEVELS)
    heard = monitor or Monitor()
    files = find_files(paths)
    named = paths[0] if len(paths) == 1 else None
    known, skipped, findings = _recognised(shard(files.paths, share), alone=named)
    left_out = {str(item.path): f"{item.path}: {item.reason}" for item in files.skipped} | skipped
    unfinished = tuple(str(part) for part in files.parts)
    if not known and not findings:
        for text in left_out_lines(left_out.values(), unfinished):
            heard.note(text)
        raise nothing_found(paths, files._replace(skipped=()))
    total = Checked(findings, {}, 0, 0)
    with heard.progress(f"checking ({level})", len(known)) as progress:
        work = batches(known, BATCH)
        for each in mapped(partial(check_files, level=level), work, jobs=jobs):
            total = Checked(
                total.findings + each.findings,
                total.inexact | each.inexact,
                total.files + each.files,
                total.steps + each.steps,
                total.notes + each.notes,
            )
            count = len(total.findings)
            progress.advance(each.files, f"{count} findings" if count else "")
    return total._replace(skipped=left_out, unfinished=unfinished)


def left_out_lines(skipped: Iterable[str], unfinished: Iterable[object]) -> list[str]:
    """A line for each file that was left out."""
    return [
        *(f"skipped: {reason}" for reason in skipped),
        *(f"unfinished: {name}; `coordlog recover` makes an episode of it" for name in unfinished),
    ]


def _recognised(
    paths: Sequence[Path], *, alone: Path | None
) -> tuple[list[Path], dict[str, str], list[Finding]]:
    """Files that look like episodes, files that do not, and findings for episodes that are cut off.

    Raises:
        FormatError: if the only file that was named is no episode.
    """
    from coordlog.record.reader import probe

    known: list[Path] = []
    skipped: dict[str, str] = {}
    findings: list[Finding] = []
    for path in paths:
        try:
            probe(path)
            known.append(path)
        except TruncatedError as error:
            found = Finding(str(path), "file", None, "file", "a finished episode", str(error))
            findings.append(found)
        except (FormatError, StorageError) as error:
            if path == alone:
                raise
            skipped[str(path)] = str(error)
    return known, skipped, findings


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
    for path in paths:
        recording = Recording(path)
        try:
            found = check_one(recording, level="file" if level == "file" else "content")
            findings += found
            if not found and (note := rewritten(recording)):
                notes.append(f"{path}: {note}")
            if not found and level != "replay" and (said := judged(recording)):
                observed[str(path)] = said
        except StorageError as error:  # it could be read a moment ago
            why = str(error).removeprefix(f"{path}: ")
            findings.append(Finding(str(path), "file", None, "file", "a readable file", why))
    if level != "replay":
        return Checked(findings, observed, len(paths), 0, tuple(notes))
    from coordlog.verify.physics import check_replay
    from coordlog.verify.trial import runnable

    damaged = {item.path for item in findings if item.level == "file"}
    tried = runnable([path for path in paths if str(path) not in damaged])
    findings += tried
    damaged |= {item.path for item in tried}
    replays = check_replay([path for path in paths if str(path) not in damaged])
    findings += replays.findings
    return Checked(findings, replays.inexact, len(paths), replays.steps, tuple(notes))
