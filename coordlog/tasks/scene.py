"""Scenes as data, and the one place where a robot and a scene become a MuJoCo model.

Fixed obstacles are boxes of the world; spheres, goals and the object are mocap bodies, so their
positions are part of the physics state and a log's initial state restores them. The object and the
goals are markers: nothing collides with them.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

from coordlog.errors import ConfigError, unknown
from coordlog.robots.humanoid import HUMANOID
from coordlog.robots.planar import PLANAR
from coordlog.robots.robot import Robot

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
    task: str = "reach"
    """Name of the task that is done in it (tasks/registry.py)."""

    def __post_init__(self) -> None:
        if (self.object_half is None) != (self.object_box is None):
            raise ConfigError(
                f"scene '{self.name}': an object needs both object_half and object_box, got one of "
                "them"
            )
        if self.object_box is not None and len(self.robot.arms) != 2:
            got = f"got {len(self.robot.arms)}; without an object every arm has a goal of its own"
            raise ConfigError(
                f"scene '{self.name}': an object needs two arms, the left one first, {got}"
            )
        names = [panel.name for panel in self.panels]
        if len(set(names)) != len(names):
            raise ConfigError(
                f"scene '{self.name}': expected panels of different names, got {names}"
            )
        for what in ("object_box", "sphere_box"):
            for low, high in getattr(self, what) or ():
                if not -inf < low <= high < inf:
                    raise ConfigError(
                        f"scene '{self.name}': expected {what} as (low, high) for x, y and z, got "
                        f"({low}, {high})"
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
        Scene("hold", "Goals on both palms that move away slowly for 3 s", HUMANOID, task="hold"),
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


ROBOT_IN_WORLD = "robot_in_world"
"""Name of the model's tuple of geoms that lie in the world but are the robot's own."""


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
