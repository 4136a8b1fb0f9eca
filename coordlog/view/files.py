"""Episode files, or a whole folder of them, to a rerun recording."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import rerun as rr

from coordlog.errors import ConfigError, StorageError, TruncatedError
from coordlog.mjcf import worn_by
from coordlog.monitor import Monitor
from coordlog.record.addresses import is_single
from coordlog.record.beside import FOLDER, Beside
from coordlog.record.dataset import open as open_logs
from coordlog.record.files import Files, find_files, nothing_found
from coordlog.record.opening import load, naming
from coordlog.record.reader import read_attachments, read_episode
from coordlog.record.siblings import sibling
from coordlog.verify.repair import salvaged
from coordlog.view.overview import to_overview
from coordlog.view.recording import to_rerun
from coordlog.view.show import Show


class Drawn(NamedTuple):
    """A recording in memory, with its blueprint."""

    stream: rr.RecordingStream
    partial: str
    """What is not shown, in a sentence; "" if everything is."""


def draw_files(
    paths: Sequence[Path] | Files,
    *,
    beside: Path | None = None,
    alone: bool = False,
    ghosts: bool = False,
    monitor: Monitor | None = None,
) -> Drawn:
    """Draw episodes together, or many of a folder, pack, store or manifest as an overview.

    Args:
        paths: Episodes; or folders and the like; or what a search has found, as an overview.
        beside: Another episode beside them.
        alone: Do not look for the smoothed or raw sibling of a single episode.
        ghosts: Robots in one place, translucent, instead of side by side.
        monitor: Hears of progress, and of files that are left out.

    Raises:
        SpecError: for a folder without an episode to show.
        FormatError: if a file is no episode, or holds no complete step.
    """
    heard = Monitor() if monitor is None else monitor
    if isinstance(paths, Files) or not all(map(is_single, paths)):
        return _overview(paths, heard)
    shows = [_show(path) for path in _together(list(paths), beside, alone=alone, monitor=heard)]
    for said in dict.fromkeys(map(_bare, shows)):
        if said:
            heard.note(said)
    aborted = any(show.episode.result.aborted for show in shows)
    said = "aborted or unfinished: shown as far as it goes" if aborted else ""
    return Drawn(to_rerun(_apart(shows), ghosts=ghosts), said)


def save(stream: rr.RecordingStream, rrd: Path) -> None:
    """Write a recording, and let it go.

    Raises:
        StorageError: if the file system refuses.
    """
    try:
        rrd.parent.mkdir(parents=True, exist_ok=True)
        stream.save(str(rrd))
        stream.disconnect()
    except (OSError, RuntimeError) as error:
        raise StorageError(f"{rrd}: cannot write the recording: {error}") from error


def _together(
    paths: list[Path], beside: Path | None, *, alone: bool, monitor: Monitor
) -> list[Path]:
    """The files to show: those named, and the sibling of a single one."""
    if beside is not None:
        return [*paths, beside]
    if len(paths) > 1 or alone:
        return paths
    found = sibling(paths[0])
    if found is None:
        return paths
    raw, smoothed = found
    monitor.note(f"with its sibling: {smoothed if raw == paths[0] else raw}")
    return [raw, smoothed]


def _show(path: Path) -> Show:
    """An episode with its model; of an unfinished file what is complete."""
    try:
        return Show(path.stem, read_episode(path), read_attachments(path), str(path))
    except TruncatedError:
        with naming(path):
            salvage = salvaged(load(path))
        return Show(path.stem, salvage.episode, salvage.attachments, str(path))


def _bare(show: Show) -> str:
    """Why a robot does not look as it does, in a sentence; "" if nothing is missing."""
    there = Beside(show.file)
    missing = sum(name not in there for name in worn_by(show.attachments))
    if not missing:
        return ""
    return (
        f"its robot is drawn by what it collides with: {missing} of its meshes are not in "
        f"{Path(show.file).parent / FOLDER}"
    )


def _apart(shows: list[Show]) -> list[Show]:
    """The shows, each with a name of its own.

    A smoothed file has the name of its raw one, in another folder.
    """
    if len({show.name for show in shows}) < len(shows):
        shows = [
            replace(show, name=f"{show.name}-{Path(show.file).resolve().parent.name}")
            for show in shows
        ]
    if len({show.name for show in shows}) < len(shows):
        shows = [replace(show, name=f"{show.name}-{i}") for i, show in enumerate(shows, 1)]
    return shows


def _overview(paths: Sequence[Path] | Files, monitor: Monitor) -> Drawn:
    """The overview of many; files that are left out because they are broken are named."""
    files = paths if isinstance(paths, Files) else find_files(paths)
    given = () if isinstance(paths, Files) else paths
    if not files.paths:
        raise nothing_found(given, files)
    logs = open_logs(files.paths, skip_broken=True)
    with monitor.progress("reading episodes", len(logs)) as progress:

        def shows() -> Iterator[Show]:
            model = None  # one robot is drawn: the first whose model is there
            for path in logs.paths:
                episode = logs.attempt(path, read_episode)
                if episode is not None:
                    attachments = None if model else logs.attempt(path, read_attachments)
                    model = model or attachments
                    yield Show(path.stem, episode, attachments or {}, str(path))
                progress.advance(1)

        try:
            stream = to_overview(shows())
        except ConfigError as error:
            raise nothing_found(given, files, skipped=logs.skipped) from error
    left = [*files.skipped, *logs.skipped]
    for item in left:
        monitor.note(f"skipped: {item.path}: {item.reason}")
    return Drawn(stream, "some files were left out" if left else "")
