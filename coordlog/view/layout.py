"""How the panels are arranged, so that nothing needs to be arranged by hand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import rerun.blueprint as rrb

from coordlog.view import palette
from coordlog.view.camera import Camera
from coordlog.view.show import TIMELINE, Stage
from coordlog.view.text import title, verdict

Play = Literal["playing", "paused", "following"]
MARGIN = 0.15
"""Joint plots show this much more than the motion [rad]."""


def layout(stages: Sequence[Stage], camera: Camera) -> rrb.Blueprint:
    """Scene and flags on the left; text, joints, and distances with rewards on the right.

    A banner above for what was cut short.
    """
    plots = rrb.Vertical(
        rrb.Tabs(*(words(stage) for stage in stages), active_tab=len(stages) - 1),
        _joints(stages),
        rrb.Tabs(
            series(stages, "log10 of distance to goal [m]", "log_distance/**"),
            series(stages, "distance [m]", "distance"),
            series(stages, "reward", "reward"),
        ),
        row_shares=[4, 4, 3],
    )
    left = rrb.Vertical(scene(stages, camera), _flags(stages), row_shares=[8, 4])
    return arranged(stages, rrb.Horizontal(left, plots, column_shares=[3, 2]))


def arranged(stages: Sequence[Stage], panels: rrb.Container) -> rrb.Blueprint:
    """Panels with a banner above for what was cut short."""
    cut = [stage for stage in stages if stage.episode.result.aborted]
    if cut:
        banners = rrb.Horizontal(
            *(
                rrb.TextDocumentView(origin=stage.entity("banner"), name=stage.show.name)
                for stage in cut
            )
        )
        panels = rrb.Vertical(banners, panels, row_shares=[1, 9])
    return rrb.Blueprint(panels, *panes(), auto_layout=False, auto_views=False)


def panes(*, timeline: str = TIMELINE, play: Play = "playing") -> list[rrb.BlueprintPart]:
    """The viewer's own panes: only the time line is shown."""
    return [
        rrb.TimePanel(
            state="collapsed",
            timeline=timeline,
            play_state=play,
            loop_mode="all" if play == "playing" else "off",
        ),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.TopPanel(state="hidden"),
    ]


def space(name: str, camera: Camera, contents: Sequence[str]) -> rrb.Spatial3DView:
    """A three-dimensional view with its eye in place."""
    eye = rrb.EyeControls3D(position=camera.eye, look_target=camera.target, eye_up=[0.0, 0.0, 1.0])
    return rrb.Spatial3DView(
        origin="/",
        contents=contents,
        name=name,
        eye_controls=eye,
        line_grid=False,
        background=palette.BACKGROUND,
    )


def scene(stages: Sequence[Stage], camera: Camera) -> rrb.Spatial3DView:
    """The three-dimensional view of shows."""
    name = " | ".join(f"{stage.label}: {verdict(stage.episode)}" for stage in stages)
    if len(stages) == 1:
        name = f"{title(stages[0].episode)}: {verdict(stages[0].episode)}"
    return space(name, camera, [f"+ {stage.entity('world')}/**" for stage in stages])


def _joints(stages: Sequence[Stage]) -> rrb.Tabs:
    groups = list(dict.fromkeys(group for stage in stages for group in stage.groups))
    views = [
        series(stages, f"joints: {group}", f"joint/{group}/**", span=_span(stages, group))
        for group in groups
    ]
    return rrb.Tabs(
        *views, series(stages, "actions", "action/**"), active_tab=min(1, len(groups) - 1)
    )


def _flags(stages: Sequence[Stage]) -> rrb.Tabs:
    views = [
        rrb.StateTimelineView(origin=stage.entity("flag"), name=f"flags {stage.label}".strip())
        for stage in stages
    ]
    return rrb.Tabs(*views, active_tab=len(views) - 1)


def words(stage: Stage) -> rrb.TextDocumentView:
    """What a show says about itself."""
    return rrb.TextDocumentView(origin=stage.entity("about"), name=stage.label or stage.show.name)


def series(
    stages: Sequence[Stage], name: str, entities: str, *, span: tuple[float, float] | None = None
) -> rrb.TimeSeriesView:
    """Curves of shows by the names of their entities."""
    contents = [f"+ {stage.root}/{entities}" for stage in stages]
    axis = None if span is None else rrb.ScalarAxis(range=span)
    return rrb.TimeSeriesView(origin="/", contents=contents, name=name, axis_y=axis)


def _span(stages: Sequence[Stage], group: str) -> tuple[float, float]:
    """A range that shows how the joints move and were to move.

    Their limits come into it when they are near.
    """
    angles = []
    for stage in stages:
        index, path = stage.groups.get(group, []), stage.episode.path
        angles += [stage.episode.qpos[:, stage.geometry.joints[index]].ravel()] if index else []
        angles += (
            [path.knot_position[:, index].ravel(), path.position[:, index].ravel()]
            if path is not None
            else []
        )
    every = np.concatenate(angles)
    return float(np.nanmin(every)) - MARGIN, float(np.nanmax(every)) + MARGIN
