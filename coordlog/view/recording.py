"""Episodes to one rerun recording, blueprint included: columns all the way, no loop over steps."""

from __future__ import annotations

import uuid
from collections.abc import Sequence

import numpy as np
import rerun as rr

from coordlog.view import text
from coordlog.view.camera import camera
from coordlog.view.draft import Draft
from coordlog.view.layout import layout
from coordlog.view.plots import plot
from coordlog.view.scene import draw
from coordlog.view.show import Show, Stage, stages

FROM_ABOVE = np.array([0.0, 0.0, 10.0])
"""Where an eye is from which no panel hides anything [m]."""
MARKDOWN = "text/markdown"


def to_rerun(shows: Sequence[Show], *, ghosts: bool = False) -> rr.RecordingStream:
    """Build the recording of one or more episodes on one time axis.

    The recording waits in memory with its blueprint: `save` it, or `connect_grpc` it to a viewer.

    Args:
        shows: What to show; of several, the last is in front and the others are drawn pale in the
            plots.
        ghosts: Draw the others translucent in the place of the last instead of beside it.

    Raises:
        ConfigError: without a show, or if two have one name.
        FormatError: if a file's model is missing or cannot be used.
    """
    staged = stages(shows, ghosts=ghosts)
    if not all(stage.robot.arms for stage in staged):
        return _scene_alone(staged)
    view = camera(staged)
    stream = new_stream(" and ".join(show.name for show in shows))
    stream.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    draft = Draft()
    for stage in staged:
        draw(draft, stage, view.eye)
        plot(draft, stage, behind=stage is not staged[-1])
        about = text.about(stage.episode, file=stage.show.file)
        stream.log(stage.entity("about"), rr.TextDocument(about, media_type=MARKDOWN), static=True)
        if stage.episode.result.aborted:
            stream.log(
                stage.entity("banner"),
                rr.TextDocument(text.banner(stage.episode), media_type=MARKDOWN),
                static=True,
            )
    draft.send(stream)
    stream.send_blueprint(layout(staged, view))
    return stream


def _scene_alone(staged: Sequence[Stage]) -> rr.RecordingStream:
    """What moves, and nothing of a task: episodes of environments that are not ours."""
    stream = new_stream(" and ".join(stage.show.name for stage in staged))
    stream.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    draft = Draft()
    for stage in staged:
        draw(draft, stage, FROM_ABOVE)
    draft.send(stream)
    return stream


def new_stream(name: str) -> rr.RecordingStream:
    """An empty recording without the timelines of the clock on the wall.

    A viewer keeps one layout per application, the first it meets. Ours carry titles and an eye of
    their own, so each recording is an application of its own.
    """
    stream = rr.RecordingStream(f"coordlog-{uuid.uuid4().hex[:12]}")
    stream.set_log_tick_enabled(False)
    stream.set_log_time_enabled(False)
    stream.send_recording_name(name)
    return stream
