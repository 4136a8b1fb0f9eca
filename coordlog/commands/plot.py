"""coordlog plot: figures for people and papers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from coordlog.commands import terminal
from coordlog.errors import ConfigError, SpecError


def plot(
    path: Annotated[list[Path], typer.Argument(help="An episode file; more of the same robot are drawn pale behind it.")],
    out: Annotated[Path, typer.Option(help="File to write: .png, .pdf or .svg.")] = Path("joints.png"),
    force: Annotated[bool, typer.Option("--force", help="Replace the file if it exists.")] = False,
) -> None:
    """Draw joint angles and hand paths of an episode; of a smoothed one the knots, the spline, and p of each joint.

    Examples:

        coordlog plot smoothed/table-train-s0-000003-1f2e3d4c.mcap --out joints.png

        coordlog plot smoothed/NAME.mcap logs/NAME.mcap --out both.pdf
    """
    folders = [item for item in path if item.is_dir()]
    if folders:
        raise ConfigError(f"{folders[0]}: expected an episode file, got a folder; name one file in it")
    _joints(path, out, force=force)
    terminal.out.print(str(out), highlight=False, markup=False, soft_wrap=True)


def _joints(paths: list[Path], out: Path, *, force: bool) -> None:
    """The figure of one episode, others behind it."""
    from coordlog.record.reader import read_attachments, read_episode
    from coordlog.view.joints import joints_figure, save

    first, *behind = [read_episode(item) for item in paths]
    for item, other in zip(paths[1:], behind, strict=True):
        if other.header.layout != first.header.layout or other.header.env["action_joints"] != first.header.env["action_joints"]:
            raise SpecError(f"{item}: expected an episode of the same robot as {paths[0]}, got another; plot them apart")
    save(joints_figure(first, read_attachments(paths[0]), behind=behind), out, force=force)
