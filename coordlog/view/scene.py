"""The three-dimensional scene: robot and surroundings, object and goals, hand paths, contacts,
balance.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np
import rerun as rr

from coordlog.episode import Array
from coordlog.kinematics.geometry import Geom
from coordlog.view import palette
from coordlog.view.camera import hides
from coordlog.view.draft import Draft
from coordlog.view.palette import Colour
from coordlog.view.show import Stage
from coordlog.view.solids import ARCHETYPES, floor, normals, poses, solids

When = Literal["always", "start", "end"]
GHOST = 0.35
"""Opacity of a ghost's robot."""
SEE_THROUGH = 0.2
"""Opacity of a panel that stands between the eye and the goals."""


def draw(draft: Draft, stage: Stage, eye: Array) -> None:
    """Log everything that is seen in the scene of one show.

    `eye` (3,) is where it will be looked at from [m].
    """
    draft.log(
        stage.entity("world"), rr.Transform3D, translation=np.array([[0.0, stage.offset, 0.0]])
    )
    draw_solids(draft, stage, eye)
    draw_hands(draft, stage)
    draw_contacts(draft, stage)
    if not stage.ghost:  # a ghost shares the surroundings of the show it stands in
        draw_goals(draft, stage)
        if stage.robot.soles:
            draw_balance(draft, stage)


ROWS: dict[str, slice] = {"always": slice(None), "start": slice(0, 1), "end": slice(-1, None)}
"""Of a motion, the configurations that are drawn."""


def draw_solids(draft: Draft, stage: Stage, eye: Array) -> None:
    """Log every shape of the model; only the robot's move."""
    draw_shapes(
        draft, stage, "robot", when="always", opacity=lambda _: GHOST if stage.ghost else 1.0
    )
    if not stage.ghost:
        draw_floor(draft, stage)
        for place in ("world", "obstacle", "object"):
            draw_shapes(
                draft,
                stage,
                place,
                when="start",
                opacity=lambda geom: SEE_THROUGH if hides(geom, stage, eye) else 1.0,
            )


def draw_start(draft: Draft, stage: Stage) -> None:
    """Log robot and panels as they are at the start, for good: what the paths of many episodes are
    drawn around.
    """
    draw_floor(draft, stage)
    for place in ("robot", "world"):
        draw_shapes(draft, stage, place, when="start", opacity=lambda _: GHOST)


def draw_end(draft: Draft, stage: Stage, eye: Array) -> None:
    """Log robot, surroundings and goals as they are at the end; the floor is not among them."""
    for place in ("robot", "world", "obstacle", "object"):
        draw_shapes(
            draft,
            stage,
            place,
            when="end",
            opacity=lambda geom: SEE_THROUGH if hides(geom, stage, eye) else 1.0,
        )
    draw_goals(draft, stage)


def draw_shapes(
    draft: Draft, stage: Stage, place: str, *, when: When, opacity: Callable[[Geom], float]
) -> None:
    """Log the shapes of one place, an entity for each kind.

    Args:
        draft: The recording in the making.
        stage: The show.
        place: Which shapes (`Geom.place`).
        when: Their poses "always", on the show's time axis; or those of the "start" or the "end",
            when the draft is.
        opacity: Of each.
    """
    motion = stage.motion
    for kind, archetype in ARCHETYPES.items():
        geoms = [geom for geom in stage.geometry.of_place(place) if geom.kind == kind]
        if not geoms:
            continue
        entity, index = stage.entity("world", place, kind), [geom.index for geom in geoms]
        shape = solids(
            kind, geoms, [palette.rgba(geom.colour, alpha=opacity(geom)) for geom in geoms]
        )
        rows = ROWS[when]
        pose = poses(kind, geoms, motion.position[rows, index], motion.quaternion[rows, index])
        if when == "always":
            draft.log(entity, archetype, **shape)
            draft.columns(entity, stage.states, archetype, len(geoms), **pose)
        else:
            draft.log(entity, archetype, **shape, **pose)
    for geom in stage.geometry.of_place(place):
        if geom.mesh is not None:
            colour = palette.rgba(geom.colour, alpha=opacity(geom))
            _draw_mesh(draft, stage, geom, place, when=when, colour=colour)


def _draw_mesh(
    draft: Draft, stage: Stage, geom: Geom, place: str, *, when: When, colour: Colour
) -> None:
    entity, motion = stage.entity("world", place, "mesh", str(geom.index)), stage.motion
    vertices, triangles = geom.mesh or (np.zeros((0, 3)), np.zeros((0, 3)))
    colours = np.tile(np.array(colour, dtype=np.uint8), (len(vertices), 1))
    outward = normals(vertices, triangles)  # without them the viewer lights nothing
    draft.log(
        entity,
        rr.Mesh3D,
        vertex_positions=vertices,
        triangle_indices=triangles.astype(np.uint32),
        vertex_normals=outward,
        vertex_colors=colours,
    )
    rows = ROWS[when]
    pose = poses(
        "mesh", [geom], motion.position[rows, geom.index], motion.quaternion[rows, geom.index]
    )
    if when == "always":
        draft.columns(entity, stage.states, rr.InstancePoses3D, 1, **pose)
    else:
        draft.log(entity, rr.InstancePoses3D, **pose)


def draw_floor(draft: Draft, stage: Stage) -> None:
    """Log the floor, if the scene has one."""
    if any(geom.kind == "plane" for geom in stage.geometry.geoms):
        draft.log(
            stage.entity("world", "floor"), rr.Mesh3D, **floor(np.array(stage.robot.centre[:2]))
        )


def draw_goals(draft: Draft, stage: Stage) -> None:
    """Log the palm targets as wire spheres of the goal radius, in their arms' colours."""
    goals = np.array(stage.episode.header.episode["goals"])
    if not len(goals):  # of an environment that is not ours
        return
    radius = float(stage.episode.header.env["config"]["goal_radius"])
    colours = [palette.cycle(palette.ARMS, i) for i in range(len(goals))]
    wire, sizes = [rr.components.FillMode.MajorWireframe], np.full((len(goals), 3), radius)
    draft.log(
        stage.entity("world", "goal", "tolerance"),
        rr.Ellipsoids3D,
        half_sizes=sizes,
        centers=goals,
        colors=colours,
        fill_mode=wire,
    )
    draft.log(
        stage.entity("world", "goal", "centre"),
        rr.Points3D,
        positions=goals,
        radii=0.006,
        colors=colours,
    )


def draw_hands(draft: Draft, stage: Stage) -> None:
    """Log each palm as a moving dot, its executed path as a line.

    Of a smoothed path also its knots and its spline's line.
    """
    if not stage.robot.arms:
        return
    palms, path, spline = stage.motion.palms, stage.episode.path, stage.spline
    for i, arm in enumerate(stage.arms):
        colour = palette.cycle(palette.ARMS, i)
        colours = [palette.pale(colour) if stage.ghost else colour]
        draft.log(stage.entity("world", "palm", arm), rr.Points3D, radii=0.011, colors=colours)
        draft.columns(
            stage.entity("world", "palm", arm), stage.states, rr.Points3D, positions=palms[:, i]
        )
        draft.log(
            stage.entity("world", "path", arm, "executed"),
            rr.LineStrips3D,
            strips=palms[None, :, i],
            colors=colours,
            radii=0.0022,
        )
    if path is None or spline is None:
        return
    knots = stage.geometry.palms_of(path.knot_position, path.knot_time, stage.episode)
    smooth = stage.geometry.palms_of(spline[1], spline[0], stage.episode)
    for i, arm in enumerate(stage.arms):
        colour, entity = palette.cycle(palette.ARMS, i), stage.entity("world", "path", arm)
        light = [palette.bright(colour)]
        draft.log(
            f"{entity}/knots", rr.Points3D, positions=knots[:, i], radii=0.003, colors=[colour]
        )
        draft.log(
            f"{entity}/spline",
            rr.LineStrips3D,
            strips=smooth[None, :, i],
            radii=0.0032,
            colors=light,
        )


def draw_contacts(draft: Draft, stage: Stage) -> None:
    """Log contacts as points: large and red when they happen, small and dark for the whole
    episode.
    """
    contacts, names = stage.episode.contacts, stage.episode.header.env["geoms"]
    if not len(contacts):
        return
    place = np.stack([contacts["x"], contacts["y"], contacts["z"]], axis=1)
    labels = [
        f"{names[a]} – {names[b]}"
        for a, b in zip(contacts["geom1"], contacts["geom2"], strict=True)
    ]
    dark = [palette.pale(palette.BAD)]
    every, now = (stage.entity("world", "contact", name) for name in ("all", "now"))
    draft.log(
        every,
        rr.Points3D,
        positions=place,
        radii=0.006,
        colors=dark,
        labels=labels,
        show_labels=[False],
    )
    counts = np.bincount(contacts["step"], minlength=len(stage.episode))
    draft.log(now, rr.Points3D, radii=0.024, colors=[palette.BAD], show_labels=[True])
    draft.columns(now, stage.outcomes, rr.Points3D, counts, positions=place, labels=labels)


def draw_balance(draft: Draft, stage: Stage) -> None:
    """Log the centre of mass, its plumb line, and the support polygon, red where the step was
    unstable.
    """
    com = stage.motion.com
    ground = com * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.002]
    unstable = np.zeros(len(stage.episode) + 1, bool)
    if stage.episode.has("instability"):
        unstable[1:] = stage.episode.instability
    colours = np.where(unstable[:, None], palette.BAD, palette.MASS).astype(np.uint8)
    edge = np.where(unstable[:, None], palette.BAD, palette.GOOD).astype(np.uint8)
    mass, plumb, outline = (
        stage.entity("world", "balance", name) for name in ("mass", "plumb", "support")
    )
    points, both = np.stack([com, ground], axis=1), np.repeat(colours, 2, axis=0)
    draft.log(mass, rr.Points3D, radii=np.array([0.014, 0.010], dtype=np.float32))
    draft.columns(mass, stage.states, rr.Points3D, 2, positions=points.reshape(-1, 3), colors=both)
    draft.log(plumb, rr.LineStrips3D, radii=0.0015)
    draft.columns(plumb, stage.states, rr.LineStrips3D, strips=points, colors=colours)
    draft.log(outline, rr.LineStrips3D, radii=0.003)
    draft.columns(
        outline, stage.states, rr.LineStrips3D, strips=_loops(stage.motion.support()), colors=edge
    )


def _loops(polygons: Sequence[Array]) -> Array:
    """Closed outlines of n polygons on the floor, (c, 2) each, as one array (n, m, 3): short ones
    stay at their start, none is a point.
    """
    count = np.array([len(corners) for corners in polygons])
    corner = np.arange(count.max() + 1)
    corner = np.where(corner < count[:, None], corner, 0) + (np.cumsum(count) - count)[:, None]
    places = np.concatenate([*polygons, [[0.0, 0.0]]])[corner]
    loops = np.concatenate([places, np.full((*corner.shape, 1), 0.003)], axis=2)
    loops[count == 0] = 0.0
    return np.asarray(loops)
