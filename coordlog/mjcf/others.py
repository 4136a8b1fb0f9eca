"""Models that somebody else has compiled: whether a text of ours is the same physics."""

from __future__ import annotations

import warnings
import xml.etree.ElementTree as ET
from copy import copy
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np

from coordlog.errors import ConfigError, SimulationError
from coordlog.mjcf.attached import load_attached, pack_source
from coordlog.mjcf.printing import Source, full_precision, printed
from coordlog.mjcf.source import delete, drop_pictures, files_of, read_spec, state_inertia
from coordlog.robots.robot import Arm, Robot

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
POSE = 11
"""Numbers of an equality that the physics reads."""


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
        with warnings.catch_warnings():
            # MuJoCo's own print names a statistic that it warns of when it reads it again.
            warnings.filterwarnings("ignore", message="statistic attribute")
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
        if name == "eq_data":  # the last says whether MuJoCo worked a weld's pose out, once
            mine, theirs = mine[:, :POSE].copy(), theirs[:, :POSE].copy()
        if isinstance(mine, np.ndarray) and (
            mine.shape != theirs.shape or mine.tobytes() != theirs.tobytes()
        ):
            return False
    return all(
        np.array_equal(getattr(one.opt, name), getattr(other.opt, name))
        for name in dir(one.opt)
        if not name.startswith("_") and not callable(getattr(one.opt, name))
    )


def verbatim(given: Path | str, model: mujoco.MjModel) -> Source | None:
    """The text of a model, and the files it needs to collide, with nothing reduced: what compiles
    to the very physics of a compiled model, as that has been changed since. None where MuJoCo or
    its files do not allow it.
    """
    name = given.stem if isinstance(given, Path) else "model"
    beside = None if isinstance(given, Path) else Path.cwd()  # from where MuJoCo read its files
    robot = Robot(name, given, (Arm("none", "none", ()),), poses={"stand": {}}, assets=beside)
    try:
        spec = read_spec(robot)
        _copy_back(spec, model)
        visual = drop_pictures(spec)
        if not any(not geom.parent.explicitinertial for geom in visual):
            delete(spec, visual)
        files = files_of(spec, robot)
        spec.assets = files
        spec.compile()
        return Source(_as_placed(printed(spec), spec), files)
    except (ConfigError, SimulationError, ValueError, RuntimeError):
        return None


def _as_placed(text: str, spec: mujoco.MjSpec) -> str:
    """MJCF that MuJoCo has printed, with its mesh geoms where the spec has them: MuJoCo prints them
    from the frame of their mesh and back, rounded twice.
    """
    root = ET.fromstring(text)
    geoms = [geom for world in root.iter("worldbody") for geom in world.iter("geom")]
    if len(geoms) != len(spec.geoms):
        return text
    for element, geom in zip(geoms, spec.geoms, strict=True):
        plain = geom.alt.type == mujoco.mjtOrientation.mjORIENTATION_QUAT and geom.frame is None
        if "mesh" in element.attrib and geom.meshname == element.get("mesh") and plain:
            for name in ("pos", "quat"):
                element.set(name, " ".join(repr(float(each)) for each in getattr(geom, name)))
    return ET.tostring(root, encoding="unicode")


def _copy_back(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Take over what has been changed in a model since it was compiled."""
    fresh, given = spec.compile(), copy(model)
    given.eq_data[:] = fresh.eq_data  # MuJoCo refuses the pose of a weld that it has worked out
    meshes = [(g, np.array(g.pos), np.array(g.quat)) for g in spec.geoms if g.meshname]
    spec.copy_back(given)
    for geom, pos, quat in meshes:  # copied back, they are rounded once more
        own = [getattr(m, f)[geom.id] for f in ("geom_pos", "geom_quat") for m in (fresh, model)]
        if (own[0] == own[1]).all() and (own[2] == own[3]).all():
            geom.pos, geom.quat = pos, quat
    for i, tie in enumerate(spec.equalities):
        if (fresh.eq_data[i] != model.eq_data[i]).any():
            tie.data = model.eq_data[i]
    spec.stat.meaninertia = np.nan  # worked out again by whoever compiles it
    fresh = spec.compile()
    for body in spec.bodies[1:]:
        if model.body_mass[body.id] != fresh.body_mass[body.id]:  # it followed from its geoms
            state_inertia(body, model)
