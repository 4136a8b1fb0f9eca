"""coordlog serve: episodes as a table in rerun's viewer, to filter and to open."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Annotated

import typer

from coordlog.commands import terminal
from coordlog.commands.options import Episodes, Jobs
from coordlog.errors import EXIT_PARTIAL, ConfigError
from coordlog.parallel import mapped

MOST = 500
"""Episodes that are served without a word: each is drawn first."""

Where = Annotated[str, typer.Option(help='Which episodes, in SQL: "not clean".', metavar="SQL")]
Most = Annotated[int, typer.Option(min=1, help="Refuse more episodes than this.")]
Port = Annotated[int, typer.Option(min=0, help="Port; 0 for a free one.")]


def serve(
    path: Episodes, where: Where = "", most: Most = MOST, port: Port = 0, jobs: Jobs = "0"
) -> None:
    """Serve episodes to rerun's viewer on this machine (127.0.0.1 only), until Ctrl-C.

    A table with scene, policy, success, clean and length of each, which the viewer filters; a click
    opens the episode as `coordlog view` shows it. Exit code 3 if files were left out.

    Examples:

        coordlog serve logs/ --where "not clean"
    """
    from coordlog.catalog.asking import chosen
    from coordlog.record.files import find_files, nothing_found
    from coordlog.view.serving import prepared, serving

    with terminal.interruptible() as monitor, tempfile.TemporaryDirectory("-coordlog") as name:
        files = chosen(path, where, jobs=jobs, monitor=monitor) if where else find_files(path)
        if not files.paths:
            raise nothing_found(path, files)
        if len(files.paths) > most:
            raise ConfigError(
                f"serve: {len(files.paths):,} episodes, each of which is drawn first; choose some"
                f" with --where, or pass --most {len(files.paths)}"
            )
        left = [f"{item.path}: {item.reason}" for item in files.skipped]
        draw, items = prepared(files.paths, Path(name))
        with monitor.progress("drawing episodes", len(items)) as progress:
            for done in mapped(draw, items, jobs=jobs):
                progress.advance(1)
                left += [f"{done.source}: {done.reason}"] if done.reason else []
                if monitor.stopped:
                    break
        for text in left:
            terminal.note(f"skipped: {text}")
        with serving(Path(name), port=port) as address:
            terminal.say(f"{address}   (open it with: rerun {address}; Ctrl-C ends it)")
            while not monitor.stopped:
                time.sleep(0.1)
    if left:
        raise typer.Exit(EXIT_PARTIAL)
