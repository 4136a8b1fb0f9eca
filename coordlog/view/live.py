"""A training run as it goes: figures over updates, and how the latest evaluation went.

    with Viewer() as viewer, Live("table-s0", url=viewer.url) as live:
        live.figures(1000, {"loss/critic": 0.12, "held-out/clean": 0.4})
        live.evaluation(1000, [Show(...), ...])

One timeline counts updates, so the cursor takes the scene back to any evaluation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from coordlog.errors import ConfigError, SpecError
from coordlog.view import palette
from coordlog.view.camera import Camera, camera
from coordlog.view.draft import Draft
from coordlog.view.layout import panes, space
from coordlog.view.outcome import KINDS, Outcome, about_all
from coordlog.view.recording import new_stream
from coordlog.view.scene import draw_end, draw_floor
from coordlog.view.show import Show, Stage
from coordlog.view.text import MARKDOWN

TIMELINE = "update"


class Live:
    """A recording that grows; leaving the context completes it."""

    def __init__(self, name: str, *, url: str = "", file: Path | None = None) -> None:
        """Start the recording.

        Args:
            name: Of the run.
            url: Viewer to send it to (`Viewer.url`).
            file: Where to write it; both may be given.

        Raises:
            ConfigError: if neither is given.
        """
        sinks: list[rr.GrpcSink | rr.FileSink] = [rr.GrpcSink(url)] if url else []
        sinks += [rr.FileSink(str(file))] if file is not None else []
        if not sinks:
            raise ConfigError(
                "live view: expected the address of a viewer, a file, or both, got neither"
            )
        self._stream = new_stream(name)
        self._stream.set_sinks(*sinks)
        self._panels: dict[str, list[str]] = {}
        self._camera: Camera | None = None
        self._arrange()

    def __enter__(self) -> Live:
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.flush()
        self._stream.disconnect()

    def figures(self, update: int, values: Mapping[str, float]) -> None:
        """Add a point to each curve; names are "panel/curve", and a new panel is laid out when it
        is first named.

        Raises:
            SpecError: if a name is not of two parts.
        """
        self._stream.set_time(TIMELINE, sequence=update)
        known = len(self._panels)
        for name, value in values.items():
            panel, _, curve = name.partition("/")
            if not panel or not curve or "/" in curve:
                raise SpecError(f"live view: expected a name 'panel/curve', got '{name}'")
            curves = self._panels.setdefault(panel, [])
            entity = rr.new_entity_path(["figure", panel, curve])
            if curve not in curves:
                colour = palette.cycle(palette.JOINTS, len(curves))
                curves.append(curve)
                self._stream.log(
                    entity, rr.SeriesLines(names=curve, colors=colour, widths=2.0), static=True
                )
            self._stream.log(entity, rr.Scalars(value))
        if len(self._panels) > known:
            self._arrange()

    def evaluation(self, update: int, shows: Sequence[Show]) -> None:
        """Show the hand paths of an evaluation's episodes by how they ended, and the robot at the
        end of the first that brings its model.

        Raises:
            ConfigError: without an episode.
            FormatError: if that model cannot be used.
        """
        if not shows:
            raise ConfigError(
                "live view: expected at least one episode of the evaluation, got none"
            )
        stream, outcomes = self._stream, [Outcome.of(show) for show in shows]
        stream.set_time(TIMELINE, sequence=update)
        for kind, colour in KINDS.items():
            paths = [
                outcome.palms[:, i]
                for outcome in outcomes
                if outcome.kind == kind
                for i in range(len(outcome.arms))
            ]
            lines = rr.LineStrips3D(paths, colors=colour, radii=rr.Radius.ui_points(0.8))
            stream.log(rr.new_entity_path(["world", "path", kind]), lines)
        stream.log("/about", rr.TextDocument(about_all(outcomes), media_type=MARKDOWN))
        with_model = next((show for show in shows if show.attachments), None)
        if with_model is not None:
            stage, always = Stage(with_model), Draft()
            if self._camera is None:
                self._camera = camera([stage])
                self._arrange()
                draw_floor(always, stage)
            now = Draft(rr.TimeColumn(TIMELINE, sequence=[update]))
            draw_end(now, stage, self._camera.eye)
            for draft in (always, now):
                draft.send(stream)

    def _arrange(self) -> None:
        """Lay the panels out, those of the figures known so far."""
        view = self._camera or Camera(np.array([1.4, -0.9, 1.0]), np.array([0.1, 0.0, 0.4]))
        scene = space(
            "latest evaluation: hand paths, and the robot at the end of one", view, ["+ /world/**"]
        )
        text = rrb.TextDocumentView(origin="/about", name="latest evaluation")
        plots = [
            rrb.TimeSeriesView(origin=rr.new_entity_path(["figure", panel]), name=panel)
            for panel in self._panels
        ]
        right = rrb.Vertical(*plots, text)
        panels, around = (
            rrb.Horizontal(scene, right, column_shares=[1, 1]),
            panes(timeline=TIMELINE, play="following"),
        )
        self._stream.send_blueprint(
            rrb.Blueprint(panels, *around, auto_layout=False, auto_views=False)
        )
