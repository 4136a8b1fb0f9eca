"""The time series: joint angles with limits, knots and spline; actions, rewards, distances; flags
as lanes.

What an action led to is drawn at the time of the state it led to. Several shows share a plot: all
but the last are drawn pale.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from coordlog.episode import Array
from coordlog.view.draft import Draft
from coordlog.view.palette import (
    ARMS,
    BAD,
    EXECUTED,
    FAIR,
    GOOD,
    JOINTS,
    Colour,
    bright,
    cycle,
    pale,
)
from coordlog.view.show import Stage, clock

NEAREST = 1e-4
"""Distances below this [m] are drawn as this: a logarithm has no zero."""
NOT = "no"
"""State of a flag that is down; its lane is empty then."""


def plot(draft: Draft, stage: Stage, *, behind: bool = False) -> None:
    """Log every time series of one show.

    `behind` draws it pale and thin, because another show is the one to look at.
    """
    suffix = f" ({stage.label})" if stage.label else ""
    for group, index in stage.groups.items():
        plot_joints(draft, stage, group, index, behind=behind, suffix=suffix)
    if stage.episode.has("distance"):  # an observed episode has no goals
        plot_outcomes(draft, stage, behind=behind, suffix=suffix)
        plot_flags(draft, stage)


def plot_joints(
    draft: Draft, stage: Stage, group: str, index: list[int], *, behind: bool, suffix: str
) -> None:
    """Log the angles of one group of joints, their limits, the path they were to follow, and their
    actions.

    Series of one joint have one name, so that the legend stays short and switches all of them.
    """
    episode = stage.episode
    names = [stage.robot.action_joints[i] + suffix for i in index]
    own = [cycle(JOINTS, i) for i in range(len(index))]
    colours, width = ([pale(colour) for colour in own], 1.0) if behind else (own, 2.0)
    angles = episode.qpos[:, stage.geometry.joints[index]]
    lines(
        draft,
        stage.entity("joint", group, "executed"),
        stage.states,
        angles,
        names=names,
        colours=colours,
        width=width,
    )
    lines(
        draft,
        stage.entity("action", group),
        stage.starts,
        episode.action[:, index],
        names=names,
        colours=colours,
        width=1.0,
        held=True,
    )
    if not behind:
        _plot_limits(draft, stage, group, index, names)
    _plot_spline(draft, stage, group, index, names)


def _plot_limits(
    draft: Draft, stage: Stage, group: str, index: list[int], names: list[str]
) -> None:
    """Log the low and the high limit of each joint, faintly."""
    lines(
        draft,
        stage.entity("joint", group, "limits"),
        clock(stage.episode.time[[0, -1]]),
        np.tile(stage.geometry.limits[index].ravel(), (2, 1)),
        names=[name for name in names for _ in "lh"],
        colours=[pale(cycle(JOINTS, i), 0.45) for i in range(len(index)) for _ in "lh"],
        width=0.6,
    )


def _plot_spline(
    draft: Draft, stage: Stage, group: str, index: list[int], names: list[str]
) -> None:
    """Log the path that was to be followed, and its knots, where there is one."""
    path, spline = stage.episode.path, stage.spline
    if path is None or spline is None:
        return
    time, position = spline
    own = [cycle(JOINTS, i) for i in range(len(index))]
    lines(
        draft,
        stage.entity("joint", group, "spline"),
        clock(time),
        position[:, index],
        names=names,
        colours=[bright(colour, 0.4) for colour in own],
        width=2.0,
    )
    knots, sizes = stage.entity("joint", group, "knots"), np.full(len(own), 2.5, np.float32)
    diamonds = [rr.components.MarkerShape.Diamond] * len(own)
    draft.log(knots, rr.SeriesPoints, colors=own, markers=diamonds, marker_sizes=sizes, names=names)
    values = path.knot_position[:, index]
    draft.columns(knots, clock(path.knot_time), rr.Scalars, len(index), scalars=values.ravel())


def plot_outcomes(draft: Draft, stage: Stage, *, behind: bool, suffix: str) -> None:
    """Log reward and distance of each arm, with the radii that count."""
    episode, config = stage.episode, stage.episode.header.env["config"]
    names = [arm + suffix for arm in stage.arms]
    own = [cycle(ARMS, i) for i in range(len(stage.arms))]
    colours, width = ([pale(colour) for colour in own], 1.0) if behind else (own, 2.0)
    logarithm = np.log10(np.maximum(episode.distance, NEAREST))
    curves = {
        ("reward",): episode.reward,
        ("distance",): episode.distance,
        ("log_distance", "palm"): logarithm,
    }
    for place, values in curves.items():
        lines(
            draft,
            stage.entity(*place),
            stage.outcomes,
            values,
            names=names,
            colours=colours,
            width=width,
        )
    if behind:
        return
    ends = clock(episode.time[[0, -1]])
    for name, colour in (("boundary", FAIR), ("goal", GOOD)):
        radius = float(config[f"{name}_radius"])
        level, named = np.full((2, 1), np.log10(radius)), [f"{name} {radius:g} m"]
        lines(
            draft,
            stage.entity("log_distance", name),
            ends,
            level,
            names=named,
            colours=[colour],
            width=1.0,
        )


def plot_flags(draft: Draft, stage: Stage) -> None:
    """Log each flag as a lane that is coloured while the flag is up."""
    episode = stage.episode
    lanes: dict[str, tuple[Array, Colour]] = {
        "collision": (episode.collision, BAD),
        "instability": (episode.instability, BAD),
    }
    for i, arm in enumerate(stage.arms):
        lanes |= {
            f"boundary_{arm}": (episode.boundary[:, i], FAIR),
            f"goal_{arm}": (episode.goal[:, i], GOOD),
        }
    # The last flag is held for one period more, or the one that ended the episode would have no
    # width.
    time = np.append(
        episode.time, episode.time[-1] + float(episode.header.episode["control_period"])
    )
    for name, (flag, colour) in lanes.items():
        entity, word = stage.entity("flag", name), name.split("_")[0]
        up = np.concatenate([[False], flag, [False]])
        change = np.flatnonzero(np.diff(up, prepend=~up[:1]))
        draft.log(
            entity,
            rr.StateConfiguration,
            values=[word, NOT],
            colors=[colour, EXECUTED],
            visible=[True, False],
        )
        draft.columns(
            entity,
            clock(time[change]),
            rr.StateChange,
            state=[word if up[i] else NOT for i in change],
        )


def lines(
    draft: Draft,
    entity: str,
    time: rr.TimeColumn,
    values: Array,
    *,
    names: Sequence[str],
    colours: Sequence[Colour],
    width: float,
    held: bool = False,
) -> None:
    """Log the columns of `values` (n, s) as s series of one entity.

    `held` draws them as steps instead of straight lines.
    """
    mode = (
        rr.components.InterpolationMode.StepAfter
        if held
        else rr.components.InterpolationMode.Linear
    )
    widths = np.full(len(names), width, dtype=np.float32)
    draft.log(
        entity,
        rr.SeriesLines,
        names=names,
        colors=colours,
        widths=widths,
        interpolation_mode=[mode],
    )
    draft.columns(entity, time, rr.Scalars, len(names), scalars=values.ravel())
