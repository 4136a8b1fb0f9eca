"""The command line: names the commands, turns errors into one sentence and an exit code.

Exit codes: 0 ok, 1 a check failed, 2 usage or bad input, 3 partial (something was skipped or lost,
and named), 130 interrupted.
"""

from __future__ import annotations

import os
import signal
import sys
from typing import Annotated

import typer

from coordlog.commands import (
    check,
    diff,
    export,
    import_,
    index,
    info,
    migrate,
    pack,
    plot,
    query,
    record,
    recover,
    robot,
    scenes,
    select,
    serve,
    smooth,
    terminal,
    train,
    view,
)
from coordlog.errors import (
    EXIT_BAD_INPUT,
    EXIT_INTERRUPTED,
    EXIT_OK,
    CoordlogError,
    missing_extra,
)
from coordlog.version import __version__

DEBUG = "COORDLOG_DEBUG"
"""Set it, and an unforeseen error shows where it came from."""

app = typer.Typer(
    name="coordlog",
    help=(
        "Robot episodes that are never lost, never silently wrong, and always replayable: record, "
        "check, train, smooth, view."
    ),
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
)
app.command("record")(record.record)
app.command("check")(check.check)
app.command("info")(info.info)
app.command("recover")(recover.recover)
app.command("train")(train.train)
app.command("smooth")(smooth.smooth)
app.command("plot")(plot.plot)
app.command("view")(view.view)
app.command("scenes")(scenes.scenes)
app.command("robot")(robot.robot)
app.command("export")(export.export)
app.command("index")(index.index)
app.command("query")(query.query)
app.command("select")(select.select)
app.command("serve")(serve.serve)
app.command("diff")(diff.diff)
app.command("pack")(pack.pack)
app.command("unpack")(pack.unpack)
app.command("import")(import_.import_)
app.command("migrate")(migrate.migrate)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"coordlog {__version__}")
        raise typer.Exit


@app.callback()
def coordlog(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_version, is_eager=True)
    ] = False,
) -> None:
    """Robot episodes that are never lost, never silently wrong, and always replayable."""


def main() -> None:
    """Entry point of the console script."""
    terminal.prepare_streams()
    terminal.hear_warnings()
    # a polite kill unwinds as Ctrl-C does: nothing that was started is left behind
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    code = EXIT_BAD_INPUT
    try:
        app(standalone_mode=True)
    except SystemExit as done:
        code = done.code if isinstance(done.code, int) else EXIT_BAD_INPUT if done.code else EXIT_OK
    except CoordlogError as error:
        terminal.complain(error)
        code = error.exit_code
    except KeyboardInterrupt:
        code = EXIT_INTERRUPTED
    except Exception as error:
        if os.environ.get(DEBUG):
            raise
        code = _unforeseen(error)
    for stream in (sys.stdout, sys.stderr):  # nobody may be reading any more
        try:
            stream.flush()
        except OSError:
            terminal.forsake(stream)
    sys.exit(code)


def _unforeseen(error: Exception) -> int:
    """One sentence about an error that no part of coordlog expected, and the exit code."""
    if isinstance(error, BrokenPipeError):
        terminal.forsake(sys.stdout)
        return EXIT_OK
    missing = missing_extra(error) if isinstance(error, ModuleNotFoundError) else None
    if missing is not None:
        terminal.complain(missing)
    elif isinstance(error, OSError):  # a disk that is full, a device that is gone
        where = f"{error.filename}: " if error.filename else ""
        terminal.complain(f"{where}{error.strerror or error}")
    elif isinstance(error, MemoryError):
        terminal.complain(f"not enough memory: {error or 'try smaller inputs, or fewer at once'}")
    else:
        said = f"{type(error).__name__}: {error}"
        terminal.complain(
            f"a fault of coordlog itself, {said[:200]}; please report it with what {DEBUG}=1 prints"
        )
    return EXIT_BAD_INPUT


if __name__ == "__main__":
    main()
