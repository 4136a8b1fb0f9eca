"""Where to look from, so that robot, goals and hand paths are in the picture and nothing stands in
front of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from coordlog.episode import Array
from coordlog.kinematics.geometry import Geom
from coordlog.view.show import Stage

FRONT = np.array([0.80, -0.50, 0.33])
STRAIGHT = np.array([0.85, -0.12, 0.30])
ABOVE = np.array([-0.25, -0.35, 0.90])
FLAT = 0.25
"""Something this much flatter than wide is looked at from above."""
TANGENT = 0.52
"""Of half the viewer's vertical field of view, 55 degrees."""
ASPECT = 1.4
"""Width of the view over its height, at least."""
ROOM = 1.08
"""The eye stands this much farther away than it must."""
AROUND = 0.06
"""Room left around the robot's joints, hand paths and goals [m]."""
CORNERS = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)
HIDDEN = 0.25
"""A panel that hides this share of the hand paths is in the way."""


class Camera(NamedTuple):
    """An eye and what it looks at, (3,) each [m]."""

    eye: Array
    target: Array


def camera(stages: Sequence[Stage]) -> Camera:
    """Look at one show from the front right, at several from the front, and from above at a robot
    that moves in the plane.
    """
    points = np.concatenate([_seen(stage) + np.array([0.0, stage.offset, 0.0]) for stage in stages])
    return look_at(points, STRAIGHT if any(stage.offset for stage in stages) else FRONT)


def look_at(points: Array, towards: Array = FRONT) -> Camera:
    """Look at points (n, 3) along a direction (3,) that leads to the eye, as near as shows them
    all; from above if they lie flat.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    size, target = high - low, (low + high) / 2
    towards = ABOVE if size[2] < FLAT * max(size[0], size[1]) else towards
    towards = towards / np.linalg.norm(towards)
    right = np.cross([0.0, 0.0, 1.0], towards)
    right /= np.linalg.norm(right)
    up = np.cross(towards, right)
    near, across, above = ((points - target) @ axis for axis in (towards, right, up))
    distance = (near + np.maximum(np.abs(above), np.abs(across) / ASPECT) / TANGENT).max()
    return Camera(target + ROOM * distance * towards, target)


def hides(geom: Geom, stage: Stage, eye: Array) -> bool:
    """Whether a box of the world stands between the eye and a goal, the top of the robot, or much
    of the hand paths.
    """
    if geom.kind != "box" or geom.place != "world":
        return False
    robot = stage.motion.position[
        0, [each.index for each in stage.geometry.geoms if each.place == "robot"]
    ]
    top = robot[np.argsort(robot[:, 2])[-1:]]
    goals, palms = (
        np.array(stage.episode.header.episode["goals"]).reshape(-1, 3),
        stage.motion.palms.reshape(-1, 3),
    )
    centre, half = stage.motion.position[0, geom.index], np.array(geom.size)
    start = eye - np.array([0.0, stage.offset, 0.0])
    ends = np.concatenate([goals, top, palms])
    blocked = crosses(start, ends, centre - half, centre + half)
    points = len(goals) + len(top)
    return bool(blocked[:points].any() or blocked[points:].sum() > HIDDEN * len(palms))


def crosses(start: Array, ends: Array, low: Array, high: Array) -> Array:
    """Whether the straight lines from one point (3,) to others (n, 3) pass through an upright box,
    (n,) bool.
    """
    along = ends - start
    along = np.where(along == 0.0, 1e-12, along)
    first, second = (low - start) / along, (high - start) / along
    enter, leave = np.minimum(first, second).max(axis=1), np.maximum(first, second).min(axis=1)
    return np.asarray((enter < leave) & (enter > 0.0) & (enter < 1.0))


def _seen(stage: Stage) -> Array:
    """Points that must be in the picture, (n, 3): robot, hand paths and goals with some room around
    them, and all that stands about.
    """
    motion, geoms = stage.motion, stage.geometry.geoms
    robot = [geom.index for geom in geoms if geom.place == "robot"]
    places = [
        motion.position[:, robot],
        motion.palms,
        np.array(stage.episode.header.episode["goals"]),
    ]
    points = np.concatenate([place.reshape(-1, 3) for place in places])
    seen = [points + side * AROUND for side in (-1.0, 1.0)]
    for geom in geoms:
        if geom.kind in ("box", "sphere") and geom.place in ("world", "obstacle", "object"):
            half = geom.size if geom.kind == "box" else (geom.size[0],) * 3
            seen.append(motion.position[0, geom.index] + CORNERS * half)
    every = np.concatenate(seen)
    return np.asarray(every[np.isfinite(every).all(axis=1)])
