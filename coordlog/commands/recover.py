"""coordlog recover: what a crash left behind becomes an episode."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from coordlog.commands import terminal
from coordlog.commands.options import flag, json_flag
from coordlog.errors import EXIT_BAD_INPUT, EXIT_PARTIAL, CoordlogError, FormatError, TruncatedError


class Told(NamedTuple):
    """What became of one file."""

    source: Path
    status: str
    """recovered, before (recovered earlier), nothing (no step in it), discarded or failed"""
    path: Path | None
    """the episode"""
    steps_kept: int
    lost: str
    """what could not come along, or why nothing was recovered"""
    lossy: bool


def recover(
    path: Annotated[
        list[Path],
        typer.Argument(
            help="Unfinished NAME.mcap.part or damaged NAME.mcap, which are left as they are; or"
            " folders, for all that is unfinished in them."
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="Name of the episode, for a single file; by default beside it."),
    ] = None,
    discard_empty: Annotated[
        bool, flag("--discard-empty", "Delete part files that hold no step to recover.")
    ] = False,
    as_json: Annotated[bool, json_flag("what was recovered")] = False,
) -> None:
    """Make a valid episode, marked as aborted, of everything complete in unfinished or damaged
    files.

    Every file is tried and told of. Exit code 3 if steps were lost or a file could not be used,
    each named; 2 if none could. A part file whose episode lies beside it is done with, and no
    command calls it unfinished any more.

    Examples:

        coordlog recover logs/table-train-s0-000003-1f2e3d4c.mcap.part

        coordlog recover logs/ --discard-empty
    """
    if out is not None and (len(path) > 1 or path[0].is_dir()):
        raise typer.BadParameter("expected a single file with --out", param_hint="--out")
    wanted, notes = _wanted(path)
    for text in notes:
        terminal.note(text)
    if len(wanted) == 1 and not path[0].is_dir() and not discard_empty:
        told = [_recovered(wanted[0], out)]
    else:
        told = [_tried(item, out, discard_empty=discard_empty) for item in wanted]
    if as_json:
        terminal.print_json([item._asdict() for item in told])
    else:
        for item in told:
            terminal.say(_sentence(item))
        if not told:
            terminal.say("nothing is unfinished")
    bad = [item for item in told if item.status in ("failed", "nothing")]
    if bad and len(bad) == len(told):
        raise typer.Exit(EXIT_BAD_INPUT)
    if bad or notes or any(item.lossy for item in told):
        raise typer.Exit(EXIT_PARTIAL)


def _wanted(paths: list[Path]) -> tuple[list[Path], list[str]]:
    """The files to try: those named, and in folders what is unfinished; and what was left out."""
    from coordlog.record.files import find_files
    from coordlog.record.reader import probe

    wanted: dict[Path, None] = {}
    notes: list[str] = []
    for path in paths:
        if not path.is_dir():
            wanted[path] = None
            continue
        found = find_files(path)
        notes += [f"skipped: {item.path}: {item.reason}" for item in found.skipped]
        wanted |= dict.fromkeys(found.parts)
        for each in found.paths:
            try:
                probe(each)
            except TruncatedError:
                wanted[each] = None
            except CoordlogError as error:
                notes.append(f"skipped: {error}")
    return list(wanted), notes


def _tried(source: Path, out: Path | None, *, discard_empty: bool) -> Told:
    """As `_recovered`, but what goes wrong is told, too."""
    from coordlog.record.storage import PART

    try:
        return _recovered(source, out)
    except FormatError as error:
        if not isinstance(error, TruncatedError) and source.stat().st_size:
            return Told(source, "failed", None, 0, _reason(source, error), False)
        if discard_empty and source.name.endswith(PART):
            return _discarded(source)
        return Told(source, "nothing", None, 0, _reason(source, error), False)
    except CoordlogError as error:
        return Told(source, "failed", None, 0, _reason(source, error), False)


def _recovered(source: Path, out: Path | None) -> Told:
    """Recover one file, unless that was done before."""
    from coordlog.record.files import recovered_before
    from coordlog.record.storage import PART
    from coordlog.verify.repair import recover as recover_file

    before = recovered_before(source) if source.name.endswith(PART) and out is None else None
    if before is not None:
        return Told(source, "before", before, 0, "nothing", False)
    done = recover_file(source, out)
    return Told(source, "recovered", done.path, done.steps_kept, done.lost, done.lossy)


def _discarded(source: Path) -> Told:
    """Delete a part file of no step, unless somebody is just beginning it."""
    from coordlog.record.storage import locked

    with locked(source) as ours:
        if not ours:
            return Told(source, "failed", None, 0, "is being written by another process", False)
        try:
            source.unlink()
        except OSError as error:
            return Told(source, "failed", None, 0, f"cannot delete it: {error.strerror}", False)
    return Told(source, "discarded", None, 0, "nothing", False)


def _reason(source: Path, error: CoordlogError) -> str:
    return str(error).removeprefix(f"{source}: ")


def _sentence(item: Told) -> str:
    if item.status == "recovered":
        return f"{item.path}: {item.steps_kept} steps kept, lost: {item.lost}"
    if item.status == "before":
        return f"{item.source}: recovered before, as {item.path}"
    if item.status == "discarded":
        return f"{item.source}: nothing in it; deleted"
    if item.status == "nothing":
        return f"{item.source}: nothing in it ({item.lost}); --discard-empty deletes such parts"
    return f"{item.source}: not recovered: {item.lost}"
