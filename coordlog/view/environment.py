"""Episodes of environments that are not ours: the scene, what was done, what came of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from coordlog.view.camera import Camera, camera
from coordlog.view.draft import Draft
from coordlog.view.layout import arranged, scene, series, words
from coordlog.view.palette import ARMS, JOINTS, cycle, pale
from coordlog.view.plots import lines
from coordlog.view.scene import draw
from coordlog.view.show import Stage
from coordlog.view.text import say

EMPTY = Camera(np.array([2.0, -2.0, 2.0]), np.zeros(3))
"""Where a scene is looked at from in which nothing moves."""


def of_environment(stages: Sequence[Stage], stream: rr.RecordingStream) -> rr.RecordingStream:
    """Fill a recording with episodes that need not be of a task of ours."""
    stream.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    moving = any(stage.geometry.of_place("robot") for stage in stages)
    view, draft = camera(stages) if moving else EMPTY, Draft()
    for stage in stages:
        draw(draft, stage, view.eye)
        _plot(draft, stage, behind=stage is not stages[-1])
        say(stream, stage)
    draft.send(stream)
    plots = rrb.Vertical(
        rrb.Tabs(*(words(stage) for stage in stages), active_tab=len(stages) - 1),
        series(stages, "joints", "joint"),
        rrb.Tabs(series(stages, "reward", "reward"), series(stages, "actions", "action")),
    )
    stream.send_blueprint(
        arranged(stages, rrb.Horizontal(scene(stages, view), plots, column_shares=[3, 2]))
    )
    return stream


def _plot(draft: Draft, stage: Stage, *, behind: bool) -> None:
    """Joints, actions and rewards, pale behind another show."""
    episode, env = stage.episode, stage.episode.header.env
    suffix = f" ({stage.label})" if stage.label else ""
    joints = [(joint["name"], joint["qpos"]) for joint in env["joints"]]
    n_u = episode.action.shape[1]
    acting = env["actuators"] if len(env["actuators"]) == n_u else [str(i) for i in range(n_u)]
    curves = {
        "joint": (stage.states, episode.qpos[:, [at for _, at in joints]], JOINTS, False),
        "action": (stage.starts, episode.action, JOINTS, True),
        "reward": (stage.outcomes, episode.reward, ARMS, False),
    }
    called = {"joint": [name for name, _ in joints], "action": acting, "reward": stage.arms}
    for place, (time, values, colours, held) in curves.items():
        own = [cycle(colours, i) for i in range(values.shape[1])]
        if own:
            lines(
                draft,
                stage.entity(place),
                time,
                values,
                names=[name + suffix for name in called[place]],
                colours=[pale(colour) for colour in own] if behind else own,
                width=1.0 if behind else 2.0,
                held=held,
            )
