"""The 8-link planar arm with three end effectors of the original DiGrad paper (arXiv 1802.10463).

The paper gives no dimensions. Our reading: two shared base links, then three branches of two links
each; links of 0.1 m, hinges about z, no gravity, no obstacles, no balance. It learns in a minute
and keeps everything honest about k = 3.
"""

from __future__ import annotations

from math import pi

from coordlog.robots.robot import Arm, Robot

LENGTH = 0.1
BRANCHES = ("left", "middle", "right")
FAN = 0.9
"""Rest angle between neighbouring branches [rad]: at q = 0 they spread like a hand."""


def _link(name: str, inner: str, *, at: float, turned: float = 0.0, limit: float = 2.0) -> str:
    return (
        f'<body name="{name}" pos="{at:g} 0 0" euler="0 0 {turned:g}"><joint name="{name}" axis="0 '
        f'0 1" range="{-limit:g} {limit:g}"/>'
        f'<geom name="{name}_0" type="capsule" fromto="0 0 0 {LENGTH:g} 0 0" '
        f'size="0.008"/>{inner}</body>'
    )


def mjcf() -> str:
    """The arm alone, its base at the origin, stretched along +x at q = 0."""
    branches = ""
    for i, name in enumerate(BRANCHES):
        palm = f'<site name="{name}_palm" pos="{LENGTH:g} 0 0"/>'
        branches += _link(
            f"{name}_1", _link(f"{name}_2", palm, at=LENGTH), at=LENGTH, turned=FAN * (1 - i)
        )
    tree = _link("base_1", _link("base_2", branches, at=LENGTH), at=0.0, limit=pi)
    servos = "".join(
        f'<position name="{name}" joint="{name}" kp="1" inheritrange="1"/>'
        for name in PLANAR_JOINTS
    )
    return (
        '<mujoco model="planar">\n<compiler angle="radian" autolimits="true"/>\n'
        '<option timestep="0.004" integrator="implicitfast" gravity="0 0 0"/>\n'
        # The links may pass over one another: they lie in different planes in the paper's drawing,
        # so nothing collides.
        '<default><joint damping="0.05" armature="0.001"/>'
        '<geom mass="0.05" contype="0" conaffinity="0" rgba="0.26 0.52 0.80 1"/></default>\n'
        f"<worldbody>\n{tree}\n</worldbody>\n<actuator>{servos}</actuator>\n</mujoco>\n"
    )


PLANAR_JOINTS = ("base_1", "base_2", *(f"{name}_{i}" for name in BRANCHES for i in (1, 2)))

PLANAR = Robot(
    name="planar",
    mjcf=mjcf(),
    arms=tuple(Arm(name, f"{name}_palm", (f"{name}_1", f"{name}_2")) for name in BRANCHES),
    shared=("base_1", "base_2"),
    poses={"stand": {}},
    centre=(0.0, 0.0, 0.0),
    reach=0.4,
)
