"""A robot's own model, whole: its includes and meshes read, what only pictures need left out.

Collision meshes are kept as their convex hulls, which is what MuJoCo collides; a body whose inertia
followed from a mesh keeps the inertia it had. What is left names no file but hulls, by the SHA-256
of their bytes.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from coordlog.errors import ConfigError
from coordlog.mjcf.printing import Source, printed
from coordlog.mjcf.servos import HINGE, SLIDE, free_name
from coordlog.robots.robot import Arm, Robot
from coordlog.strangers import HEAD, POINTER, recognise, what_is

MESH = mujoco.mjtGeom.mjGEOM_MESH
FROM_GEOMS = 1
"""MuJoCo's inertiafromgeom="true": whatever inertia a body states is ignored."""
FROM_GEOMS_IF_NONE = 2
ANCESTORS = 6
"""How many folders above a URDF its `package://` names are looked for in."""
XACRO = "http://www.ros.org/wiki/xacro"
UNREADABLE = (".dae", ".glb", ".gltf", ".fbx", ".ply")
"""Mesh formats that MuJoCo has no decoder for."""


def spec_of(robot: Robot) -> tuple[mujoco.MjSpec, Mapping[str, bytes]]:
    """The robot's model as a spec that reads no file but the assets beside it.

    Raises:
        ConfigError: naming everything that is missing or cannot be read.
    """
    source = whole(robot)
    try:
        spec = mujoco.MjSpec.from_string(source.text)
    except ValueError as error:
        raise _refused(robot, error) from error
    spec.assets = dict(source.assets)
    return spec, source.assets


def whole(robot: Robot) -> Source:
    """The robot's model alone, with the files it needs.

    Raises:
        ConfigError: naming everything that is missing or cannot be read.
    """
    return _whole(RobotKey(robot))


def model_alone(file: Path) -> Source:
    """A model file that no spec describes, whole.

    Raises:
        ConfigError: as `whole`.
    """
    return whole(Robot(file.stem, file, (Arm("none", "none", ()),), poses={"stand": {}}))


ATTRIBUTE = re.compile(r"""([\w:]+)\s*=\s*["']([^"']*)["']""")
NOT_NUMBERS = ("nan", "-nan", "+nan")
LABELS = ("name", "class", "childclass", "joint", "body", "site", "geom", "model")
"""Attributes that may say "nan" and mean a name."""


class RobotKey:
    """A robot's model as a key: the same files are read and reduced once."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        stamp: Any = robot.mjcf
        if isinstance(robot.mjcf, Path) and robot.mjcf.is_file():
            stamp = (robot.mjcf.resolve(), robot.mjcf.stat().st_mtime_ns)
        assets = robot.assets
        named = (
            tuple(sorted((k, hash(v)) for k, v in assets.items()))
            if isinstance(assets, Mapping)
            else assets
        )
        self.identity = (robot.name, stamp, named)

    def __hash__(self) -> int:
        return hash(self.identity)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, RobotKey) and self.identity == other.identity


@lru_cache(maxsize=4)
def _whole(key: RobotKey) -> Source:
    robot = key.robot
    spec = read_spec(robot)
    named = sum(len(each) for each in (spec.meshes, spec.textures, spec.hfields, spec.skins))
    text = robot.mjcf if isinstance(robot.mjcf, str) else ""
    if text and not named and not _is_urdf(text) and "<include" not in text:
        return Source(text)
    if len(spec.plugins):
        raise ConfigError(
            f"robot '{robot.name}': its model has a plugin, expected one that needs no library but "
            "MuJoCo: take the plugin out"
        )
    _name_joints(spec)
    spec.compiler.fusestatic = False  # a base that is fused into the world would be an obstacle
    spec.compiler.discardvisual = False
    visual = drop_pictures(spec)
    inferred = any(not geom.parent.explicitinertial for geom in visual)
    if not inferred:
        delete(spec, visual)
    files = files_of(spec, robot)
    spec.assets = files
    try:
        model = spec.compile()
        _keep_inertia(spec, model)
        if inferred:
            delete(spec, visual)
        files |= _hulls(spec, model)
        spec.assets = files
        spec.compile()
    except ValueError as error:
        _refuse_meshes(spec, robot, files)
        raise _refused(robot, error) from error
    kept = {thing.file for thing in (*spec.meshes, *spec.hfields)}
    return Source(printed(spec), {name: data for name, data in files.items() if name in kept})


def _name_joints(spec: mujoco.MjSpec) -> None:
    """Give every hinge and slide a name: a card names the joints of an arm."""
    for body in spec.bodies:
        for i, joint in enumerate(body.joints):
            if not joint.name and joint.type in (HINGE, SLIDE):
                joint.name = free_name(spec.joint, f"joint {i} of {body.name or 'a body'}")


def read_spec(robot: Robot) -> mujoco.MjSpec:
    """The robot's model as it lies there, its includes read.

    Raises:
        ConfigError: if there is none, or MuJoCo refuses it.
    """
    _without_nan(robot)
    try:
        if isinstance(robot.mjcf, Path):
            if not robot.mjcf.is_file():
                raise ConfigError(
                    f"robot '{robot.name}': expected its model in {robot.mjcf}, found no such file"
                )
            return mujoco.MjSpec.from_file(str(robot.mjcf))
        return mujoco.MjSpec.from_string(robot.mjcf, include=_included(robot))
    except ValueError as error:
        raise _refused(robot, error) from error


def _without_nan(robot: Robot) -> None:
    """MuJoCo takes a NaN in a model for a number that is not given, without a word.

    Raises:
        ConfigError: naming the attribute that has one.
    """
    text = robot.mjcf
    if isinstance(text, Path):
        data = text.read_bytes() if text.is_file() else b""
        text = data.decode("utf-8", errors="replace")
        if "\ufffd" in text and data.lstrip().startswith((b"<", b"\xff\xfe", b"\xfe\xff")):
            raise ConfigError(
                f"robot '{robot.name}': its model in {robot.mjcf} is not in UTF-8, which MuJoCo "
                "reads: save it as UTF-8"
            )
    for name, values in ATTRIBUTE.findall(text):
        if name not in LABELS and any(part.lower() in NOT_NUMBERS for part in values.split()):
            raise ConfigError(
                f"robot '{robot.name}': its model has {name}=\"{values}\": expected numbers"
            )


def _included(robot: Robot) -> dict[str, bytes]:
    """The MJCF files that a model given as text may include."""
    if "<include" not in str(robot.mjcf) or robot.assets is None:
        return {}
    if isinstance(robot.assets, Path):
        return {
            str(path.relative_to(robot.assets)): path.read_bytes()
            for path in robot.assets.rglob("*.xml")
        }
    return {name: data for name, data in robot.assets.items() if name.endswith(".xml")}


def _refused(robot: Robot, error: ValueError) -> ConfigError:
    said = str(error).strip().splitlines()[0].removeprefix("Error: ")
    text = robot.mjcf
    if isinstance(text, Path):
        text = text.read_text(encoding="utf-8", errors="replace") if text.is_file() else ""
    if XACRO in text:
        return ConfigError(
            f"robot '{robot.name}': its model is a xacro, of which a URDF has yet to be made: "
            "`xacro FILE > robot.urdf`"
        )
    if isinstance(robot.mjcf, Path):
        what = what_is(robot.mjcf)
        if what and not what.startswith("an XML"):
            return ConfigError(
                f"robot '{robot.name}': expected its model as MJCF or URDF in {robot.mjcf}, "
                f"got {what}"
            )
    return ConfigError(
        f"robot '{robot.name}': expected its model as MJCF or URDF that MuJoCo takes, which says: "
        f"{said}"
    )


def _is_urdf(text: str) -> bool:
    return "<robot" in text and "<mujoco" not in text.split("<robot")[0]


def drop_pictures(spec: mujoco.MjSpec) -> list[Any]:
    """Take textures and skins out, and leave colours; the mesh geoms that nothing collides with."""
    for material in spec.materials:
        material.textures = [""] * len(material.textures)
    for what in (*spec.textures, *spec.skins):
        spec.delete(what)
    paired = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)}
    return [
        geom
        for geom in spec.geoms
        if geom.meshname
        and not geom.contype
        and not geom.conaffinity
        and geom.name not in (paired - {""})
    ]


def delete(spec: mujoco.MjSpec, geoms: list[Any]) -> None:
    """Delete geoms, and the meshes that no other geom has."""
    for geom in geoms:
        spec.delete(geom)
    used = {geom.meshname for geom in spec.geoms}
    for mesh in list(spec.meshes):
        if mesh.name not in used:
            spec.delete(mesh)


def files_of(spec: mujoco.MjSpec, robot: Robot) -> dict[str, bytes]:
    """Read every file the spec still names, and give it there the SHA-256 of its bytes as a name.

    Raises:
        ConfigError: one sentence for all that are missing or of a kind MuJoCo does not read.
    """
    found, faults = {}, []
    for kind, things, folder in (
        ("mesh", spec.meshes, spec.meshdir),
        ("height field", spec.hfields, spec.meshdir),
    ):
        for thing in things:
            if not thing.file:
                continue
            name, suffix = thing.file, Path(thing.file).suffix.lower()
            if suffix in UNREADABLE:
                faults.append(
                    f"{kind} '{thing.name}' reads {name}, a format MuJoCo does not read (convert "
                    "it to STL or OBJ, with assimp or Blender)"
                )
                continue
            data = content_of(robot, name, folder)
            if data is None:
                faults.append(
                    f"{kind} '{thing.name}' reads {name}, which is not in {_where(robot)}"
                    + _otherwise(robot, name, folder)
                )
                continue
            if data.startswith(POINTER):
                what = recognise(data)
                faults.append(f"{kind} '{thing.name}' reads {name}, which is {what}")
                continue
            if not thing.name:
                thing.name = Path(name).stem
            thing.file = hashlib.sha256(data).hexdigest() + suffix
            found[thing.file] = data
    if faults:
        raise _unreadable(robot, faults)
    spec.meshdir = spec.texturedir = ""
    spec.strippath = False
    return found


def _unreadable(robot: Robot, faults: list[str]) -> ConfigError:
    return ConfigError(
        f"robot '{robot.name}': its model names files that cannot be read: {'; '.join(faults)}"
    )


def _refuse_meshes(spec: mujoco.MjSpec, robot: Robot, files: Mapping[str, bytes]) -> None:
    """Compile every mesh by itself, where a model does not compile.

    Raises:
        ConfigError: naming all meshes that MuJoCo refuses, with its reasons.
    """
    faults = []
    for mesh in spec.meshes:
        if mesh.file not in files:
            continue
        try:
            compile_alone(mesh, files[mesh.file], solid=True)
        except ValueError as error:
            head = files[mesh.file][:HEAD]
            said = recognise(head, texts=False) or str(error).strip().splitlines()[0]
            said = (
                said.removeprefix("Error: ")
                .replace(f"'{mesh.file}'", "it")
                .replace(f"'{mesh.name}'", "it")
            )
            faults.append(f"mesh '{mesh.name}': {said}")
    if faults:
        raise _unreadable(robot, faults)


def compile_alone(mesh: Any, data: bytes, *, solid: bool) -> None:
    """Compile one mesh that is read from a file by itself.

    Args:
        mesh: Of a spec.
        data: Of its file.
        solid: Whether things collide with it, for which it needs a hull.

    Raises:
        ValueError: if MuJoCo refuses it.
    """
    spec, name, bits = mujoco.MjSpec(), Path(mesh.file).name, int(solid)
    spec.assets = {name: data}
    spec.add_mesh(name="mesh", file=name, scale=mesh.scale, inertia=mesh.inertia)
    spec.worldbody.add_geom(type=MESH, meshname="mesh", contype=bits, conaffinity=bits)
    spec.compile()


def _otherwise(robot: Robot, name: str, folder: str) -> str:
    """The file of that name in other letters, large or small, as a hint."""
    base = robot.mjcf.parent if isinstance(robot.mjcf, Path) else robot.assets
    if not isinstance(base, Path) or "://" in name:
        return ""
    for wanted in (base / folder / name, base / name):
        if wanted.parent.is_dir():
            for path in wanted.parent.iterdir():
                if path.name.lower() == wanted.name.lower():
                    return f" (there is {path.name}: large and small letters differ)"
    return ""


def _where(robot: Robot) -> str:
    if isinstance(robot.mjcf, Path):
        return str(robot.mjcf.parent)
    if isinstance(robot.assets, Path):
        return str(robot.assets)
    if robot.assets is None:
        return (
            "its text, and no folder is given: give the robot's `mjcf` as a Path, or its files as "
            "`assets`"
        )
    return f"the robot's assets ({', '.join(sorted(robot.assets)) or 'none'})"


def content_of(robot: Robot, name: str, folder: str) -> bytes | None:
    """The bytes of a file that a model names."""
    if isinstance(robot.assets, Mapping):
        for key in (name, str(Path(folder) / name), Path(name).name):
            if key in robot.assets:
                return robot.assets[key]
    base = robot.mjcf.parent if isinstance(robot.mjcf, Path) else robot.assets
    if not isinstance(base, Path):
        return None
    rest = name.split("://", 1)[1] if "://" in name else name
    tries = [base / folder / rest, base / rest, base / folder / Path(rest).name]
    if "://" in name:
        inside = Path(*Path(rest).parts[1:])
        above = [base.resolve(), *base.resolve().parents][:ANCESTORS]
        tries += [up / part for up in above for part in (rest, inside)]
    return next((path.read_bytes() for path in tries if path.is_file()), None)


def _keep_inertia(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """State the inertia of every body that has a mesh, as MuJoCo worked it out from that mesh."""
    every = spec.compiler.inertiafromgeom == FROM_GEOMS or spec.compiler.settotalmass > 0
    for body in spec.bodies[1:]:
        if not model.body_mass[body.id] or not (every or any(g.meshname for g in body.geoms)):
            continue
        if body.explicitinertial and not every:
            continue
        state_inertia(body, model)
    if every:
        spec.compiler.inertiafromgeom, spec.compiler.settotalmass = FROM_GEOMS_IF_NONE, -1


def state_inertia(body: Any, model: mujoco.MjModel) -> None:
    """Let a body say the inertia it has in a compiled model."""
    body.explicitinertial = True
    body.mass = model.body_mass[body.id]
    body.ipos, body.iquat = model.body_ipos[body.id], model.body_iquat[body.id]
    body.inertia = model.body_inertia[body.id]
    body.fullinertia = [np.nan] * 6


def _hulls(spec: mujoco.MjSpec, model: mujoco.MjModel) -> dict[str, bytes]:
    """Put the convex hull in the place of every mesh that collides."""
    made = {}
    shared = {
        geom.meshname for geom in spec.geoms if geom.meshname and geom.type != MESH
    }  # a primitive fitted to a mesh is fitted to all of it
    for mesh in spec.meshes:
        if model.mesh_graphadr[mesh.id] < 0 or mesh.name in shared:
            continue
        data = _hull(model, mesh.id)
        mesh.file = hashlib.sha256(data).hexdigest() + ".obj"
        mesh.content_type = "model/obj"
        mesh.scale, mesh.refpos, mesh.refquat = [1, 1, 1], [0, 0, 0], [1, 0, 0, 0]
        mesh.uservert, mesh.userface, mesh.usernormal, mesh.usertexcoord = [], [], [], []
        made[mesh.file] = data
    return made


def _hull(model: mujoco.MjModel, mesh: int) -> bytes:
    """The corners of a compiled mesh's convex hull in the frame of its file, as Wavefront OBJ.

    MuJoCo's `mesh_graph` begins with the hull's numbers of vertices and faces; after one address
    for each vertex come the vertices themselves. What they span is worked out again by whoever
    compiles them.
    """
    graph = model.mesh_graph[model.mesh_graphadr[mesh] :]
    count = int(graph[0])
    corners = model.mesh_vertadr[mesh] + graph[2 + count : 2 + 2 * count]
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.mesh_quat[mesh])
    places = model.mesh_vert[corners].astype(np.float64) @ turn.reshape(3, 3).T
    return "".join(
        f"v {x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in places + model.mesh_pos[mesh] + 0.0
    ).encode()
