"""Joint angles and hand paths as a printed figure: knots as dots, the spline through them as a line
(the paper's Figure 5).
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from io import BytesIO
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from coordlog.episode import Array, Episode
from coordlog.errors import StorageError
from coordlog.kinematics.geometry import Geometry
from coordlog.path import Path as Spline
from coordlog.record.storage import PART, move_new
from coordlog.robots.robot import Robot
from coordlog.view.palette import ARMS, JOINTS, Colour, cycle

FORMATS = (".png", ".pdf", ".svg")
FINE = 8
"""A spline is drawn as this many straight lines per piece."""


def joints_figure(
    episode: Episode,
    attachments: Mapping[str, bytes],
    *,
    title: str = "",
    behind: Sequence[Episode] = (),
) -> Figure:
    """Angles of the shared joints and of each arm's own over time, and the paths of all palms in
    space.

    Knots are dots and the spline is a line, with each joint's p in the legend; the executed angles
    are dashed. An episode without a smoothed path shows its executed angles alone.

    Args:
        episode: What to draw.
        attachments: Of its file; the model among them gives the palms.
        title: Line above the figure.
        behind: Other episodes of the same robot, such as the log it was smoothed from, drawn pale.

    Raises:
        FormatError: if the model is missing or not the episode's.
    """
    robot, geometry = (
        Robot.from_json(episode.header.env["robot"]),
        Geometry.of(episode, attachments),
    )
    names, places = list(robot.action_joints), geometry.joints
    groups = {"spine": list(robot.shared)} if robot.shared else {}
    groups |= {f"{arm.name} arm": list(arm.joints) for arm in robot.arms}
    if not robot.arms:  # of an environment that is not ours: all joints there are
        joints = episode.header.env["joints"]
        names, places = (
            [each["name"] for each in joints],
            np.array([each["qpos"] for each in joints]),
        )
        groups = {"joints": names}
    figure = Figure(figsize=(13.0, 2.6 * len(groups) + 0.6), layout="constrained")
    grid = figure.add_gridspec(len(groups), 2, width_ratios=(1.55, 1.0))
    above: Axes | None = None
    for row, (group, members) in enumerate(groups.items()):
        axes = figure.add_subplot(grid[row, 0], sharex=above)
        above = above or axes
        _angles(
            axes,
            episode,
            places,
            {name: names.index(name) for name in members},
            behind=behind,
        )
        axes.set_ylabel(f"{group} [rad]")
        if row == len(groups) - 1:
            axes.set_xlabel("time [s]")
    if robot.arms:
        space = figure.add_subplot(grid[:, 1], projection="3d")
        _palms(space, episode, geometry, robot, behind=behind)
    figure.suptitle(title or _title(episode), fontsize=11)
    return figure


def figure_path(path: Path) -> Path:
    """The name that a figure is written under: a name without an ending is one of a PNG.

    Raises:
        StorageError: if the name ends in another format.
    """
    if path.suffix in ("", "."):
        return path.with_name(path.name.rstrip(".") + ".png")
    if path.suffix.lower() not in FORMATS:
        raise StorageError(
            f"{path}: expected a name that ends in .png, .pdf or .svg, got '{path.suffix}'"
        )
    return path


def save(figure: Figure, path: Path, *, force: bool = False) -> None:
    """Write a figure in the format its name ends in, at once or not at all.

    Raises:
        StorageError: if the file exists and is not to be replaced, the format is unknown, or the
            file system refuses.
    """
    path = figure_path(path)
    refuse_figure(path, force=force)
    content = BytesIO()
    figure.savefig(content, dpi=150, format=path.suffix[1:].lower())
    part = path.with_name(path.name + PART)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_bytes(content.getbuffer())
        if force:
            os.replace(part, path)
        else:
            move_new(part, path)
    except FileExistsError:
        refuse_figure(path, force=False)
    except OSError as error:
        raise StorageError(f"{path}: cannot write the figure: {error.strerror}") from error
    finally:
        with suppress(OSError):
            part.unlink()


def refuse_figure(path: Path, *, force: bool) -> None:
    """Refuse to write over what has this name, unless that is wanted.

    Raises:
        StorageError: if something has.
    """
    if os.path.lexists(path) and not force:
        raise StorageError(
            f"{path}: the file exists and is not overwritten; choose another name, or pass --force"
        )


def _angles(
    axes: Axes,
    episode: Episode,
    places: Array,
    members: Mapping[str, int],
    *,
    behind: Sequence[Episode],
) -> None:
    path, p = episode.path, _parameters(episode)
    for i, (name, joint) in enumerate(members.items()):
        colour = _rgb(cycle(JOINTS, i))
        for other in behind:
            axes.plot(
                other.time, other.qpos[:, places[joint]], color=colour, alpha=0.35, linewidth=0.8
            )
        label = name if name not in p else f"{name}   p = {p[name]:.3g}"
        executed = episode.qpos[:, places[joint]]
        if path is None:
            axes.plot(episode.time, executed, color=colour, linewidth=1.2, label=label)
            continue
        axes.plot(
            path.knot_time,
            path.knot_position[:, joint],
            ".",
            color=colour,
            markersize=2.5,
            alpha=0.6,
        )
        time = _fine(path.time)
        axes.plot(
            time,
            Spline(path.time, path.position, path.velocity)(time)[:, joint],
            color=colour,
            label=label,
        )
        axes.plot(episode.time, executed, "--", color="black", linewidth=0.6, alpha=0.6)
    axes.grid(alpha=0.25)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, frameon=False)


def _palms(
    axes: Axes, episode: Episode, geometry: Geometry, robot: Robot, *, behind: Sequence[Episode]
) -> None:
    path, shown = episode.path, geometry.palms(episode.qpos)
    for i, arm in enumerate(robot.arms):
        colour, goal = _rgb(cycle(ARMS, i)), episode.header.episode["goals"]
        for other in behind:
            axes.plot(*geometry.palms(other.qpos)[:, i].T, color=colour, alpha=0.35, linewidth=0.8)
        if path is not None:
            axes.plot(
                *geometry.palms_of(path.knot_position, path.knot_time, episode)[:, i].T,
                ".",
                color=colour,
                markersize=2.5,
                alpha=0.6,
            )
            time = _fine(path.time)
            curve = Spline(path.time, path.position, path.velocity)(time)
            axes.plot(
                *geometry.palms_of(curve, time, episode)[:, i].T,
                color=colour,
                label=f"{arm.name} palm",
            )
        else:
            axes.plot(*shown[:, i].T, color=colour, label=f"{arm.name} palm")
        if len(goal) > i:
            axes.plot(
                *np.array(goal[i])[:, None],
                marker="*",
                color=colour,
                markeredgecolor="black",
                markersize=11,
            )
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]", title="hand paths (stars: goals)")
    axes.set_aspect("equal")
    axes.locator_params(nbins=4)
    axes.tick_params(labelsize=8)
    axes.legend(loc="upper left", fontsize=8, frameon=False)


def _parameters(episode: Episode) -> dict[str, float]:
    """The paper's p of each joint, by name; empty for an episode that was not smoothed."""
    joints = (
        episode.header.lineage.get("parameters", {}).get("joints", [])
        if episode.path is not None
        else []
    )
    return {joint["name"]: float(joint["p"]) for joint in joints}


def _title(episode: Episode) -> str:
    about, result = episode.header.episode, episode.result
    ended = (
        "clean success"
        if result.clean
        else "success"
        if result.success
        else result.aborted or "no success"
    )
    made = f", {episode.header.lineage['transform']}" if episode.header.lineage["transform"] else ""
    return (
        f"{about['scene']}, {about['split']} seed {about['seed']} episode {about['index']}{made}: "
        f"{ended} after {episode.time[-1]:.2f} s"
    )


def _fine(time: Array) -> Array:
    return np.interp(np.arange((len(time) - 1) * FINE + 1) / FINE, np.arange(len(time)), time)


def _rgb(colour: Colour) -> tuple[float, float, float]:
    red, green, blue, _ = colour
    return red / 255, green / 255, blue / 255
