"""The three-dimensional scene: robot and surroundings, object and goals, hand paths, contacts, balance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np
import rerun as rr

from coordlog.episode import Array
from coordlog.sim.geometry import Geom
from coordlog.view import palette
from coordlog.view.camera import hides
from coordlog.view.show import Stage
from coordlog.view.solids import ARCHETYPES, floor, poses, solids

When = Literal["always", "start", "end"]
GHOST = 0.35
"""Opacity of a ghost's robot."""
SEE_THROUGH = 0.2
"""Opacity of a panel that stands between the eye and the goals."""


def draw(stream: rr.RecordingStream, stage: Stage, eye: Array) -> None:
    """Log everything that is seen in the scene of one show; `eye` (3,) is where it will be looked at from [m]."""
    stream.log(stage.entity("world"), rr.Transform3D(translation=[0.0, stage.offset, 0.0]), static=True)
    draw_solids(stream, stage, eye)
    draw_hands(stream, stage)
    draw_contacts(stream, stage)
    if not stage.ghost:  # a ghost shares the surroundings of the show it stands in
        draw_goals(stream, stage)
        if stage.robot.soles:
            draw_balance(stream, stage)


def draw_solids(stream: rr.RecordingStream, stage: Stage, eye: Array) -> None:
    """Log every shape of the model; only the robot's move."""
    draw_shapes(stream, stage, "robot", when="always", opacity=lambda _: GHOST if stage.ghost else 1.0)
    if not stage.ghost:
        draw_floor(stream, stage)
        for place in ("world", "obstacle", "object"):
            draw_shapes(stream, stage, place, when="start", opacity=lambda geom: SEE_THROUGH if hides(geom, stage, eye) else 1.0)


def draw_start(stream: rr.RecordingStream, stage: Stage) -> None:
    """Log robot and panels as they are at the start, for good: what the paths of many episodes are drawn around."""
    draw_floor(stream, stage)
    for place in ("robot", "world"):
        draw_shapes(stream, stage, place, when="start", opacity=lambda _: GHOST)


def draw_end(stream: rr.RecordingStream, stage: Stage, eye: Array) -> None:
    """Log robot, surroundings and goals as they are at the end, at the stream's present time."""
    draw_floor(stream, stage)
    for place in ("robot", "world", "obstacle", "object"):
        draw_shapes(stream, stage, place, when="end", opacity=lambda geom: SEE_THROUGH if hides(geom, stage, eye) else 1.0)
    draw_goals(stream, stage, static=False)


def draw_shapes(stream: rr.RecordingStream, stage: Stage, place: str, *, when: When, opacity: Callable[[Geom], float]) -> None:
    """Log the shapes of one place, an entity for each kind.

    Args:
        stream: The recording.
        stage: The show.
        place: Which shapes (`Geom.place`).
        when: Their poses "always", on the show's time axis; at the "start", for good; or at the "end", at the stream's present time.
        opacity: Of each.
    """
    motion = stage.motion
    for kind, archetype in ARCHETYPES.items():
        geoms = [geom for geom in stage.geometry.of_place(place) if geom.kind == kind]
        if not geoms:
            continue
        entity, index = stage.entity("world", place, kind), [geom.index for geom in geoms]
        shape = solids(kind, geoms, [palette.rgba(geom.colour, alpha=opacity(geom)) for geom in geoms])
        rows = {"always": slice(None), "start": slice(0, 1), "end": slice(-1, None)}[when]
        pose = poses(kind, geoms, motion.position[rows, index], motion.quaternion[rows, index])
        if when == "always":
            stream.log(entity, shape, static=True)
            stream.send_columns(entity, [stage.states], archetype.columns(**pose).partition(np.full(len(motion.position), len(geoms))))
        else:
            stream.log(entity, shape, archetype.from_fields(**pose), static=when == "start")


def draw_floor(stream: rr.RecordingStream, stage: Stage) -> None:
    """Log the floor, if the scene has one."""
    if any(geom.kind == "plane" for geom in stage.geometry.geoms):
        stream.log(stage.entity("world", "floor"), floor(np.array(stage.robot.centre[:2])), static=True)


def draw_goals(stream: rr.RecordingStream, stage: Stage, *, static: bool = True) -> None:
    """Log the palm targets as wire spheres of the goal radius, in their arms' colours."""
    goals = np.array(stage.episode.header.episode["goals"])
    radius = float(stage.episode.header.env["config"]["goal_radius"])
    colours = [palette.cycle(palette.ARMS, i) for i in range(len(goals))]
    shape = rr.Ellipsoids3D(half_sizes=np.full((len(goals), 3), radius), centers=goals, colors=colours, fill_mode="majorwireframe")
    stream.log(stage.entity("world", "goal", "tolerance"), shape, static=static)
    stream.log(stage.entity("world", "goal", "centre"), rr.Points3D(goals, radii=0.006, colors=colours), static=static)


def draw_hands(stream: rr.RecordingStream, stage: Stage) -> None:
    """Log each palm as a moving dot, its executed path as a line; of a smoothed path also its knots and its spline's line."""
    palms, path, spline = stage.motion.palms, stage.episode.path, stage.spline
    for i, arm in enumerate(stage.arms):
        colour = palette.cycle(palette.ARMS, i)
        executed = palette.pale(colour) if stage.ghost else colour
        stream.log(stage.entity("world", "palm", arm), rr.Points3D.from_fields(radii=0.011, colors=executed), static=True)
        stream.send_columns(stage.entity("world", "palm", arm), [stage.states], rr.Points3D.columns(positions=palms[:, i]))
        line = rr.LineStrips3D([palms[:, i]], colors=executed, radii=0.0022)
        stream.log(stage.entity("world", "path", arm, "executed"), line, static=True)
    if path is None or spline is None:
        return
    knots = stage.geometry.palms_of(path.knot_position, path.knot_time, stage.episode)
    smooth = stage.geometry.palms_of(spline[1], spline[0], stage.episode)
    for i, arm in enumerate(stage.arms):
        colour = palette.cycle(palette.ARMS, i)
        dots = rr.Points3D(knots[:, i], radii=0.003, colors=colour)
        curve = rr.LineStrips3D([smooth[:, i]], colors=palette.bright(colour), radii=0.0032)
        stream.log(stage.entity("world", "path", arm, "knots"), dots, static=True)
        stream.log(stage.entity("world", "path", arm, "spline"), curve, static=True)


def draw_contacts(stream: rr.RecordingStream, stage: Stage) -> None:
    """Log contacts as points: large and red when they happen, small and dark for the whole episode."""
    contacts, names = stage.episode.contacts, stage.episode.header.env["geoms"]
    if not len(contacts):
        return
    place = np.stack([contacts["x"], contacts["y"], contacts["z"]], axis=1)
    labels = [f"{names[a]} – {names[b]}" for a, b in zip(contacts["geom1"], contacts["geom2"], strict=True)]
    everywhere = rr.Points3D(place, radii=0.006, colors=palette.pale(palette.BAD), labels=labels, show_labels=False)
    stream.log(stage.entity("world", "contact", "all"), everywhere, static=True)
    counts = np.bincount(contacts["step"], minlength=len(stage.episode))
    now, entity = rr.Points3D.columns(positions=place, labels=labels), stage.entity("world", "contact", "now")
    stream.log(entity, rr.Points3D.from_fields(radii=0.024, colors=palette.BAD, show_labels=True), static=True)
    stream.send_columns(entity, [stage.outcomes], now.partition(counts))


def draw_balance(stream: rr.RecordingStream, stage: Stage) -> None:
    """Log the centre of mass, its plumb line, and the support polygon, red where the step was unstable."""
    com = stage.motion.com
    ground = com * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.002]
    unstable = np.append(False, stage.episode.instability)
    colours = np.where(unstable[:, None], palette.BAD, palette.MASS).astype(np.uint8)
    points, entity = np.stack([com, ground], axis=1), stage.entity("world", "balance", "mass")
    stream.log(entity, rr.Points3D.from_fields(radii=[0.014, 0.010]), static=True)
    columns = rr.Points3D.columns(positions=points.reshape(-1, 3), colors=np.repeat(colours, 2, axis=0))
    stream.send_columns(entity, [stage.states], columns.partition([2] * len(com)))
    edge = np.where(unstable[:, None], palette.BAD, palette.GOOD).astype(np.uint8)
    plumb, outline = stage.entity("world", "balance", "plumb"), stage.entity("world", "balance", "support")
    stream.log(plumb, rr.LineStrips3D.from_fields(radii=0.0015), static=True)
    stream.send_columns(plumb, [stage.states], rr.LineStrips3D.columns(strips=points, colors=colours))
    stream.log(outline, rr.LineStrips3D.from_fields(radii=0.003), static=True)
    stream.send_columns(outline, [stage.states], rr.LineStrips3D.columns(strips=_loops(stage.motion.support()), colors=edge))


def _loops(polygons: Sequence[Array]) -> Array:
    """Closed outlines of n polygons on the floor, (c, 2) each, as one array (n, m, 3): short ones stay at their start, none is a point."""
    loops = np.zeros((len(polygons), max(map(len, polygons)) + 1, 3))
    for loop, corners in zip(loops, polygons, strict=True):
        if len(corners):
            loop[:, :2], loop[:, 2] = corners[0], 0.003
            loop[: len(corners), :2] = corners
    return loops
