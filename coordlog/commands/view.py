"""coordlog view: episodes, their knots and splines, or a whole folder, in rerun."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coordlog.commands import terminal
from coordlog.commands.siblings import sibling
from coordlog.errors import EXIT_PARTIAL, ConfigError, StorageError, TruncatedError

if TYPE_CHECKING:
    from coordlog.view.show import Show


def view(
    path: Annotated[
        list[Path], typer.Argument(help="Episodes to show together, or one folder for an overview.")
    ],
    beside: Annotated[
        Path | None,
        typer.Option(
            "--with", help="Another episode beside it; by default its smoothed or raw sibling."
        ),
    ] = None,
    alone: Annotated[bool, typer.Option("--alone", help="Do not look for a sibling.")] = False,
    ghosts: Annotated[
        bool,
        typer.Option("--ghosts", help="Robots in one place, translucent, instead of side by side."),
    ] = False,
    save: Annotated[
        Path | None, typer.Option(help="Write the recording (.rrd) instead of showing it.")
    ] = None,
    screenshot: Annotated[
        Path | None, typer.Option(help="Write a picture (.png); needs no display.")
    ] = None,
    at: Annotated[
        float | None, typer.Option(help="Time of the picture [s]; by default the end.")
    ] = None,
    web: Annotated[
        bool, typer.Option("--web", help="Serve to a browser on this machine (127.0.0.1 only).")
    ] = False,
    port: Annotated[int, typer.Option(min=0, help="Port; 0 for a free one.")] = 0,
    no_open: Annotated[
        bool, typer.Option("--no-open", help="Build the recording and show nothing: does it work?")
    ] = False,
) -> None:
    """Show an episode in rerun: the robot, contacts, hand paths, plots, and knots against splines.

    A raw episode brings its smoothed sibling along, and the other way round, found by lineage in
    the same tree.

    Examples:

        coordlog view logs/table/table-train-s0-000000-1f2e3d4c.mcap

        coordlog view raw.mcap smoothed.mcap --ghosts --save both.rrd

        coordlog view logs/ --screenshot overview.png
    """
    for target in (save, screenshot):
        if target is not None and target.exists():
            raise StorageError(
                f"{target}: the file exists and is not overwritten; choose another name"
            )
    if len(path) > 1 and any(item.is_dir() for item in path):
        raise ConfigError(
            "view: expected one folder, or episodes; got a folder among several paths"
        )
    if path[0].is_dir():
        stream, partial = _overview(path[0])
    else:
        shows = [_show(item) for item in _together(path, beside, alone=alone)]
        partial = any(show.episode.result.aborted for show in shows)
        stream = _recording(shows, ghosts=ghosts)
    with tempfile.TemporaryDirectory(prefix="coordlog-") as folder:
        rrd = save or Path(folder) / "episode.rrd"
        _save(stream, rrd)
        if save is not None:
            terminal.say(
                f"{save}: {terminal.megabytes(save.stat().st_size)}; open it with: rerun {save}"
            )
        _present(
            rrd,
            screenshot=screenshot,
            at=at,
            web=web,
            port=port,
            window=not (no_open or save or screenshot or web),
        )
    if partial:
        terminal.note(
            "some files were left out"
            if path[0].is_dir()
            else "aborted or unfinished: shown as far as it goes"
        )
        raise typer.Exit(EXIT_PARTIAL)


def _together(paths: list[Path], beside: Path | None, *, alone: bool) -> list[Path]:
    """The files to show: those named, and the sibling of a single one."""
    if beside is not None:
        return [*paths, beside]
    if len(paths) > 1 or alone:
        return paths
    found = sibling(paths[0])
    if found is None:
        return paths
    raw, smoothed = found
    terminal.note(f"with its sibling: {smoothed if raw == paths[0] else raw}")
    return [raw, smoothed]


def _show(path: Path) -> Show:
    """An episode with its model; of an unfinished file what is complete.

    Raises:
        FormatError: if the file is no episode, or holds no complete step.
    """
    from coordlog.record.opening import load, naming
    from coordlog.record.reader import read_attachments, read_episode
    from coordlog.verify.repair import salvaged
    from coordlog.view.show import Show

    try:
        return Show(path.stem, read_episode(path), read_attachments(path), str(path))
    except TruncatedError:
        with naming(path):
            salvage = salvaged(load(path))
        return Show(path.stem, salvage.episode, salvage.attachments, str(path))


def _recording(shows: list[Show], *, ghosts: bool) -> Any:
    from coordlog.view.recording import to_rerun

    if len({show.name for show in shows}) < len(
        shows
    ):  # a smoothed file has the name of its raw one, in another folder
        shows = [
            replace(show, name=f"{show.name}-{Path(show.file).resolve().parent.name}")
            for show in shows
        ]
    if len({show.name for show in shows}) < len(shows):
        shows = [replace(show, name=f"{show.name}-{i}") for i, show in enumerate(shows, 1)]
    return to_rerun(shows, ghosts=ghosts)


def _overview(folder: Path) -> tuple[Any, bool]:
    """The overview of a folder, and whether files were left out of it because they are broken; they
    are named.

    Raises:
        SpecError: if no episode is left.
    """
    from coordlog.record.dataset import open as open_logs
    from coordlog.record.files import find_files, nothing_found
    from coordlog.record.reader import read_attachments, read_episode
    from coordlog.view.overview import to_overview
    from coordlog.view.show import Show

    files = find_files(folder)
    if not files.paths:
        raise nothing_found([folder], files)
    logs = open_logs(folder, skip_broken=True)
    with terminal.progress() as bar:
        task = bar.add_task("reading episodes", total=len(logs), note="")

        def shows() -> Iterator[Show]:
            model = None  # one robot is drawn: the first whose model is there
            for path in logs.paths:
                episode = logs.attempt(path, read_episode)
                if episode is not None:
                    attachments = None if model else logs.attempt(path, read_attachments)
                    model = model or attachments
                    yield Show(path.stem, episode, attachments or {}, str(path))
                bar.update(task, advance=1)

        try:
            stream = to_overview(shows())
        except ConfigError as error:
            raise nothing_found(
                [folder], files._replace(skipped=()), skipped=logs.skipped
            ) from error
    for item in logs.skipped:
        terminal.note(f"skipped: {item.path}: {item.reason}")
    return stream, bool(logs.skipped)


def _save(stream: Any, rrd: Path) -> None:
    try:
        rrd.parent.mkdir(parents=True, exist_ok=True)
        stream.save(str(rrd))
        stream.disconnect()
    except (OSError, RuntimeError) as error:
        raise StorageError(f"{rrd}: cannot write the recording: {error}") from error


def _present(
    rrd: Path, *, screenshot: Path | None, at: float | None, web: bool, port: int, window: bool
) -> None:
    """A picture, a page, or a window, as asked."""
    if screenshot is not None:
        from coordlog.view.headless import screenshot as take

        for said in take(rrd, screenshot, at=at):
            terminal.note(said)
        terminal.say(str(screenshot))
    if web:
        from coordlog.view.web import serve

        serve(
            rrd,
            port=port,
            ready=lambda address: terminal.say(f"{address}   (Ctrl-C ends it)"),
        )
    if window:
        from coordlog.view.viewer import open_window

        open_window([rrd], port=port)
