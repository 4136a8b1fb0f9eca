"""Layouts for other people's viewers: what plain `rerun episode.mcap` and Foxglove show of a file
without coordlog.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.components import VisualizerComponentMapping
from rerun.blueprint.encodings import ComponentSourceKind

from coordlog.episode import Json
from coordlog.spec import ARM, JOINT_STATE_TOPIC, STEP, TASK_TOPIC
from coordlog.view.layout import panes
from coordlog.view.palette import ARMS, cycle

APPLICATION = "coordlog-mcap"
"""A blueprint belongs to an application.

`rerun mcap convert --application-id` gives a file this one.
"""
TIMELINE = "message_log_time"


def plain_blueprint(arms: Sequence[str]) -> rrb.Blueprint:
    """Joint angles and speeds, and every arm's distance and reward, straight from the messages of a
    file.
    """
    distances, rewards = (_arm_series(arms, field) for field in ("distance", "reward"))
    left = rrb.Vertical(
        rrb.TimeSeriesView(origin=f"{JOINT_STATE_TOPIC}/position", name="joint angles [rad]"),
        rrb.TimeSeriesView(origin=f"{JOINT_STATE_TOPIC}/velocity", name="joint speeds [rad/s]"),
    )
    right = rrb.Vertical(
        rrb.TimeSeriesView(
            origin="/", contents=list(distances), overrides=distances, name="palm to goal [m]"
        ),
        rrb.TimeSeriesView(
            origin="/", contents=list(rewards), overrides=rewards, name="reward per step"
        ),
    )
    panels = rrb.Horizontal(left, right, column_shares=[3, 2])
    return rrb.Blueprint(
        panels, *panes(timeline=TIMELINE, play="paused"), auto_layout=False, auto_views=False
    )


def foxglove_layout(arms: Sequence[str], joints: Sequence[str], shown: Collection[str]) -> Json:
    """The same as a Foxglove layout, with the flags as lanes and the message itself.

    Args:
        arms: Names of the arms.
        joints: Names in the order of `/joint_states`.
        shown: Those whose series are switched on.
    """
    angles = [
        _path(f"{JOINT_STATE_TOPIC}.position[{i}]", name, enabled=name in shown)
        for i, name in enumerate(joints)
    ]
    flags = [f"{ARM.topic}{arm}.{flag}" for flag in ("boundary", "goal") for arm in arms]
    flags += [f"{TASK_TOPIC}reach.{flag}" for flag in ("collision", "instability")]
    panels = {
        "Plot!joints": _plot("joint angles [rad]", angles),
        "Plot!distance": _plot("palm to goal [m]", _by_arm(arms, "distance")),
        "Plot!reward": _plot("reward per step", _by_arm(arms, "reward")),
        "StateTransitions!flags": {
            "paths": [_path(value, value.removeprefix("/coordlog/")) for value in flags],
            "isSynced": True,
        },
        "RawMessages!step": {"topicPath": STEP.topic},
    }
    top = {
        "first": "Plot!distance",
        "second": "Plot!reward",
        "direction": "column",
        "splitPercentage": 50,
    }
    bottom = {
        "first": "StateTransitions!flags",
        "second": "RawMessages!step",
        "direction": "column",
        "splitPercentage": 55,
    }
    right = {"first": top, "second": bottom, "direction": "column", "splitPercentage": 55}
    layout = {"first": "Plot!joints", "second": right, "direction": "row", "splitPercentage": 55}
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": layout,
    }


def _arm_series(arms: Sequence[str], field: str) -> Mapping[Any, rrb.Visualizer]:
    """One series per arm, read out of the arm's message by the viewer."""
    message = f"{ARM.name.replace('/', '.')}:message"
    series = {}
    for i, arm in enumerate(arms):
        source = VisualizerComponentMapping(
            target="Scalars:scalars",
            source_kind=ComponentSourceKind.SourceComponent,
            source_component=message,
            selector=f".{field}",
        )
        series[ARM.topic + arm] = rr.SeriesLines(
            names=arm, colors=cycle(ARMS, i), widths=2.0
        ).visualizer(mappings=[source])
    return series


def _by_arm(arms: Sequence[str], field: str) -> list[Json]:
    colours = (
        "#" + "".join(f"{part:02x}" for part in cycle(ARMS, i)[:3]) for i in range(len(arms))
    )
    return [
        _path(f"{ARM.topic}{arm}.{field}", arm) | {"color": colour}
        for arm, colour in zip(arms, colours, strict=True)
    ]


def _path(value: str, label: str, *, enabled: bool = True) -> Json:
    return {"value": value, "label": label, "enabled": enabled, "timestampMethod": "receiveTime"}


def _plot(title: str, paths: Sequence[Json]) -> Json:
    return {
        "title": title,
        "paths": paths,
        "showLegend": True,
        "legendDisplay": "floating",
        "xAxisVal": "timestamp",
        "isSynced": True,
    }
