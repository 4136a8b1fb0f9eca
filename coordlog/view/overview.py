"""A folder of episodes as one recording: which succeeded, where the hands went, how far off they
ended, which to open next.

The time line counts episodes: the cursor picks one, whose hand paths are drawn bold and whose
summary stands beside the scene.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import rerun as rr

from coordlog.episode import Array
from coordlog.errors import ConfigError
from coordlog.view import palette
from coordlog.view.camera import AROUND
from coordlog.view.draft import Draft
from coordlog.view.outcome import KINDS, Outcome, about_all, about_one, by_urgency
from coordlog.view.overview_layout import RANK, TIMELINE, overview_layout
from coordlog.view.plots import lines
from coordlog.view.recording import new_stream
from coordlog.view.scene import draw_start
from coordlog.view.show import Show, Stage
from coordlog.view.text import MARKDOWN

WINDOW = 50
"""Rates are running means over this many episodes."""
BIN = 0.005
"""Width of the histogram's bins [m]."""
FARTHEST = 0.60
"""Final distances beyond this are counted in the last bin [m]; it ends nearer if they all do."""


def to_overview(shows: Iterable[Show]) -> rr.RecordingStream:
    """Build the overview of many episodes; one is held in memory at a time, so `shows` may be a
    generator.

    The robot is drawn once, as it stands at the start of the first episode that comes with its
    model; all others need no attachments. The recording waits in memory with its blueprint: `save`
    it, or `connect_grpc` it to a viewer.

    Raises:
        ConfigError: without a show.
        FormatError: if the first model cannot be used.
    """
    outcomes: list[Outcome] = []
    stage: Stage | None = None
    for show in shows:
        outcomes.append(Outcome.of(show))
        if stage is None and show.attachments:
            stage = Stage(show)
    if not outcomes:
        raise ConfigError("overview: expected at least one episode, got none")
    stream = new_stream(f"{len(outcomes)} episodes")
    stream.log("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    if stage is not None:
        draft = Draft()
        draw_start(draft, stage)
        draft.send(stream)
    draw_paths(stream, outcomes)
    draw_cursor(stream, outcomes)
    plot_rates(stream, outcomes)
    log_table(stream, outcomes)
    stream.log("/about", rr.TextDocument(about_all(outcomes), media_type=MARKDOWN), static=True)
    texts = rr.TextDocument.columns(
        text=[about_one(outcome) for outcome in outcomes], media_type=[MARKDOWN] * len(outcomes)
    )
    stream.send_columns("/episode", [_numbers(outcomes)], texts)
    seen = [np.zeros((1, 3)), *(outcome.palms.reshape(-1, 3) for outcome in outcomes)]
    if stage is not None:  # with room around the joints' middles, or the head would be cut off
        robot = stage.motion.position[0, [geom.index for geom in stage.geometry.of_place("robot")]]
        seen += [robot - AROUND, robot + AROUND]
    stream.send_blueprint(overview_layout(np.concatenate(seen)))
    return stream


def draw_paths(stream: rr.RecordingStream, outcomes: Sequence[Outcome]) -> None:
    """Log the hand paths of all episodes as thin lines, one entity per scene and way of ending."""
    groups: dict[tuple[str, str], list[Array]] = {}
    for outcome in outcomes:
        paths = [outcome.palms[:, i] for i in range(len(outcome.arms))]
        groups.setdefault((outcome.scene, outcome.kind), []).extend(paths)
    for (scene, kind), paths in groups.items():
        if not paths:
            continue
        entity = "/".join(
            ["/world/paths", rr.escape_entity_path_part(scene), rr.escape_entity_path_part(kind)]
        )
        quiet = palette.pale(KINDS[kind], 0.5 if kind == "clean success" else 0.0)
        stream.log(
            entity,
            rr.LineStrips3D(paths, colors=quiet, radii=rr.Radius.ui_points(0.5)),
            static=True,
        )


def draw_cursor(stream: rr.RecordingStream, outcomes: Sequence[Outcome]) -> None:
    """Log the hand paths and goals of the episode under the cursor."""
    time = [_numbers(outcomes)]
    counts = np.array([len(outcome.arms) for outcome in outcomes])
    colours = np.array(
        [palette.cycle(palette.ARMS, i) for count in counts for i in range(count)], dtype=np.uint8
    )
    paths = [outcome.palms[:, i] for outcome in outcomes for i in range(len(outcome.arms))]
    stream.log("/world/cursor/path", rr.LineStrips3D.from_fields(radii=0.0045), static=True)
    stream.send_columns(
        "/world/cursor/path",
        time,
        rr.LineStrips3D.columns(strips=paths, colors=colours).partition(counts),
    )
    goals = np.concatenate([outcome.goals for outcome in outcomes])
    stream.log("/world/cursor/goal", rr.Points3D.from_fields(radii=0.012), static=True)
    stream.send_columns(
        "/world/cursor/goal",
        time,
        rr.Points3D.columns(positions=goals, colors=colours).partition(counts),
    )


def plot_rates(stream: rr.RecordingStream, outcomes: Sequence[Outcome]) -> None:
    """Log how each episode ended as lanes, running rates, final distances by episode and their
    histogram.
    """
    time = _numbers(outcomes)
    kinds = np.array([outcome.kind for outcome in outcomes])
    look = rr.StateConfiguration(values=list(KINDS), colors=list(KINDS.values()))
    stream.log("/lane/result", look, static=True)
    stream.send_columns("/lane/result", [time], rr.StateChange.columns(state=kinds.tolist()))
    touched = np.array([outcome.collisions > 0 for outcome in outcomes])
    look = rr.StateConfiguration(
        values=["collision", "no"], colors=[palette.BAD, palette.EXECUTED], visible=[True, False]
    )
    stream.log("/lane/collision", look, static=True)
    stream.send_columns(
        "/lane/collision",
        [time],
        rr.StateChange.columns(state=np.where(touched, "collision", "no").tolist()),
    )
    succeeded = np.array(
        [outcome.kind in ("clean success", "success with collision") for outcome in outcomes]
    )
    rates = np.stack(
        [running(column) for column in (kinds == "clean success", succeeded, touched)], axis=1
    )
    names, colours = (
        ["clean success", "success", "collision"],
        [palette.GOOD, palette.FAIR, palette.BAD],
    )
    draft = Draft()
    lines(draft, "/rate", time, rates, names=names, colours=colours, width=2.0)
    draft.send(stream)
    worst = np.array([outcome.worst for outcome in outcomes])
    marks = rr.SeriesPoints(
        colors=[palette.JOINTS[0]], markers=["circle"], marker_sizes=[2.0], names=["farther palm"]
    )
    stream.log("/final", marks, static=True)
    stream.send_columns("/final", [time], rr.Scalars.columns(scalars=100.0 * worst))
    finite = np.minimum(worst[np.isfinite(worst)], FARTHEST - BIN / 2)
    edges = np.arange(0.0, finite.max(initial=0.0) + 2 * BIN, BIN)
    counts, _ = np.histogram(finite, bins=edges)
    widths = np.full(len(counts), 100.0 * BIN)
    bars = rr.BarChart(
        counts, color=palette.JOINTS[0], abscissa=100.0 * (edges[:-1] + BIN / 2), widths=widths
    )
    stream.log("/histogram", bars, static=True)


def log_table(stream: rr.RecordingStream, outcomes: Sequence[Outcome]) -> None:
    """Log one row per episode for the table view, those to look at first on top."""
    order = by_urgency(outcomes)
    ranked = [outcomes[i] for i in order]
    columns = rr.AnyValues.columns(
        episode=order,
        ended_as=[outcome.kind for outcome in ranked],
        seconds=[outcome.seconds for outcome in ranked],
        final_cm=[round(100.0 * outcome.worst, 2) for outcome in ranked],
        collision_steps=[outcome.collisions for outcome in ranked],
        total_return=[float(outcome.returns.sum()) for outcome in ranked],
        scene=[outcome.scene for outcome in ranked],
        policy=[outcome.policy for outcome in ranked],
        file=[outcome.file for outcome in ranked],
    )
    stream.send_columns("/table", [rr.TimeColumn(RANK, sequence=np.arange(len(order)))], columns)


def _numbers(outcomes: Sequence[Outcome]) -> rr.TimeColumn:
    return rr.TimeColumn(TIMELINE, sequence=np.arange(len(outcomes)))


def running(flags: Array) -> Array:
    """Mean of the last WINDOW values, (n,)."""
    total = np.concatenate([[0.0], np.cumsum(flags, dtype=float)])
    last = np.arange(1, len(flags) + 1)
    first = np.maximum(last - WINDOW, 0)
    return np.asarray((total[last] - total[first]) / (last - first))
