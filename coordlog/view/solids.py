"""MuJoCo's shapes as the viewer's: sizes, poses, the floor, and where to look at them from.

One entity per kind of shape: sizes and colours are logged once, poses as columns over the whole
episode.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr

from coordlog.episode import Array
from coordlog.kinematics.geometry import Geom
from coordlog.view.draft import Value
from coordlog.view.palette import FLOOR, Colour

TILE = 0.1
"""Side of a floor tile [m]."""
FLOOR_HALF = 0.8
"""Half the side of the floor that is drawn [m]."""

ARCHETYPES: dict[str, type[Any]] = {
    "box": rr.Boxes3D,
    "sphere": rr.Ellipsoids3D,
    "ellipsoid": rr.Ellipsoids3D,
    "capsule": rr.Capsules3D,
    "cylinder": rr.Cylinders3D,
}


def solids(kind: str, geoms: Sequence[Geom], colours: Sequence[Colour]) -> dict[str, Value]:
    """Shapes of one kind without their poses, as fields of its archetype."""
    size = np.array([geom.size for geom in geoms], dtype=np.float32)
    look: dict[str, Value] = {"colors": colours, "fill_mode": [rr.components.FillMode.Solid]}
    if kind in ("capsule", "cylinder"):
        return look | {"lengths": 2 * size[:, 1], "radii": size[:, 0]}
    return look | {"half_sizes": size[:, [0, 0, 0]] if kind == "sphere" else size}


def poses(kind: str, geoms: Sequence[Geom], position: Array, quaternion: Array) -> dict[str, Array]:
    """Poses of shapes of one kind as fields of its archetype: position (…, len(geoms), 3) [m],
    quaternion (…, len(geoms), 4) wxyz.
    """
    xyzw = np.roll(quaternion, -1, axis=-1).reshape(-1, 4)
    if kind == "mesh":
        return {"translations": position.reshape(-1, 3), "quaternions": xyzw}
    if kind == "capsule":
        # The viewer's capsule starts at its origin and runs along +z; MuJoCo's is centred on it.
        half = np.array([geom.size[1] for geom in geoms])
        return {
            "translations": (position - half[:, None] * axis(quaternion)).reshape(-1, 3),
            "quaternions": xyzw,
        }
    return {"centers": position.reshape(-1, 3), "quaternions": xyzw}


def normals(vertices: Array, triangles: Array) -> Array:
    """Where the surface of a mesh looks at each of its vertices (v, 3): the mean over the triangles
    (t, 3) that meet there, each by its area; unit vectors (v, 3) float32.
    """
    a, b, c = (vertices[triangles[:, i]].astype(np.float64) for i in range(3))
    across = np.cross(b - a, c - a)
    found = np.zeros((len(vertices), 3))
    for i in range(3):
        np.add.at(found, triangles[:, i], across)
    length = np.linalg.norm(found, axis=1, keepdims=True)
    return (found / np.where(length > 0, length, 1.0)).astype(np.float32)


def axis(quaternion: Array) -> Array:
    """The z axis of a frame by its orientation, (…, 4) wxyz to (…, 3)."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    return np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=-1)


def floor(centre: Array) -> dict[str, Value]:
    """A chequered square around a point (2,), as fields of a mesh: its tiles of 0.1 m give the
    scene its scale.
    """
    n = round(2 * FLOOR_HALF / TILE)
    tile = np.stack(np.meshgrid(np.arange(n), np.arange(n), indexing="ij"), axis=-1).reshape(-1, 2)
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    flat = (tile[:, None] + corners - n / 2) * TILE + np.round(centre / TILE) * TILE
    vertices = np.concatenate([flat, np.zeros((n * n, 4, 1))], axis=2).reshape(-1, 3)
    triangles = (
        (4 * np.arange(n * n)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]]))
        .reshape(-1, 3)
        .astype(np.uint32)
    )
    colours = np.repeat(np.array(FLOOR, dtype=np.uint8)[tile.sum(axis=1) % 2], 4, axis=0)
    normals = np.tile([0.0, 0.0, 1.0], (len(vertices), 1))
    return {
        "vertex_positions": vertices,
        "triangle_indices": triangles,
        "vertex_colors": colours,
        "vertex_normals": normals,
    }
