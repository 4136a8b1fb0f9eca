"""Scenes as data, and the one place where a robot and a scene become a MuJoCo model.

Fixed obstacles are boxes of the world; spheres, goals and the object are mocap bodies, so their
positions are part of the physics state and a log's initial state restores them. The object and the
goals are markers: nothing collides with them.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass

from coordlog.errors import ConfigError, unknown
from coordlog.robots.humanoid import HUMANOID
from coordlog.robots.planar import PLANAR
from coordlog.robots.robot import Robot
from coordlog.tasks.config import EnvConfig

Box3 = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]


@dataclass(frozen=True)
class Panel:
    """A fixed box: centre and half extents [m].

    It must be thicker than any moving capsule's axis is long, less twice the capsule's radius:
    MuJoCo's capsule-box test does not notice a capsule that pierces a box with both ends clear of
    it (tests/tasks/test_scene.py shows it).
    """

    name: str
    centre: tuple[float, float, float]
    half: tuple[float, float, float]


@dataclass(frozen=True)
class Scene:
    """One setting of the task: a robot, what stands around it, and where goals are drawn."""

    name: str
    doc: str
    robot: Robot
    panels: tuple[Panel, ...] = ()
    object_half: tuple[float, float, float] | None = None
    """Half extents of the object [m]; its left and right faces are the goals.

    None: every arm has a goal of its own.
    """
    object_box: Box3 | None = None
    """Where the object's centre is drawn, (x, y, z) ranges [m]."""
    palm_offset: float = 0.0
    """Goals are this far to the left and right of the object's centre [m]."""
    spheres: int = 0
    """Sphere obstacles, drawn per episode and part of the policy state."""
    sphere_radius: tuple[float, float] = (0.03, 0.06)
    """Range of their radii [m]."""
    sphere_box: Box3 | None = None
    """Where their centres are drawn, (x, y, z) ranges [m]."""

    def __post_init__(self) -> None:
        if (self.object_half is None) != (self.object_box is None):
            raise ConfigError(
                f"scene '{self.name}': an object needs both object_half and object_box, got one of them"
            )
        if self.object_box is not None and len(self.robot.arms) != 2:
            got = f"got {len(self.robot.arms)}; without an object every arm has a goal of its own"
            raise ConfigError(
                f"scene '{self.name}': an object needs two arms, the left one first, {got}"
            )
        if self.spheres and self.sphere_box is None:
            raise ConfigError(
                f"scene '{self.name}': spheres need a sphere_box to be drawn in, got none"
            )


def _table(
    *, edge: float, top: float, depth: float, half_width: float, half_thickness: float = 0.03
) -> tuple[Panel, ...]:
    return (
        Panel(
            "table",
            (edge + depth / 2, 0.0, top - half_thickness),
            (depth / 2, half_width, half_thickness),
        ),
    )


def _shelf(
    *,
    edge: float,
    depth: float,
    bottom: float,
    ceiling: float,
    half_width: float,
    half: float = 0.03,
) -> tuple[Panel, ...]:
    x, middle, height = edge + depth / 2, (bottom + ceiling) / 2, (ceiling - bottom) / 2
    return (
        Panel("shelf_bottom", (x, 0.0, bottom - half), (depth / 2, half_width + 2 * half, half)),
        Panel("shelf_top", (x, 0.0, ceiling + half), (depth / 2, half_width + 2 * half, half)),
        Panel(
            "shelf_back",
            (edge + depth + half, 0.0, middle),
            (half, half_width + 2 * half, height + 2 * half),
        ),
        Panel("shelf_left", (x, half_width + half, middle), (depth / 2, half, height)),
        Panel("shelf_right", (x, -half_width - half, middle), (depth / 2, half, height)),
    )


CUBE = (0.04, 0.04, 0.04)
BOOK = (0.05, 0.02, 0.07)
AIR: Box3 = ((0.14, 0.38), (-0.10, 0.10), (0.42, 0.80))

SCENES = {
    scene.name: scene
    for scene in (
        Scene(
            "free",
            "A cube anywhere in the air in front of the robot",
            HUMANOID,
            (),
            CUBE,
            AIR,
            0.06,
        ),
        Scene(
            "spheres",
            "The same among three spheres whose places and sizes change every episode",
            HUMANOID,
            (),
            CUBE,
            AIR,
            0.06,
            spheres=3,
            sphere_box=((0.10, 0.48), (-0.35, 0.35), (0.35, 0.90)),
        ),
        Scene(
            "table",
            "A cube on a table that stands between the hands and it",
            HUMANOID,
            _table(edge=0.18, top=0.46, depth=0.30, half_width=0.30),
            CUBE,
            ((0.22, 0.36), (-0.10, 0.10), (0.50, 0.50)),
            0.06,
        ),
        Scene(
            "shelf",
            "A book in a shelf, boards above and below, walls around",
            HUMANOID,
            _shelf(edge=0.24, depth=0.22, bottom=0.50, ceiling=0.74, half_width=0.28),
            BOOK,
            ((0.28, 0.38), (-0.12, 0.12), (0.58, 0.58)),
            0.045,
        ),
        Scene("planar", "Three goals in the plane for the 8-link planar arm", PLANAR),
    )
}
"""The scenes that ship; the first four are the paper's."""


def find(name: str) -> Scene:
    """The scene of that name.

    Raises:
        ConfigError: for an unknown name; the message lists the choices.
    """
    if name not in SCENES:
        raise unknown("scene", name, [*SCENES, "a FILE.py:NAME of your own"])
    return SCENES[name]


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


def goal_body(arm: str) -> str:
    """Name of the mocap body that marks an arm's goal."""
    return f"goal_{arm}"


def palm_sensor(arm: str) -> str:
    """Name of the sensor that reads an arm's palm position."""
    return f"palm_{arm}"


def link_sensor(arm: str) -> str:
    """Name of the sensor that reads where an arm's last link, which bears its palm, begins."""
    return f"link_{arm}"


def sphere_geom(index: int) -> str:
    """Name of a sphere obstacle's geom, and of its mocap body."""
    return f"sphere_{index}"


def sole_corner(sole: str, index: int) -> str:
    """Name of the site at one lower corner of a sole."""
    return f"{sole}_corner_{index}"


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
