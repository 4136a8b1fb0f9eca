"""The 27-DoF humanoid with a 5-joint spine, as our own MJCF.

Kinematics, masses and motors are those measured for Poppy (Lapeyre et al., Inria Flowers) with the
ankle roll and the mass the paper's robot has (27 DoF, 84 cm; mass 3.5 kg). Shapes are primitives of
our own. x forward, y left, z up; metres, kg, degrees. At q = 0 (arms hanging, legs straight, head
level) every body frame is aligned with the world. Only the left side is written down; the right is
its mirror image.
"""

from __future__ import annotations

from math import radians
from typing import NamedTuple

from coordlog.robots.robot import Arm, Robot

Numbers = tuple[float, ...]


class Motor(NamedTuple):
    """A servo at 12 V: stiffness stands in for its integral term, torque limits are the data
    sheet's.
    """

    kp: float  # N·m/rad
    damping: float  # N·m·s/rad: stall torque / no-load speed
    armature: float  # kg·m²
    friction: float  # N·m
    torque: float  # N·m


MOTORS = {
    "MX-28": Motor(100, 0.434, 0.005, 0.04, 2.5),
    "MX-64": Motor(240, 0.909, 0.012, 0.09, 6.0),
    "AX-12": Motor(60, 0.243, 0.003, 0.03, 1.5),
}


class Shape(NamedTuple):
    """A box or ellipsoid (place = centre, size = half extents) or a capsule (place = both ends,
    size = radius).
    """

    kind: str
    place: Numbers
    size: Numbers


class Link(NamedTuple):
    """A body, and the joint that carries it: `turn` is joint name, axis, range and motor."""

    name: str
    parent: str
    origin: Numbers
    turn: tuple[str, str, Numbers, str] | None
    mass: float
    com: Numbers
    inertia: Numbers  # xx yy zz xy xz yz, at the centre of mass
    shapes: tuple[Shape, ...]


def box(x: float, y: float, z: float, *half: float) -> Shape:
    """A box by its centre and half extents."""
    return Shape("box", (x, y, z), half)


def capsule(*ends: float, radius: float) -> Shape:
    """A capsule by both ends of its axis and its radius."""
    return Shape("capsule", ends, (radius,))


# fmt: off
TRUNK = (
    Link("pelvis", "", (0, 0, .446), None, .21115, (.0004, 0, .00196),
         (.0001624, .0001161, .000107, 0, 3.998e-6, 0), (box(.002, 0, -.003, .022, .034, .043),)),
    Link("abs_motors", "pelvis", (.017, 0, .061), ("abs_y", "y", (-12, 50), "MX-64"), .31759,
         (-.01957, 0, .01336),
         (.0001236, .0002874, .0002489, 0, -4.052e-6, 0), (box(-.021, 0, .017, .045, .024, .031),)),
    Link("abdomen", "abs_motors", (0, 0, 0), ("abs_x", "x", (-45, 45), "MX-64"), .0438,
         (-.0223, 0, .04453),
         (2.691e-5, 6.769e-5, 6.826e-5, 0, 4.502e-7, 0), (box(-.021, 0, .053, .049, .032, .007),)),
    Link("spine", "abdomen", (0, 0, .05164), ("abs_z", "z", (-90, 90), "MX-28"), .10569,
         (-.0101, 0, .02885),
         (3.724e-5, 4.388e-5, 3.115e-5, 0, 1.682e-6, 0), (box(-.01, 0, .035, .024, .022, .032),)),
    Link("bust_motors", "spine", (.0028, 0, .07985), ("bust_y", "y", (-27, 67), "MX-28"), .18127,
         (-.01743, 0, .01052),
         (4.863e-5, .0001152, .000102, 0, -1.503e-6, 0), (box(-.019, 0, .013, .04, .021, .025),)),
    Link("chest", "bust_motors", (0, 0, 0), ("bust_x", "x", (-40, 40), "MX-28"), .31405,
         (-.01055, 0, .05149),
         (.0008224, .0001847, .000897, 0, 1.834e-6, 0), (box(-.018, 0, .052, .043, .077, .031),)),
    Link("neck", "chest", (.005, 0, .084), ("head_z", "z", (-90, 90), "AX-12"), .00671,
         (0, 0, .00928),
         (2.934e-6, 8.271e-7, 2.662e-6, 0, 1.771e-11, 0),
         (capsule(0, 0, .008, 0, 0, .02, radius=.01),)),
    Link("head", "neck", (0, 0, .02), ("head_y", "y", (-26, 25), "AX-12"), .24254,
         (-.01325, 0, .03274),
         (.0005102, .0004545, .0004947, 0, -2.787e-5, 0),
         (Shape("ellipsoid", (-.0153, 0, .0403), (.0649, .0666, .0569)),)),
)
LEFT = (
    Link("l_shoulder", "chest", (.004, .0771, .05), ("l_shoulder_y", "y", (-210, 65), "MX-28"),
         .00956, (-.00916, .01051, .00176),
         (2.092e-6, 3.844e-6, 4.033e-6, 3.371e-8, 1.223e-8, -5.245e-8),
         (box(-.0085, .02, .002, .0235, .02, .018),)),
    Link("l_shoulder_motor", "l_shoulder", (0, .0284, 0),
         ("l_shoulder_x", "x", (-20, 195), "MX-28"), .09455, (-.0086, 0, -.01258),
         (2.585e-5, 3.157e-5, 1.877e-5, 0, 8.259e-7, 0),
         (box(-.007, 0, -.0155, .024, .019, .027),)),
    Link("l_upper_arm", "l_shoulder_motor", (-.0185, 0, -.03625),
         ("l_arm_z", "z", (-105, 105), "MX-28"), .19182,
         (.01064, 3e-5, -.06283), (.0003148, .0003204, 4.829e-5, -4.055e-9, 3.549e-6, -6.881e-7),
         (capsule(.011, 0, -.026, .01, 0, -.1, radius=.024),)),
    Link("l_forearm", "l_upper_arm", (.01, 0, -.11175), ("l_elbow_y", "y", (-148, 1), "MX-28"),
         .05548,
         (-.00499, .00692, -.10716), (.0002084, .0002119, 1.723e-5, 1.033e-7, -1.549e-5, -8.347e-6),
         (capsule(-.008, .002, -.012, -.005, .008, -.105, radius=.02),
         capsule(-.003, .007, -.125, -.006, .007, -.193, radius=.018))),
    Link("l_hip", "pelvis", (0, .02254, 0), ("l_hip_x", "x", (-28.5, 30), "MX-28"), .09621,
         (-.00494, .04193, .01906),
         (2.462e-5, 3.202e-5, 3.231e-5, -7.553e-7, -1.649e-6, 1.403e-6),
         (box(-.005, .036, .014, .029, .027, .025),)),
    Link("l_hip_motor", "l_hip", (.005, .044, 0), ("l_hip_z", "z", (-90, 25), "MX-28"), .15798,
         (-.0135, -.00013, -.02289),
         (4.354e-5, 5.586e-5, 6.834e-5, 4.563e-7, 1.515e-6, 2.227e-8),
         (box(-.017, 0, -.022, .031, .024, .022),)),
    Link("l_thigh", "l_hip_motor", (0, 0, -.024), ("l_hip_y", "y", (-104, 84), "MX-64"), .13814,
         (.00052, -.01925, -.1416),
         (.0004348, .0004198, 6.131e-5, -2.623e-6, -5.336e-6, 5.647e-5),
         (capsule(0, 0, -.025, .004, -.02, -.165, radius=.027),)),
    Link("l_shin", "l_thigh", (0, 0, -.182), ("l_knee_y", "y", (-3.5, 134), "MX-28"), .12742,
         (.00151, -.0229, -.13704),
         (.0004379, .000434, 4.389e-5, 9.268e-9, 1.91e-5, 6.283e-7),
         (capsule(.004, -.023, -.015, .001, -.023, -.162, radius=.025),)),
    Link("l_ankle", "l_shin", (0, 0, -.18), ("l_ankle_y", "y", (-45, 45), "MX-28"), .11408,
         (0, -.0225, -.0125),
         (3.639e-5, 3.639e-5, 2.41e-5, 0, 0, 0), (box(0, -.0225, -.0125, .0178, .0178, .0125),)),
    Link("l_foot", "l_ankle", (0, -.0225, -.025), ("l_ankle_x", "x", (-30, 30), "MX-28"), .05335,
         (.02684, .00207, -.02333),
         (2.046e-5, 9.283e-5, .000101, 2.762e-6, -3.684e-6, -2.042e-7),
         (box(.029, .0028, -.0235, .0715, .0262, .0115),)),
)
# fmt: on

PALMS = {
    "l_forearm": ("left_palm", (0.0, 0.006, -0.160)),
    "r_forearm": ("right_palm", (0.0, -0.006, -0.160)),
}
SOLES = ("l_foot", "r_foot")
NEVER_COLLIDE = (
    ("l_hip", "l_thigh"),
    ("r_hip", "r_thigh"),
    ("pelvis", "l_hip_motor"),
    ("pelvis", "r_hip_motor"),
    ("chest", "head"),
    ("chest", "l_shoulder_motor"),
    ("chest", "r_shoulder_motor"),
    ("abs_motors", "l_hip"),
    ("abs_motors", "r_hip"),
)
"""Neighbours whose shapes overlap somewhere in their joints' ranges without meaning a real
collision."""

COLOURS = {"l": "0.26 0.52 0.80 1", "r": "0.90 0.52 0.32 1", "": "0.80 0.80 0.82 1"}


def mirrored(link: Link) -> Link:
    """The right-hand link for a left-hand one: y, roll and yaw change sign."""
    assert link.turn is not None
    joint, axis, (low, high), motor = link.turn
    limits = (low, high) if axis == "y" else (-high, -low)
    xx, yy, zz, xy, xz, yz = link.inertia
    return Link(
        _right(link.name),
        _right(link.parent),
        _flip(link.origin),
        (_right(joint), axis, limits, motor),
        link.mass,
        _flip(link.com),
        (xx, yy, zz, -xy, xz, -yz),
        tuple(Shape(shape.kind, _flip(shape.place), shape.size) for shape in link.shapes),
    )


def _right(name: str) -> str:
    return "r_" + name[2:] if name.startswith("l_") else name


def _flip(place: Numbers) -> Numbers:
    return tuple(-value if i % 3 == 1 else value for i, value in enumerate(place))


LINKS = TRUNK + LEFT + tuple(mirrored(link) for link in LEFT)


def _text(values: Numbers) -> str:
    return " ".join(f"{value + 0.0:.10g}" for value in values)


def _geom(link: Link, i: int, shape: Shape) -> str:
    name = f"{link.name}_sole" if link.name in SOLES else f"{link.name}_{i}"
    place = "fromto" if shape.kind == "capsule" else "pos"
    colour = COLOURS[link.name[0] if link.name[1:2] == "_" else ""]
    return (
        f'<geom name="{name}" type="{shape.kind}" {place}="{_text(shape.place)}" '
        f'size="{_text(shape.size)}" rgba="{colour}"/>'
    )


def _body(link: Link) -> str:
    lines = [f'<body name="{link.name}" pos="{_text(link.origin)}">']
    if link.turn is None:
        lines.append('<freejoint name="base"/>')
    else:
        joint, axis, limits, motor = link.turn
        direction = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}[axis]
        lines.append(
            f'<joint name="{joint}" class="{motor}" axis="{direction}" range="{_text(limits)}"/>'
        )
    lines.append(
        f'<inertial mass="{link.mass:g}" pos="{_text(link.com)}" '
        f'fullinertia="{_text(link.inertia)}"/>'
    )
    lines += [_geom(link, i, shape) for i, shape in enumerate(link.shapes)]
    if link.name in PALMS:
        site, place = PALMS[link.name]
        lines.append(f'<site name="{site}" pos="{_text(place)}"/>')
    lines += [_body(child) for child in LINKS if child.parent == link.name]
    return "\n".join([*lines, "</body>"])


def _default(name: str, motor: Motor) -> str:
    return (
        f'<default class="{name}"><joint damping="{motor.damping:g}" armature="{motor.armature:g}" '
        f'frictionloss="{motor.friction:g}"/>'
        f'<position kp="{motor.kp:g}" forcerange="{-motor.torque:g} {motor.torque:g}"/></default>'
    )


def mjcf() -> str:
    """The robot alone, standing at the origin and facing +x, as one MJCF document."""
    turns = [link.turn for link in LINKS if link.turn is not None]
    servos = [
        f'<position name="{name}" joint="{name}" class="{motor}" inheritrange="1"/>'
        for name, _, _, motor in turns
    ]
    excludes = [f'<exclude body1="{first}" body2="{second}"/>' for first, second in NEVER_COLLIDE]
    lines = [
        '<mujoco model="humanoid">',
        '<compiler angle="degree" autolimits="true" inertiafromgeom="false"/>',
        '<option timestep="0.004" integrator="implicitfast" cone="pyramidal"/>',
        "<default>",
        *(_default(name, motor) for name, motor in MOTORS.items()),
        '<geom friction="0.8 0.005 0.0001"/>',
        "</default>",
        "<worldbody>",
        _body(LINKS[0]),
        "</worldbody>",
        "<contact>",
        *excludes,
        "</contact>",
        "<actuator>",
        *servos,
        "</actuator>",
        "</mujoco>",
    ]
    return "\n".join(lines) + "\n"


def _pose(**degrees: float) -> dict[str, float]:
    """A pose by the left arm's angles; the right arm mirrors it (roll changes sign)."""
    left = {f"l_{name}": radians(value) for name, value in degrees.items()}
    right = {
        f"r_{name}": radians(-value if name in ("shoulder_x", "arm_z") else value)
        for name, value in degrees.items()
    }
    return left | right


HUMANOID = Robot(
    name="humanoid",
    mjcf=mjcf(),
    arms=(
        Arm("left", "left_palm", ("l_shoulder_y", "l_shoulder_x", "l_arm_z", "l_elbow_y")),
        Arm("right", "right_palm", ("r_shoulder_y", "r_shoulder_x", "r_arm_z", "r_elbow_y")),
    ),
    shared=("abs_y", "abs_x", "abs_z", "bust_y", "bust_x"),
    soles=("l_foot_sole", "r_foot_sole"),
    torso="chest",
    poses={
        "neutral": {},
        "stand": _pose(shoulder_x=20, shoulder_y=10, elbow_y=-20),
        "home": _pose(shoulder_x=20, elbow_y=-90),
    },
    centre=(0.1, 0.0, 0.6),
    reach=0.5,
)
