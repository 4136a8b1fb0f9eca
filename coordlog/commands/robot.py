"""coordlog robot: a model understood, and whatever is wrong with it said at once."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from coordlog.commands import terminal
from coordlog.commands.options import json_flag
from coordlog.errors import EXIT_CHECK_FAILED, ConfigError, StorageError

if TYPE_CHECKING:
    from coordlog.sim.examine import Report
    from coordlog.tasks.scene import Scene

MODELS = (".xml", ".urdf", ".mjcf")


def robot(
    model: Annotated[
        str,
        typer.Argument(
            help="MJCF or URDF file; with --explain also a card or any scene.", metavar="MODEL"
        ),
    ],
    palm: Annotated[
        list[str] | None,
        typer.Option(
            help="Site or body that reaches for goals, one for each arm; guessed if there is none.",
            metavar="SITE|BODY",
        ),
    ] = None,
    name: Annotated[
        str, typer.Option(help="What the robot is called; by default as its file.")
    ] = "",
    out: Annotated[
        Path | None,
        typer.Option(help="Write the card here instead of printing it.", metavar="CARD.toml"),
    ] = None,
    explain: Annotated[
        bool,
        typer.Option(
            help="Put the robot into its start pose, draw problems, and report what is wrong."
        ),
    ] = False,
    draws: Annotated[int, typer.Option(min=1, help="Problems to draw for the report.")] = 30,
    force: Annotated[bool, typer.Option(help="Replace a card that is there.")] = False,
    as_json: Annotated[bool, json_flag("the report")] = False,
) -> None:
    """Read a robot's model and write its card: a TOML file to edit, and to record with.

    Examples:

        coordlog robot ur5e.xml --out ur5e.toml

        coordlog robot g1.xml --palm left_palm --palm right_palm --out g1.toml

        coordlog robot ur5e.toml --explain

        coordlog record --scene ur5e.toml
    """
    if Path(model).suffix.lower() in MODELS:
        scene = _card(Path(model), palm or [], name=name, out=out, force=force, quiet=explain)
    elif Path(model).suffix.lower() == ".xacro":
        raise ConfigError(f"{model}: a xacro; make a URDF of it: `xacro {model} > robot.urdf`")
    elif palm or out or name:
        raise ConfigError(
            f"{model}: --palm, --name and --out belong to a model, expected an MJCF or URDF file"
        )
    else:
        from coordlog.tasks.own import scene_of

        scene, explain = scene_of(model), True
    if explain:
        _explain(scene, draws=draws, as_json=as_json)


def _card(
    model: Path, palms: list[str], *, name: str, out: Path | None, force: bool, quiet: bool
) -> Scene:
    """Understand a model, and print or write its card."""
    from coordlog.robots.card import as_card
    from coordlog.sim.understand import understand
    from coordlog.tasks.scene import Scene

    found = understand(model, palms, name=name)
    folder = out.parent if out else Path()
    text = as_card(found.robot, os.path.relpath(model, folder or "."), found.notes)
    for note in found.notes:
        terminal.note(note)
    if out is not None:
        if out.exists() and not force:
            raise StorageError(f"{out}: the file exists and is not overwritten without --force")
        try:
            out.write_text(text, encoding="utf-8")
        except OSError as error:
            raise StorageError(f"{out}: cannot write the card: {error.strerror}") from error
        terminal.say(str(out))
    elif not quiet:
        for line in text.splitlines():
            terminal.say(line)
    return Scene(found.robot.name, f"Goals that {found.robot.name} can reach", found.robot)


def _explain(scene: Scene, *, draws: int, as_json: bool) -> None:
    from coordlog.sim.examine import examine

    report = examine(scene, draws=draws)
    if as_json:
        terminal.print_json(report._asdict())
    else:
        show(report, title=scene.name)
    if report.faults:
        raise typer.Exit(EXIT_CHECK_FAILED)


def show(report: Report, *, title: str) -> None:
    """A report for a person."""
    rows: list[tuple[str, object]] = [
        (f"fault {i + 1}", said) for i, said in enumerate(report.faults)
    ]
    rows += report.facts
    terminal.facts(
        rows,
        title=(
            f"\n{title}: "
            f"{'nothing is wrong' if not report.faults else f'{len(report.faults)} faults'}"
        ),
    )
