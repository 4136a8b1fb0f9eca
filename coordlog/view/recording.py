"""Episodes to one rerun recording, blueprint included: columns all the way, no loop over steps."""

from __future__ import annotations

import uuid
from collections.abc import Sequence

import rerun as rr

from coordlog.view.camera import camera
from coordlog.view.draft import Draft
from coordlog.view.environment import of_environment
from coordlog.view.layout import layout
from coordlog.view.plots import plot
from coordlog.view.scene import draw
from coordlog.view.show import Show, stages
from coordlog.view.text import say


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
        return of_environment(staged, new_stream(" and ".join(show.name for show in shows)))
    view = camera(staged)
    stream = new_stream(" and ".join(show.name for show in shows))
    stream.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    draft = Draft()
    for stage in staged:
        draw(draft, stage, view.eye)
        plot(draft, stage, behind=stage is not staged[-1])
        say(stream, stage)
    draft.send(stream)
    stream.send_blueprint(layout(staged, view))
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
