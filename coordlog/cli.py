"""The command line: names the commands, turns errors into one sentence and an exit code.

Exit codes: 0 ok, 1 a check failed, 2 usage or bad input, 3 partial (something was skipped or lost,
and named), 130 interrupted.
"""

from __future__ import annotations

import os
import sys
from typing import Annotated

import typer
from rich.text import Text

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
    smooth,
    train,
    view,
)
from coordlog.commands.terminal import err
from coordlog.errors import EXIT_INTERRUPTED, CoordlogError, missing_extra
from coordlog.version import __version__

app = typer.Typer(
    name="coordlog",
    help="Robot episodes that are never lost, never silently wrong, and always replayable: record, check, train, smooth, view.",
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
    try:
        app()
    except CoordlogError as error:
        err.print(Text.assemble(("error: ", "bold red"), str(error)), soft_wrap=True)
        sys.exit(error.exit_code)
    except ModuleNotFoundError as error:
        missing = missing_extra(error)
        if missing is None:
            raise
        err.print(Text.assemble(("error: ", "bold red"), str(missing)), soft_wrap=True)
        sys.exit(missing.exit_code)
    except KeyboardInterrupt:
        sys.exit(EXIT_INTERRUPTED)
    except BrokenPipeError:  # the reader of our output has had enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)


if __name__ == "__main__":
    main()
