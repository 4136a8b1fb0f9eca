"""Episode files, or a whole folder of them, to a rerun recording."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import rerun as rr

from coordlog.errors import ConfigError, StorageError, TruncatedError
from coordlog.monitor import Monitor
from coordlog.record.dataset import open as open_logs
from coordlog.record.files import find_files, nothing_found
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
    paths: Sequence[Path],
    *,
    beside: Path | None = None,
    alone: bool = False,
    ghosts: bool = False,
    monitor: Monitor | None = None,
) -> Drawn:
    """Draw episodes together, or one folder as an overview.

    Args:
        paths: Episodes, or one folder.
        beside: Another episode beside them.
        alone: Do not look for the smoothed or raw sibling of a single episode.
        ghosts: Robots in one place, translucent, instead of side by side.
        monitor: Hears of progress, and of files that are left out.

    Raises:
        ConfigError: for a folder among several paths.
        SpecError: for a folder without an episode to show.
        FormatError: if a file is no episode, or holds no complete step.
    """
    heard = Monitor() if monitor is None else monitor
    if len(paths) > 1 and any(item.is_dir() for item in paths):
        raise ConfigError(
            "view: expected one folder, or episodes; got a folder among several paths"
        )
    if paths[0].is_dir():
        return _overview(paths[0], heard)
    shows = [_show(path) for path in _together(list(paths), beside, alone=alone, monitor=heard)]
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


def _overview(folder: Path, monitor: Monitor) -> Drawn:
    """The overview of a folder; files that are left out because they are broken are named."""
    files = find_files(folder)
    if not files.paths:
        raise nothing_found([folder], files)
    logs = open_logs(folder, skip_broken=True)
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
            files = files._replace(skipped=())
            raise nothing_found([folder], files, skipped=logs.skipped) from error
    for item in logs.skipped:
        monitor.note(f"skipped: {item.path}: {item.reason}")
    return Drawn(stream, "some files were left out" if logs.skipped else "")
