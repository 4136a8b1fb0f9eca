"""coordlog export: logs as another program's data set."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from coordlog.commands import terminal
from coordlog.commands.options import Episodes, Jobs, flag, json_flag
from coordlog.errors import EXIT_PARTIAL, ConfigError
from coordlog.exchange import FORMATS

if TYPE_CHECKING:
    from collections.abc import Callable

    from coordlog.exchange.blocks import Done
    from coordlog.exchange.source import Entry


To = Annotated[
    str,
    typer.Option(help=" or ".join(", ".join(FORMATS).rsplit(", ", 1)) + "."),
]
Where = Annotated[
    str,
    typer.Option(help="Only episodes that satisfy an SQL condition.", metavar="SQL"),
]
Camera = Annotated[
    list[str] | None,
    typer.Option(
        help='Camera of the model, or "pos=x,y,z lookat=x,y,z" [m]; again for more.',
        metavar="NAME",
    ),
]
Like = Annotated[
    Path | None,
    typer.Option(
        help="LeRobot set the episodes came from: copy it, move only its joints.",
        metavar="SOURCE",
    ),
]
SkipBroken = Annotated[
    bool, flag("--skip-broken", "Leave out files that are damaged, and name them.")
]


def export(
    path: Episodes,
    to: To,
    out: Annotated[Path, typer.Option(help="Folder of the set; it appears when it is complete.")],
    where: Where = "",
    camera: Camera = None,
    size: Annotated[str, typer.Option(help="Of the images.", metavar="WxH")] = "224x224",
    storage: Annotated[str, typer.Option(help="Of a rosbag2: mcap or sqlite3.")] = "mcap",
    like: Like = None,
    jobs: Jobs = "0",
    skip_broken: SkipBroken = False,
    force: Annotated[bool, flag("--force", "Replace what is at --out.")] = False,
    as_json: Annotated[bool, json_flag("what was done")] = False,
) -> None:
    """Write episodes as a LeRobot, Minari or robomimic data set, ROS 2 bags, Parquet or CSV.

    Every number is the log's. The same episodes give the same bytes; the same command goes on where
    an interrupted one stopped. Which row holds the final state is written down for each format.

    Exit code 3 if something was left out because it is damaged or unfinished; each is named.

    Examples:

        coordlog export logs/ --to lerobot --out sets/table --where "clean and scene = 'table'"

        coordlog export logs/ --to minari --out minari/
    """
    from coordlog.catalog.asking import chosen
    from coordlog.exchange.blocks import Options, format_of
    from coordlog.exchange.blocks import export as write
    from coordlog.exchange.source import entries
    from coordlog.record.places import require_folder

    require_folder(out)
    format_of(to)
    width, height = _size(size)
    options = Options(to, tuple(camera or ()), width, height, storage)
    watcher = terminal.Watcher()
    asked = chosen(path, where, jobs=jobs, monitor=watcher) if where else path
    found, skipped = entries(asked, skip_broken=skip_broken)
    with terminal.progress() as bar:
        task = bar.add_task(f"exporting to {to}", total=len(found), note="")

        def advance(episodes: int) -> None:
            bar.update(task, advance=episodes)

        if like is None:
            done = write(found, out, options, jobs=jobs, force=force, advance=advance)
        else:
            done = _like(found, like, out, to, force=force, advance=advance)
    if as_json:
        terminal.print_json({**done._asdict(), "out": str(out), "to": to, "skipped": skipped})
    else:
        _said(done, out, to)
    for reason in skipped:
        terminal.note(f"skipped: {reason}")
    if skipped:
        raise typer.Exit(EXIT_PARTIAL)


def _said(done: Done, out: Path, to: str) -> None:
    verb = "was there already" if done.unchanged else "written"
    resumed = f", {done.resumed} of {done.blocks} blocks resumed" if done.resumed else ""
    terminal.say(f"{out}: {done.episodes} episodes, {done.steps:,} steps as {to}, {verb}{resumed}")


def _like(
    chosen: list[Entry],
    source: Path,
    out: Path,
    to: str,
    *,
    force: bool,
    advance: Callable[[int], None],
) -> Done:
    from coordlog.exchange.lerobot_like import export_like
    from coordlog.exchange.lerobot_source import read_info

    version = read_info(source)["codebase_version"]
    wanted = "lerobot" if version == "v3.0" else "lerobot2.1"
    if to != wanted:
        raise ConfigError(f"--like {source}: a set of {version}: expected --to {wanted}, got {to}")
    return export_like(chosen, source, out, force=force, advance=advance)


def _size(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    width, height = (int(each) for each in found.groups()) if found else (0, 0)
    if not width or not height or width % 2 or height % 2:
        raise ConfigError(
            f"--size: expected two even numbers of pixels, WIDTHxHEIGHT, got '{text}'"
        )
    return width, height
