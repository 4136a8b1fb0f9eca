"""How a robot looks: the meshes that nothing collides with, which the physics does without.

A log says which bodies wear them and where, in an attachment of its own; the meshes themselves lie
once beside the logs. Where one is missing, what collides is drawn in its place.
"""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Container, Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import mujoco
import numpy as np
import zstandard

from coordlog.episode import VISUALS, Array
from coordlog.errors import ConfigError
from coordlog.mjcf.attached import FRAME, LEVEL
from coordlog.mjcf.source import (
    MESH,
    RobotKey,
    compile_alone,
    content_of,
    delete,
    drop_pictures,
    files_of,
    read_spec,
)
from coordlog.robots.robot import Robot

SUFFIX = ".msh"
"""Meshes are kept in MuJoCo's own binary format, under the SHA-256 of their bytes."""
HEAD = struct.Struct("<4i")
"""Numbers of vertices, normals, texture coordinates and triangles."""
UNCOLOURED = np.array([0.5, 0.5, 0.5, 1.0], dtype=np.float32)
"""MuJoCo's colour of a geom that has none."""


class Looks(NamedTuple):
    """What a robot wears; nothing where all that is drawn of it collides too."""

    attached: Mapping[str, bytes] = {}
    """For every log of it: which bodies wear which mesh where, one zstd frame."""
    meshes: Mapping[str, bytes] = {}
    """For the folder of the logs: each mesh one zstd frame, by file name."""


def looks_of(model: mujoco.MjModel) -> Looks:
    """What a model has of meshes that nothing collides with.

    Example:
        >>> looks_of(model).meshes.keys()  # doctest: +SKIP
        dict_keys(['2f1c….msh.zst', …])
    """
    return _looks(model, np.flatnonzero(_worn(model)).tolist())


def robot_looks(robot: Robot) -> Looks:
    """What a robot's own model has of meshes that nothing collides with, but for those that
    cannot be read.
    """
    return _robot_looks(RobotKey(robot))


@lru_cache(maxsize=4)
def _robot_looks(key: RobotKey) -> Looks:
    try:
        return _as_read(key.robot, leave=())
    except (ConfigError, ValueError):
        pass  # the physics does without these meshes, so one that cannot be read is no fault
    try:
        return _as_read(key.robot, leave=_unreadable(key.robot))
    except (ConfigError, ValueError):
        return Looks()


def _as_read(robot: Robot, *, leave: Container[str]) -> Looks:
    """What a robot's model has, but for some meshes; errors as MuJoCo's."""
    spec, worn = _spec(robot)
    delete(spec, [geom for geom in worn if geom.meshname in leave])
    worn = [geom for geom in worn if geom.meshname not in leave]
    if not worn:
        return Looks()
    own = {geom.meshname for geom in worn}
    spec.assets = files_of(spec, robot)
    for geom in spec.geoms:  # hulls would be worked out of all that collides
        geom.contype = geom.conaffinity = 0
    for mesh in spec.meshes:
        if mesh.name in own:  # it has no mass, and may be flat
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    return _looks(spec.compile(), [geom.id for geom in worn])


def _spec(robot: Robot) -> tuple[mujoco.MjSpec, list[Any]]:
    """A robot's model as it lies there, and its geoms that are meshes and only drawn."""
    spec = read_spec(robot)
    spec.compiler.fusestatic = spec.compiler.discardvisual = False
    return spec, drop_pictures(spec)


def _unreadable(robot: Robot) -> set[str]:
    """Names of the meshes that are only drawn and cannot be."""
    spec, worn = _spec(robot)
    own, bad = {geom.meshname for geom in worn}, set()
    for mesh in spec.meshes:
        if mesh.name not in own or not mesh.file:
            continue
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        data = content_of(robot, mesh.file, spec.meshdir) or b""
        try:
            compile_alone(mesh, data, solid=False)
        except ValueError:
            bad.add(mesh.name)
    return bad


def _worn(model: mujoco.MjModel) -> Array:
    """Which geoms are meshes that nothing collides with, (n_geom,) bool."""
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    solid[model.pair_geom1], solid[model.pair_geom2] = True, True
    return np.asarray((model.geom_type == MESH) & ~solid)


def _looks(model: mujoco.MjModel, geoms: list[int]) -> Looks:
    """These geoms of a compiled model."""
    packer = zstandard.ZstdCompressor(level=LEVEL)
    names: dict[int, str] = {}
    meshes, worn = {}, []
    for geom in geoms:
        mesh, body = int(model.geom_dataid[geom]), int(model.geom_bodyid[geom])
        if mesh not in names:
            data = _packed(model, mesh)
            names[mesh] = hashlib.sha256(data).hexdigest() + SUFFIX
            meshes[names[mesh] + FRAME] = packer.compress(data)
        worn.append(
            {
                "body": body,
                "name": model.body(body).name,
                "mesh": names[mesh],
                "pos": _rounded(model.geom_pos[geom]),
                "quat": _rounded(model.geom_quat[geom]),
                "rgba": _rounded(colour_of(model, geom)),
            }
        )
    if not worn:
        return Looks()
    return Looks({VISUALS: packer.compress(json.dumps(worn).encode())}, meshes)


def _rounded(values: Array) -> list[float]:
    return [round(float(value), 6) for value in values]


def colour_of(model: mujoco.MjModel, geom: int) -> Array:
    """A geom's own colour, (4,), or that of its material where it has none of its own."""
    material, rgba = int(model.geom_matid[geom]), model.geom_rgba[geom]
    if material >= 0 and np.array_equal(rgba, UNCOLOURED):
        return np.asarray(model.mat_rgba[material])
    return np.asarray(rgba)


def mesh_of(model: mujoco.MjModel, mesh: int) -> tuple[Array, Array]:
    """A compiled mesh: its vertices (v, 3) [m] and its triangles (t, 3)."""
    vertex, vertices = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    face, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    return model.mesh_vert[vertex : vertex + vertices], model.mesh_face[face : face + faces]


def _packed(model: mujoco.MjModel, mesh: int) -> bytes:
    vertices, triangles = mesh_of(model, mesh)
    head = HEAD.pack(len(vertices), 0, 0, len(triangles))
    return head + vertices.astype("<f4").tobytes() + triangles.astype("<i4").tobytes()
