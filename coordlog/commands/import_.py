"""coordlog import: other programs' recordings as observed episodes."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from coordlog.commands import terminal
from coordlog.commands.options import Jobs, chosen, flag, json_flag
from coordlog.errors import EXIT_INTERRUPTED, EXIT_PARTIAL, ConfigError
from coordlog.parallel import mapped

if TYPE_CHECKING:
    from coordlog.exchange.importing import Imported, Plan, Understood
    from coordlog.exchange.robot_model import RobotModel

SAID = 12
"""Notes that are printed; --json has all."""


Sources = Annotated[
    list[Path],
    typer.Argument(
        help=(
            "ROS 2 bag (folder, .mcap, .db3), LeRobot or Minari folder, .mcap, .hdf5, "
            ".parquet, .csv."
        )
    ),
]
Out = Annotated[
    Path | None, typer.Option(help="Folder for the episodes; not needed with --inspect.")
]
Robot = Annotated[
    str, typer.Option(help="MJCF or URDF file, or one of our scenes.", metavar="MODEL")
]
Joints = Annotated[
    Path | None,
    typer.Option(help="Joint names, scales and offsets, in TOML.", metavar="MAP.toml"),
]
Stamps = Annotated[str, typer.Option(help="Clock of a bag: header or log; by default header.")]
State = Annotated[
    str, typer.Option(help="Feature or data set with the joint positions.", metavar="KEY")
]
Action = Annotated[
    str, typer.Option(help="LeRobot feature with the commanded positions.", metavar="KEY")
]
Columns = Annotated[
    str, typer.Option(help="Columns of a table with joint positions.", metavar="A,B,…")
]
Clock = Annotated[str, typer.Option(help="Column of a table with the time.", metavar="COLUMN")]
Names = Annotated[
    str, typer.Option(help="Names of the joints, where the source has none.", metavar="A,B,…")
]
NamesField = Annotated[
    str, typer.Option(help="Field of a JSON or protobuf message with the joint names.")
]
PositionField = Annotated[
    str, typer.Option(help="Field of a JSON or protobuf message with the positions.")
]
Rate = Annotated[
    float, typer.Option(min=0, help="Samples a second, where there is no clock.", metavar="HZ")
]
Degrees = Annotated[bool, flag("--degrees", "Angles are in degrees: turn them into radians.")]
Gap = Annotated[
    float | None,
    typer.Option(min=0, help="Begin an episode after a gap this long.", metavar="S"),
]
SplitTopic = Annotated[str, typer.Option(help="Begin an episode at every message on this topic.")]
SplitClock = Annotated[bool, flag("--split-clock", "Begin an episode where time steps back.")]
Resample = Annotated[
    float,
    typer.Option(min=0, help="Even samples, by straight lines; said in the lineage.", metavar="HZ"),
]


def import_(
    source: Sources,
    out: Out = None,
    robot: Robot = "",
    joints: Joints = None,
    inspect: Annotated[bool, flag("--inspect", "Show what is understood; write nothing.")] = False,
    topic: Annotated[str, typer.Option(help="Topic of a bag or MCAP.")] = "",
    stamps: Stamps = "",
    state: State = "",
    action: Action = "",
    columns: Columns = "",
    clock: Clock = "",
    names: Names = "",
    names_field: NamesField = "",
    position_field: PositionField = "",
    rate: Rate = 0.0,
    degrees: Degrees = False,
    gap: Gap = None,
    split_topic: SplitTopic = "",
    split_clock: SplitClock = False,
    resample: Resample = 0.0,
    force: Annotated[bool, flag("--force", "Write episodes that are there again.")] = False,
    jobs: Jobs = "0",
    as_json: Annotated[bool, json_flag("the report")] = False,
) -> None:
    """Turn recordings of other programs into observed episodes: seen, not simulated.

    Stamps stay as they were; jitter, gaps and repeated stamps are reported for each file. What the
    source does not say has to be said here, and what was done stands in the lineage, with the
    source's sha256. Smooth them, look at them, export them as any other episode.

    Exit code 3 if a part of a source could not become an episode; each is named.

    Examples:

        coordlog import rosbag/ --out logs/ --robot arm.xml --inspect

        coordlog import rosbag/ --out logs/ --robot arm.xml --gap 0.3
    """
    from coordlog.exchange.importing import Plan
    from coordlog.exchange.joints import JointMap, read_map
    from coordlog.exchange.sources import Reading
    from coordlog.record.places import require_folder

    listed = {"columns": _listed(columns), "names": _listed(names)}
    reading = chosen(Reading, locals() | listed)
    given = read_map(joints) if joints else JointMap()
    plan = Plan(reading, given, gap, split_topic, split_clock, resample)
    model = _model(robot)
    if inspect:
        _inspect(source, plan, model, as_json=as_json)
        return
    if out is None:
        raise ConfigError(
            "--out: expected a folder for the episodes, or --inspect to write nothing"
        )
    require_folder(out)
    _import(source, out, plan, model, force=force, jobs=jobs, as_json=as_json)


def _listed(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(",") if part.strip())


def _model(robot: str) -> RobotModel | None:
    if not robot:
        return None
    from coordlog.exchange.robot_model import read_model

    return read_model(robot)


def _inspect(source: list[Path], plan: Plan, model: RobotModel | None, *, as_json: bool) -> None:
    from coordlog.exchange.importing import understood

    found = [each for path in source for each in understood(path, plan, model)]
    if as_json:
        terminal.print_json([each.to_json() for each in found])
        return
    for each in found[:SAID]:
        _show(each)
    if len(found) > SAID:
        terminal.note(f"{len(found) - SAID} more episodes; --json has them all")


def _show(each: Understood) -> None:
    motion = each.motion
    joints = [
        name if name == given else f"{name} ({given})"
        for name, given in zip(motion.names, each.source_joints, strict=False)
    ]
    if len(motion.names) != len(each.source_joints):
        joints = list(motion.names)
    pairs: list[tuple[str, object]] = [
        ("format", motion.format),
        ("clock", f"{motion.clock}: {motion.timing}"),
        ("joints", ", ".join(joints)),
        ("velocity", "of the source" if motion.velocity is not None else "differences"),
        ("action", "of the source" if motion.action is not None else "the position reached next"),
    ]
    if motion.task:
        pairs.append(("task", motion.task))
    terminal.facts(pairs, title=str(motion))
    for said in (*motion.notes, *each.doubts):
        terminal.note(f"  {said}")


def _import(
    source: list[Path],
    out: Path,
    plan: Plan,
    model: RobotModel | None,
    *,
    force: bool,
    jobs: str,
    as_json: bool,
) -> None:
    from coordlog.catalog.asking import catalogued
    from coordlog.exchange.importing import import_source

    done: list[Imported] = []
    one = partial(import_source, out=out, plan=plan, robot=model, force=force)
    with terminal.progress() as bar, terminal.interruptible() as interrupted:
        task = bar.add_task("importing", total=len(source), note="")
        for each in mapped(one, source, jobs=jobs):
            done.append(each)
            bar.update(task, advance=1, note=f"{sum(len(each.paths) for each in done)} episodes")
            if interrupted:
                break
    catalogued(out, [path for each in done for path in each.paths])
    if as_json:
        terminal.print_json([_report(each) for each in done])
    else:
        for each in done:
            _said(each)
    if interrupted:
        terminal.note(f"interrupted after {len(done)} of {len(source)} sources")
        raise typer.Exit(EXIT_INTERRUPTED)
    if any(each.left_out for each in done):
        raise typer.Exit(EXIT_PARTIAL)


def _report(each: Imported) -> dict[str, object]:
    return {
        "source": str(each.source),
        "episodes": [str(path) for path in each.paths],
        "steps": each.steps,
        "present": each.present,
        "left_out": list(each.left_out),
        "understood": [item.to_json() for item in each.understood],
    }


def _said(each: Imported) -> None:
    there = f" ({each.present} were there already)" if each.present else ""
    terminal.say(
        f"{each.source}: {len(each.paths)} observed episodes{there}, {each.steps:,} steps",
    )
    notes: dict[str, int] = {}
    for item in each.understood:
        for said in (*item.motion.notes, *item.doubts):
            notes[said] = notes.get(said, 0) + 1
    for said, count in list(notes.items())[:SAID]:
        terminal.note(f"  {said}" + (f" ({count} episodes)" if count > 1 else ""))
    if len(notes) > SAID:
        terminal.note(f"  {len(notes) - SAID} more notes; --json has them all")
    clocks = [str(item.motion.timing) for item in each.understood]
    for said in clocks[:3]:
        terminal.note(f"  clock: {said}")
    for reason in each.left_out:
        terminal.note(f"left out: {reason}")
