"""Models as text: compose a robot and a scene, compile, and load what a log carries.

A log is not trusted: nothing its model says makes MuJoCo open another file.
"""

from __future__ import annotations

import io
import xml.etree.ElementTree as ET
from xml.parsers import expat

import mujoco
import numpy as np
import zstandard

from coordlog.errors import ConfigError, FormatError, SimulationError
from coordlog.robots.robot import Robot
from coordlog.tasks.config import EnvConfig
from coordlog.tasks.scene import (
    Scene,
    goal_body,
    link_sensor,
    palm_sensor,
    sole_corner,
    sphere_geom,
)

MAX_BYTES = 64 << 20
"""A model's text or MJB may expand to this much; ours need 30 kB."""

_ROOT = "mujoco"  # the other root MuJoCo takes is URDF's <robot>, whose meshes are files
_READS_FILES = ("include", "model", "attach", "extension", "plugin")
_FOLDERS = ("meshdir", "texturedir", "assetdir")


def silence() -> None:
    """Keep MuJoCo from writing warnings to the console and to a file in the working directory: what
    diverges is a flag here.
    """
    log = mujoco.MjLogConfig.get()
    log.logto_console = log.logto_file = False
    mujoco.MjLogConfig.set(log)


def compile_model(xml: str) -> mujoco.MjModel:
    """Compile MJCF text whose contacts can be told apart (module docstring).

    Raises:
        SimulationError: if MuJoCo refuses the text, with MuJoCo's reason.
        ConfigError: if a geom's condim is not 3.
    """
    try:
        model = mujoco.MjModel.from_xml_string(xml)
    except ValueError as error:
        raise SimulationError(
            f"model: expected MJCF that compiles; MuJoCo says: {str(error).splitlines()[0]}"
        ) from error
    if (model.geom_condim != 3).any():
        name = model.geom(int(np.flatnonzero(model.geom_condim != 3)[0])).name
        raise ConfigError(
            f"geom '{name}': expected condim 3 (only soles get 4, by their pair with the floor), got another"
        )
    return model


def compose(scene: Scene, config: EnvConfig, radii: tuple[float, ...] = ()) -> str:
    """The scene's model as MJCF text: robot, floor, panels, mocap bodies, and the sensors the task
    reads.

    Only sole-on-floor contacts have four dimensions (they resist twisting), all others three: the
    count of constraint rows then tells, without looking at a contact, how many are soles on the
    floor (sim/physics.py).

    Args:
        scene: What to build.
        config: Decides whether the zero-moment point's and the last links' sensors are needed, and
            how much larger panels are.
        radii: Radii of the spheres as simulated [m]; without them the scene's largest.

    Raises:
        ConfigError: if the robot's model is no XML, or lacks something its spec names.
    """
    try:
        root = ET.fromstring(scene.robot.mjcf)
    except ET.ParseError as error:
        raise ConfigError(
            f"robot '{scene.robot.name}': expected its model as MJCF text: {error}"
        ) from error
    world = _section(root, "worldbody")
    base = str(_first(world, "body", scene.robot).get("name"))
    ET.SubElement(
        _section(root, "option"), "flag", autoreset="disable"
    )  # a diverged state stays visible instead of jumping to zero
    ET.SubElement(
        world,
        "light",
        name="sun",
        pos="0.6 -0.6 2",
        dir="-0.3 0.3 -1",
        castshadow="true",
        diffuse="0.7 0.7 0.7",
    )
    ET.SubElement(
        world, "camera", name="front", pos="1.25 -0.85 0.95", xyaxes="0.562 0.827 0 -0.30 0.20 0.93"
    )
    if scene.robot.soles:
        ET.SubElement(
            world,
            "geom",
            name="floor",
            type="plane",
            size="2 2 0.1",
            rgba="0.55 0.58 0.62 1",
            friction="0.8 0.005 0.0001",
        )
    for panel in scene.panels:
        half = tuple(extent + config.inflate for extent in panel.half)
        ET.SubElement(
            world,
            "geom",
            name=panel.name,
            type="box",
            pos=_numbers(panel.centre),
            size=_numbers(half),
            rgba="0.62 0.45 0.30 1",
        )
    _mocap_bodies(world, scene, radii)
    _soles(root, scene.robot)
    _sensors(_section(root, "sensor"), scene.robot, config, base=base)
    if scene.spheres and "nearness" in config.state_extras:
        _links(root, scene.robot)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _mocap_bodies(world: ET.Element, scene: Scene, radii: tuple[float, ...]) -> None:
    marker = {"contype": "0", "conaffinity": "0", "group": "1", "mass": "0"}
    for arm in scene.robot.arms:
        body = ET.SubElement(
            world, "body", name=goal_body(arm.name), mocap="true", pos=_numbers(scene.robot.centre)
        )
        ET.SubElement(
            body,
            "geom",
            marker,
            name=goal_body(arm.name),
            type="sphere",
            size="0.008",
            rgba="0.95 0.25 0.25 1",
        )
    if scene.object_half is not None:
        body = ET.SubElement(
            world, "body", name="object", mocap="true", pos=_numbers(scene.robot.centre)
        )
        ET.SubElement(
            body,
            "geom",
            marker,
            name="object",
            type="box",
            size=_numbers(scene.object_half),
            rgba="0.25 0.70 0.35 0.6",
        )
    for i in range(scene.spheres):
        radius = radii[i] if radii else scene.sphere_radius[1]
        body = ET.SubElement(world, "body", name=sphere_geom(i), mocap="true", pos=f"1 {i} 1")
        ET.SubElement(
            body,
            "geom",
            name=sphere_geom(i),
            type="sphere",
            size=repr(radius),
            rgba="0.75 0.35 0.65 1",
        )


def _soles(root: ET.Element, robot: Robot) -> None:
    """Mark each sole's lower corners with sites, and give its contact with the floor a pair of its
    own.
    """
    contact = _section(root, "contact")
    for sole in robot.soles:
        parent = next(
            (
                body
                for body in root.iter("body")
                for geom in body.findall("geom")
                if geom.get("name") == sole
            ),
            None,
        )
        geom = (
            None
            if parent is None
            else next(geom for geom in parent.findall("geom") if geom.get("name") == sole)
        )
        if parent is None or geom is None or geom.get("type") != "box":
            raise ConfigError(
                f"robot '{robot.name}': expected a box geom called '{sole}' as a sole, found none"
            )
        cx, cy, cz = (float(value) for value in geom.get("pos", "0 0 0").split())
        hx, hy, hz = (float(value) for value in geom.get("size", "").split())
        for i, (sx, sy) in enumerate(((-1, -1), (-1, 1), (1, -1), (1, 1))):
            ET.SubElement(
                parent,
                "site",
                name=sole_corner(sole, i),
                pos=_numbers((cx + sx * hx, cy + sy * hy, cz - hz)),
                size="0.002",
            )
        ET.SubElement(
            contact,
            "pair",
            geom1="floor",
            geom2=sole,
            condim="4",
            friction="1 1 0.02 0.0001 0.0001",
        )


def _sensors(sensor: ET.Element, robot: Robot, config: EnvConfig, *, base: str) -> None:
    for arm in robot.arms:
        ET.SubElement(
            sensor, "framepos", name=palm_sensor(arm.name), objtype="site", objname=arm.palm
        )
    if robot.soles:
        ET.SubElement(sensor, "subtreecom", name="com", body=base)
        ET.SubElement(sensor, "framezaxis", name="upright", objtype="xbody", objname=robot.torso)
        for sole in robot.soles:
            for i in range(4):
                ET.SubElement(
                    sensor,
                    "framepos",
                    name=sole_corner(sole, i),
                    objtype="site",
                    objname=sole_corner(sole, i),
                )
        if config.balance == "com+zmp":
            ET.SubElement(sensor, "subtreelinvel", name="com_velocity", body=base)


def _links(root: ET.Element, robot: Robot) -> None:
    """Sensors of where each arm's last link begins."""
    bearers = {
        str(site.get("name")): str(body.get("name"))
        for body in root.iter("body")
        for site in body.findall("site")
    }
    for arm in robot.arms:
        if arm.palm not in bearers:
            raise ConfigError(
                f"robot '{robot.name}': expected a site called '{arm.palm}' as a palm, found none"
            )
        ET.SubElement(
            _section(root, "sensor"),
            "framepos",
            name=link_sensor(arm.name),
            objtype="xbody",
            objname=bearers[arm.palm],
        )


def _first(parent: ET.Element, tag: str, robot: Robot) -> ET.Element:
    found = parent.find(tag)
    if found is None:
        raise ConfigError(f"robot '{robot.name}': expected a {tag} in its model, found none")
    return found


def _section(root: ET.Element, name: str) -> ET.Element:
    found = root.find(name)
    return ET.SubElement(root, name) if found is None else found


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(f"{value + 0.0:.12g}" for value in values)


def load_model(xml: bytes | None, mjb: bytes | None) -> mujoco.MjModel:
    """Compile the model a log carries, from its attachments as they lie in the file.

    The text is preferred: it compiles to the same model, is not bound to one MuJoCo version, and
    can be judged before it is used.

    Args:
        xml: MJCF text, one zstd frame.
        mjb: MJB, one zstd frame; used when there is no text.

    Raises:
        FormatError: if there is neither, if one is damaged or larger than MAX_BYTES, if the text
            asks for other files, or if MuJoCo refuses it.
    """
    silence()
    if xml is None and mjb is None:
        raise FormatError(
            "no model attached: expected the scene as MJCF text or MJB in the file; record it again"
        )
    try:
        if xml is not None:
            return mujoco.MjModel.from_xml_string(
                self_contained(_expand(xml, "the attached MJCF text"))
            )
        return mujoco.MjModel.from_binary_path(
            "model.mjb", {"model.mjb": _expand(mjb or b"", "the attached MJB")}
        )
    except ValueError as error:
        reason = str(error).splitlines()[0]
        raise FormatError(
            f"the attached model does not load in MuJoCo {mujoco.__version__}, which says: {reason}"
        ) from error


def self_contained(text: bytes) -> str:
    """MJCF text that asks for no other file, written out again from the tree that was judged.

    Writing it out again leaves no room for bytes that two XML parsers read differently.

    Raises:
        FormatError: if it is no MJCF document, declares entities, or names a file, a folder or a
            plugin.
    """
    root = _parse(text)
    if root.tag != _ROOT:
        raise FormatError(
            f"the attached model: expected an MJCF document <{_ROOT}>, got <{root.tag}>"
        )
    for element in root.iter():
        if element.tag in _READS_FILES:
            raise FormatError(
                f"the attached model has <{element.tag}>: expected a model that needs no other file or library"
            )
        for name in element.keys():  # noqa: SIM118 - an Element iterates over its children
            if "file" in name or name in _FOLDERS:
                raise FormatError(
                    f"the attached model has {name}= in <{element.tag}>: expected a model that reads no other file"
                )
    return ET.tostring(root, encoding="unicode")


def _parse(text: bytes) -> ET.Element:
    builder = ET.TreeBuilder()
    parser = expat.ParserCreate()
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.StartDoctypeDeclHandler = _refuse_doctype
    try:
        parser.Parse(text, True)
        return builder.close()
    except (expat.ExpatError, AssertionError) as error:
        raise FormatError(f"the attached model: expected XML, got: {error}") from error


def _refuse_doctype(*_: object) -> None:
    raise FormatError(
        "the attached model declares a document type: expected plain MJCF without entities"
    )


def _expand(data: bytes, what: str) -> bytes:
    try:
        with zstandard.ZstdDecompressor().stream_reader(io.BytesIO(data)) as stream:
            content = stream.read(MAX_BYTES + 1)
    except zstandard.ZstdError as error:
        raise FormatError(f"{what} is damaged: {error}") from error
    if len(content) > MAX_BYTES:
        raise FormatError(
            f"{what} expands to more than {MAX_BYTES >> 20} MiB: not a model this release opens"
        )
    return bytes(content)
