"""Models that somebody else has compiled: whether a text of ours is the same physics."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np

from coordlog.mjcf.attached import load_attached, pack_source
from coordlog.mjcf.printing import full_precision
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
    "length",
    "vis",
    "group",
)
"""Arrays whose names have one of these words are not of bodies in motion, or are counted from other
elements; that the physics is the same is shown by simulating each step again."""


def text_of(model: mujoco.MjModel, source: Path | str | None = None) -> dict[str, bytes]:
    """A compiled model as a log's attachments: its text, with what has been changed in it since it
    was compiled, and the files it needs to collide.

    Args:
        model: As somebody else has compiled it.
        source: The file or the text it was compiled from; None for what MuJoCo compiled last.

    Returns:
        Nothing where there is no text that compiles to the same physics.
    """
    attached = {}
    for given in (source, _last(model)):
        found = None if given is None else verbatim(given, model)
        if found is not None:
            attached = pack_source(found)
            if same_physics(load_attached(attached), model):
                return attached
    return {}


def _last(model: mujoco.MjModel) -> str | None:
    """The text of the model that MuJoCo compiled last, if it is this one."""
    with TemporaryDirectory() as folder, full_precision():
        path = Path(folder) / "last.xml"
        try:
            mujoco.mj_saveLastXML(str(path), model)
            return path.read_text(encoding="utf-8")
        except (mujoco.FatalError, ValueError, OSError, TypeError):
            return None


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
