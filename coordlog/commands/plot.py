"""coordlog plot: figures for people and papers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from coordlog.commands import terminal
from coordlog.commands.options import flag
from coordlog.errors import ConfigError, SpecError

Drawn = Annotated[
    list[Path],
    typer.Argument(help="An episode file, more of the same robot pale behind it; or run folders."),
]
Out = Annotated[
    Path | None,
    typer.Option(help="File to write: .png, .pdf or .svg; by default joints.png or curves.png."),
]
Against = Annotated[
    str,
    typer.Option(help="Of runs: episodes, updates or steps; by default episodes if all are live."),
]


def plot(
    path: Drawn,
    out: Out = None,
    against: Against = "",
    force: Annotated[bool, flag("--force", "Replace the file if it exists.")] = False,
) -> None:
    """Draw an episode, or how runs learnt.

    An episode: joint angles and hand paths; of a smoothed one the knots, the spline, and p of each
    joint. Runs: score, success and clean success, mean and standard deviation over the runs that
    differ in nothing but the seed, a row of panels for each scene.

    Examples:

        coordlog plot smoothed/table-train-s0-000003-1f2e3d4c.mcap --out joints.png

        coordlog plot smoothed/NAME.mcap logs/NAME.mcap --out both.pdf

        coordlog plot runs/free-live-s0 runs/free-live-s1 runs/free-live-s2 --out curves.png
    """
    missing = [item for item in path if not item.exists()]
    if missing:
        raise ConfigError(
            f"{missing[0]}: expected an episode file or a run folder, found nothing of that name"
        )
    folders = [item for item in path if item.is_dir()]
    if folders and len(folders) < len(path):
        raise ConfigError(
            f"plot: expected episode files or run folders, got both ({folders[0]} is a folder); "
            "plot them apart"
        )
    from coordlog.view.joints import figure_path, refuse_figure

    target = figure_path(out or Path("curves.png" if folders else "joints.png"))
    refuse_figure(target, force=force)
    if against and not folders:
        raise ConfigError(f"--against: expected run folders, got the episode {path[0]}")
    import matplotlib as mpl

    with mpl.rc_context({"text.parse_math": False}):  # names out of files are no formulas
        if folders:
            _curves(folders, target, against=against, force=force)
        else:
            _joints(path, target, force=force)
    terminal.say(str(target))


def _curves(folders: list[Path], out: Path, *, against: str, force: bool) -> None:
    """The figure of some runs."""
    for folder in folders:
        if not (folder / "run.json").exists():
            raise ConfigError(
                f"{folder}: expected an episode file or a run folder, got a folder without "
                "run.json; name one file or run in it"
            )
    from coordlog.api.curves import draw_curves

    draw_curves(folders, out, against=against, force=force)


def _joints(paths: list[Path], out: Path, *, force: bool) -> None:
    """The figure of one episode, others behind it."""
    from coordlog.record.reader import read_attachments, read_episode
    from coordlog.view.joints import joints_figure, save

    first, *behind = [read_episode(item) for item in paths]
    for item, other in zip(paths[1:], behind, strict=True):
        if other.header.layout != first.header.layout or other.header.env.get(
            "action_joints"
        ) != first.header.env.get("action_joints"):
            raise SpecError(
                f"{item}: expected an episode of the same robot as {paths[0]}, got another; plot "
                "them apart"
            )
    save(joints_figure(first, read_attachments(paths[0]), behind=behind), out, force=force)
