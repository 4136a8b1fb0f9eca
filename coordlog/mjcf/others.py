"""Models that somebody else has compiled: whether a text of ours is the same physics."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from coordlog.mjcf.attached import pack_source
from coordlog.mjcf.source import verbatim

ASIDE = (
    "name",
    "path",
    "text",
    "mesh",
    "tex",
    "mat",
    "skin",
    "light",
    "cam",
    "geom",
    "bvh",
    "site",
    "key",
    "hfield",
    "numeric",
    "tuple",
    "user",
    "sameframe",
    "id",
    "signature",
    "adr",
    "num",
    "buffer",
    "stat",
    "vis",
    "group",
)
"""Arrays whose names have one of these words are not of bodies in motion, or are counted from other
elements; that the physics is the same is shown by simulating each step again."""


def text_of(file: Path) -> dict[str, bytes]:
    """A model file as a log's attachments; empty where it cannot be taken along."""
    source = verbatim(file)
    return {} if source is None else pack_source(source)


def same_physics(one: mujoco.MjModel, other: mujoco.MjModel) -> bool:
    """Whether bodies, joints, actuators and options of two models are equal in every bit."""
    sizes = ("nq", "nv", "nu", "na", "nbody", "njnt", "neq", "ntendon", "nmocap", "nsensor")
    if any(getattr(one, name) != getattr(other, name) for name in sizes):
        return False
    for name in dir(one):
        if name.startswith("_") or any(word in name for word in ASIDE):
            continue
        mine, theirs = getattr(one, name), getattr(other, name)
        if isinstance(mine, np.ndarray) and (
            mine.shape != theirs.shape or mine.tobytes() != theirs.tobytes()
        ):
            return False
    return all(
        np.array_equal(getattr(one.opt, name), getattr(other.opt, name))
        for name in dir(one.opt)
        if not name.startswith("_") and not callable(getattr(one.opt, name))
    )
