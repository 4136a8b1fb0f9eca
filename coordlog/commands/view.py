"""coordlog view: episodes, their knots and splines, or a whole folder, in rerun."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from coordlog.commands import terminal
from coordlog.commands.options import flag
from coordlog.errors import EXIT_PARTIAL, StorageError

Shown = Annotated[
    list[Path],
    typer.Argument(help="Episodes to show together; or folders, packs, manifests for an overview."),
]
Where = Annotated[str, typer.Option(help='Overview of which episodes, in SQL: "not clean".')]
Beside = Annotated[
    Path | None,
    typer.Option(
        "--with", help="Another episode beside it; by default its smoothed or raw sibling."
    ),
]
Ghosts = Annotated[
    bool, flag("--ghosts", "Robots in one place, translucent, instead of side by side.")
]
Save = Annotated[
    Path | None, typer.Option(help="Write the recording (.rrd) instead of showing it.")
]
Screenshot = Annotated[Path | None, typer.Option(help="Write a picture (.png); needs no display.")]
At = Annotated[float | None, typer.Option(help="Time of the picture [s]; by default the end.")]
Web = Annotated[bool, flag("--web", "Serve to a browser on this machine (127.0.0.1 only).")]
Port = Annotated[int, typer.Option(min=0, help="Port; 0 for a free one.")]
NoOpen = Annotated[bool, flag("--no-open", "Build the recording and show nothing: does it work?")]


def view(
    path: Shown,
    where: Where = "",
    beside: Beside = None,
    alone: Annotated[bool, flag("--alone", "Do not look for a sibling.")] = False,
    ghosts: Ghosts = False,
    save: Save = None,
    screenshot: Screenshot = None,
    at: At = None,
    web: Web = False,
    port: Port = 0,
    no_open: NoOpen = False,
) -> None:
    """Show an episode in rerun: the robot, contacts, hand paths, plots, and knots against splines.

    A raw episode brings its smoothed sibling along, and the other way round, found by lineage in
    the same tree.

    Examples:

        coordlog view logs/table/table-train-s0-000000-1f2e3d4c.mcap

        coordlog view raw.mcap smoothed.mcap --ghosts --save both.rrd

        coordlog view logs/ --where "not clean" --screenshot overview.png
    """
    for target in (save, screenshot):
        if target is not None and target.exists():
            raise StorageError(
                f"{target}: the file exists and is not overwritten; choose another name"
            )
    from coordlog.catalog.asking import chosen
    from coordlog.view import files

    watcher = terminal.Watcher()
    asked = chosen(path, where, monitor=watcher) if where else path
    drawn = files.draw_files(asked, beside=beside, alone=alone, ghosts=ghosts, monitor=watcher)
    with tempfile.TemporaryDirectory(prefix="coordlog-") as folder:
        rrd = save or Path(folder) / "episode.rrd"
        files.save(drawn.stream, rrd)
        if save is not None:
            size = terminal.megabytes(save.stat().st_size)
            terminal.say(f"{save}: {size}; open it with: rerun {save}")
        window = not (no_open or save or screenshot or web)
        _present(rrd, screenshot=screenshot, at=at, web=web, port=port, window=window)
    if drawn.partial:
        terminal.note(drawn.partial)
        raise typer.Exit(EXIT_PARTIAL)


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
