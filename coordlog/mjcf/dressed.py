"""A log's model wearing what its robot looks like, for pictures alone."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Mapping
from typing import Any

import mujoco
import numpy as np

from coordlog.episode import MODEL_XML, VISUALS, Array
from coordlog.errors import FormatError
from coordlog.mjcf.attached import (
    FRAME,
    MAX_BYTES,
    expanded,
    files_of_log,
    load_attached,
    self_contained,
)
from coordlog.mjcf.looks import HEAD, SUFFIX
from coordlog.mjcf.source import MESH

SHOWN_GROUPS = 3
"""MuJoCo draws geoms of the groups below this."""
HIDDEN_GROUP = 4
MESH_NAME = re.compile(r"[0-9a-f]{64}" + re.escape(SUFFIX))
MOST = 10_000
"""Geoms that a log may have beside those of its model."""
Find = Callable[[str], bytes | None]
"""The bytes of a file beside a log by name; None where there is none."""


def load_dressed(attachments: Mapping[str, bytes], find: Find | None = None) -> mujoco.MjModel:
    """The model a log carries, wearing what lies beside the log: for pictures alone.

    Bodies that wear a mesh do not show what they collide with; bodies of which nothing would be
    seen do. Geoms have other numbers than in the log's own model, bodies and joints the same.

    Args:
        attachments: Of the log.
        find: Finds files beside it; None finds none.

    Raises:
        FormatError: as `load_attached`.
    """
    model = None
    if {VISUALS, MODEL_XML} <= attachments.keys() and find is not None:
        model = _dressed(attachments, find)
    model = load_attached(attachments) if model is None else model
    show_hidden(model)
    return model


def worn_by(attachments: Mapping[str, bytes]) -> list[str]:
    """The meshes that a log's robot wears, by the names of their files beside the log."""
    try:
        return sorted({_named(each) + FRAME for each in _worn_by(attachments)})
    except _NO_LOOKS:
        return []


_NO_LOOKS = (FormatError, ValueError, KeyError, TypeError, IndexError)
"""What is wrong with looks that cannot be used; physics and proofs are not touched by them."""


def _dressed(attachments: Mapping[str, bytes], find: Find) -> mujoco.MjModel | None:
    """The model with all of its meshes on; None where one is missing or is none."""
    files = files_of_log(attachments)
    text = expanded(attachments[MODEL_XML], "the attached MJCF text")
    try:
        spec = mujoco.MjSpec.from_string(self_contained(text, files))
        spec.assets = files
        bodies, room = list(spec.bodies), MAX_BYTES
        meshes: dict[str, tuple[Array, Array]] = {}
        for each in _worn_by(attachments):
            name = _named(each)
            if name not in meshes:
                data = _verified(name, find)
                room -= len(data)
                if room < 0:
                    return None
                meshes[name] = _unpacked(data)
                _add(spec, name, *meshes[name])
            _wear(bodies[each["body"]], each)
        return spec.compile()
    except _NO_LOOKS:
        return None


def _worn_by(attachments: Mapping[str, bytes]) -> list[dict[str, Any]]:
    if VISUALS not in attachments:
        return []
    worn = json.loads(expanded(attachments[VISUALS], f"attachment '{VISUALS}'"))
    if not isinstance(worn, list) or len(worn) > MOST:
        raise FormatError(f"attachment '{VISUALS}': expected a list of at most {MOST} meshes")
    return worn


def _named(worn: dict[str, Any]) -> str:
    """The name of a mesh, which leads nowhere else."""
    name = str(worn["mesh"])
    if not MESH_NAME.fullmatch(name):
        raise FormatError(f"mesh {name}: expected the SHA-256 of its content as its name")
    return name


def _verified(name: str, find: Find) -> bytes:
    frame = find(name + FRAME)
    data = expanded(frame or b"", name)
    if hashlib.sha256(data).hexdigest() != name.removesuffix(SUFFIX):
        raise FormatError(f"{name}: expected content of that SHA-256")
    return data


def _unpacked(data: bytes) -> tuple[Array, Array]:
    """A mesh as `_packed` has packed it.

    Raises:
        FormatError: if it is none.
    """
    vertices, normals, coordinates, triangles = (
        HEAD.unpack_from(data) if len(data) >= HEAD.size else (0, 0, 0, 0)
    )
    if min(vertices, triangles) < 1 or len(data) != HEAD.size + 12 * (vertices + triangles):
        raise FormatError("expected vertices and triangles, got other bytes")
    places = np.frombuffer(data, "<f4", 3 * vertices, HEAD.size)
    corners = np.frombuffer(data, "<i4", 3 * triangles, HEAD.size + 12 * vertices)
    if normals or coordinates or not np.isfinite(places).all():
        raise FormatError("expected finite vertices and triangles alone")
    if corners.min() < 0 or corners.max() >= vertices:
        raise FormatError(f"expected triangles of {vertices} vertices, got others")
    return places, corners


def _add(spec: mujoco.MjSpec, name: str, places: Array, corners: Array) -> None:
    mesh = spec.add_mesh(name=name, inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
    mesh.uservert, mesh.userface = places, corners


def _wear(body: Any, worn: dict[str, Any]) -> None:
    for geom in body.geoms:
        if geom.contype or geom.conaffinity:
            geom.group = HIDDEN_GROUP
    body.add_geom(
        type=MESH,
        meshname=worn["mesh"],
        pos=worn["pos"],
        quat=worn["quat"],
        rgba=worn["rgba"],
        contype=0,
        conaffinity=0,
        group=0,
        mass=0,
        material="",
    )


def show_hidden(model: mujoco.MjModel) -> None:
    """Show what collides of bodies of which nothing else is to be seen, and hide all else that
    MuJoCo does not draw: many models keep their collision shapes in a group of their own.
    """
    shown = (model.geom_group < SHOWN_GROUPS) & (model.geom_rgba[:, 3] > 0)
    solid = (model.geom_contype > 0) | (model.geom_conaffinity > 0)
    dressed = np.isin(model.geom_bodyid, model.geom_bodyid[shown])
    bare = solid & ~shown & ~dressed
    model.geom_group[bare] = 0
    model.geom_rgba[bare, 3] = np.maximum(model.geom_rgba[bare, 3], 1.0)
