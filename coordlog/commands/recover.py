"""coordlog recover: what a crash left behind becomes an episode."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from coordlog.commands import terminal
from coordlog.errors import EXIT_PARTIAL


def recover(
    path: Annotated[
        list[Path],
        typer.Argument(
            help="Unfinished NAME.mcap.part or damaged NAME.mcap; they are left as they are."
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="Name of the episode, for a single file; by default beside it."),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print what was recovered as JSON.")
    ] = False,
) -> None:
    """Make a valid episode, marked as aborted, of everything complete in an unfinished or damaged
    file.

    Exit code 3 if steps were lost; what was lost is named.

    Examples:

        coordlog recover logs/table-train-s0-000003-1f2e3d4c.mcap.part
    """
    from coordlog.verify.repair import recover as recover_file

    if out is not None and len(path) > 1:
        raise typer.BadParameter(
            f"expected a single file with --out, got {len(path)}", param_hint="--out"
        )
    recovered = [recover_file(item, out) for item in path]
    if as_json:
        terminal.print_json([{**item._asdict(), "path": str(item.path)} for item in recovered])
    else:
        for item in recovered:
            terminal.out.print(
                f"{item.path}: {item.steps_kept} steps kept, lost: {item.lost}",
                highlight=False,
                markup=False,
                soft_wrap=True,
            )
    if any(item.lossy for item in recovered):
        raise typer.Exit(EXIT_PARTIAL)
