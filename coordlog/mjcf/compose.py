"""A robot and a scene become one model: floor, panels, mocap bodies, and the sensors the task
reads, added to the robot's own spec.
"""

from __future__ import annotations

from math import pi
from typing import Any

import mujoco
import numpy as np

from coordlog.errors import ConfigError, SimulationError
from coordlog.mjcf.attached import require_size
from coordlog.mjcf.demands import leave_out, some, switched, unknown_names
from coordlog.mjcf.printing import Source, printed, refusal
from coordlog.mjcf.servos import HINGE, SLIDE, free_name, make_servos
from coordlog.mjcf.soles import corners
from coordlog.mjcf.source import spec_of
from coordlog.robots.robot import Robot
from coordlog.tasks.config import EnvConfig
from coordlog.tasks.scene import (
    ROBOT_IN_WORLD,
    Scene,
    goal_body,
    link_sensor,
    palm_sensor,
    sole_corner,
    sphere_geom,
)

SITE, BODY = mujoco.mjtObj.mjOBJ_SITE, mujoco.mjtObj.mjOBJ_BODY
FRAME, GEOM = mujoco.mjtObj.mjOBJ_XBODY, mujoco.mjtObj.mjOBJ_GEOM
BOX, SPHERE = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_SPHERE
LIMITED = mujoco.mjtLimited.mjLIMITED_TRUE
SOLID: dict[str, Any] = {"condim": 3, "margin": 0, "gap": 0, "group": 0, "priority": 0}
MARKER: dict[str, Any] = {"contype": 0, "conaffinity": 0, "group": 1, "mass": 0}
OURS = ("sun", "front", "com", "com_velocity", "upright")
SENSORS = {
    "position": mujoco.mjtSensor.mjSENS_FRAMEPOS,
    "up": mujoco.mjtSensor.mjSENS_FRAMEZAXIS,
    "com": mujoco.mjtSensor.mjSENS_SUBTREECOM,
    "velocity": mujoco.mjtSensor.mjSENS_SUBTREELINVEL,
}


def compose(scene: Scene, config: EnvConfig, radii: tuple[float, ...] = ()) -> Source:
    """The scene's model: what an environment compiles, and what a log holds.

    Soles get a contact pair of their own with the floor, which resists twisting.

    Args:
        scene: What to build.
        config: Decides whether the zero-moment point's and the last links' sensors are needed, and
            how much larger panels are.
        radii: Radii of the spheres as simulated [m]; without them the scene's largest.

    Raises:
        ConfigError: naming all that the robot's spec asks for and its model does not have.
        SimulationError: if MuJoCo refuses what was composed.
    """
    spec, assets = spec_of(scene.robot)
    leave_out(spec, scene.robot)
    _name(spec)
    _fit(spec, scene)
    world = spec.worldbody
    base = _base(spec, scene.robot)
    _mark_own(spec)
    solid = _solid(spec)
    # A diverged state stays visible instead of jumping to zero.
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    _lit(world)
    if scene.robot.soles:
        floor = {
            "size": (2, 2, 0.1),
            "rgba": (0.55, 0.58, 0.62, 1),
            "friction": (0.8, 0.005, 0.0001),
        }
        world.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, **floor, **solid)
    for panel in scene.panels:
        half = [extent + config.inflate for extent in panel.half]
        pos, size = _rounded(panel.centre), _rounded(half)
        box = {"type": BOX, "pos": pos, "size": size, "rgba": (0.62, 0.45, 0.30, 1)}
        world.add_geom(name=panel.name, **box, **solid)
    _goals(world, scene)
    for i in range(scene.spheres):
        radius = radii[i] if radii else scene.sphere_radius[1]
        body = world.add_body(name=sphere_geom(i), mocap=True, pos=(1, i, 1))
        ball = {"type": SPHERE, "size": (radius, 0, 0), "rgba": (0.75, 0.35, 0.65, 1)}
        body.add_geom(name=sphere_geom(i), **ball, **solid)
    _soles(spec, scene.robot)
    _sensors(spec, scene.robot, config, base=base)
    if scene.spheres and "nearness" in config.state_extras:
        for arm in scene.robot.arms:
            bearer = spec.site(arm.palm).parent.name
            _sense(spec, link_sensor(arm.name), "position", FRAME, bearer)
    try:
        spec.compile()
    except ValueError as error:
        raise SimulationError(refusal(error)) from error
    source = Source(printed(spec), assets)
    require_size(source, f"robot '{scene.robot.name}'")
    return source


def _lit(world: Any) -> None:
    """A light, and a camera in front of the robot."""
    light = {"castshadow": True, "diffuse": (0.7, 0.7, 0.7)}
    world.add_light(name="sun", pos=(0.6, -0.6, 2), dir=(-0.3, 0.3, -1), **light)
    camera = world.add_camera(name="front", pos=(1.25, -0.85, 0.95))
    camera.alt.type = mujoco.mjtOrientation.mjORIENTATION_XYAXES
    camera.alt.xyaxes = (0.562, 0.827, 0, -0.30, 0.20, 0.93)


def with_radii(source: Source, radii: tuple[float, ...]) -> Source:
    """The same model with spheres of other radii [m]."""
    spec = mujoco.MjSpec.from_string(source.text)
    spec.assets = dict(source.assets)
    for i, radius in enumerate(radii):
        spec.geom(sphere_geom(i)).size[0] = radius
    try:
        spec.compile()
    except ValueError as error:
        raise SimulationError(refusal(error)) from error
    return Source(printed(spec), source.assets)


def _fit(spec: mujoco.MjSpec, scene: Scene) -> None:
    """Give the robot what its spec asks for and its model lacks: servos, ranges, palms.

    Raises:
        ConfigError: one sentence for each thing that cannot be had, all together.
    """
    robot = scene.robot
    faults = _taken(spec, scene) + switched(spec) + unknown_names(spec, robot)
    faults += [
        f"its spec names a joint '{name}', but its model has "
        f"{some(joint.name for joint in spec.joints)}"
        for name in robot.action_joints
        if spec.joint(name) is None
    ]
    for name in robot.action_joints:
        joint = spec.joint(name)
        if joint is not None and joint.type not in (HINGE, SLIDE):
            faults.append(f"joint '{name}' is a ball or a free joint: expected a hinge or a slide")
        elif joint is not None:
            faults += _range(spec, robot, joint)
    faults += make_servos(spec, robot)
    for arm in robot.arms:
        if spec.site(arm.palm) is not None:
            continue
        body = spec.body(arm.palm)
        if body is None:
            faults.append(
                f"arm '{arm.name}': expected a site or a body called '{arm.palm}' as its palm, "
                "found none"
            )
        else:
            body.add_site(name=arm.palm, pos=arm.at)
    for one, other in robot.excludes:
        if spec.body(one) is None or spec.body(other) is None:
            faults.append(f"excludes name bodies '{one}' and '{other}', not both of which it has")
        else:
            spec.add_exclude(bodyname1=one, bodyname2=other)
    faults += [
        f"expected a geom called '{sole}' as a sole, found none"
        for sole in robot.soles
        if spec.geom(sole) is None
    ]
    if robot.soles and spec.body(robot.torso) is None:
        faults.append(f"expected a body called '{robot.torso}' as its torso, found none")
    if len(spec.bodies) < 2:
        faults.append("expected a body in its model, found none")
    if faults:
        raise ConfigError(f"robot '{robot.name}': {'; '.join(faults)}")


def _taken(spec: mujoco.MjSpec, scene: Scene) -> list[str]:
    """Names that the scene adds and the robot's model has already."""
    bodies = [goal_body(arm.name) for arm in scene.robot.arms]
    bodies += ["object"] * (scene.object_half is not None)
    bodies += [sphere_geom(i) for i in range(scene.spheres)]
    geoms = bodies + ["floor"] * bool(scene.robot.soles) + [panel.name for panel in scene.panels]
    said = "which the scene adds under that name: give yours another"
    return [f"its model has a body '{name}', {said}" for name in bodies if spec.body(name)] + [
        f"its model has a geom '{name}', {said}" for name in geoms if spec.geom(name)
    ]


def _range(spec: mujoco.MjSpec, robot: Robot, joint: Any) -> list[str]:
    """A range for a joint without one: the spec's, or all the way round."""
    low, high = joint.range
    auto = joint.limited == mujoco.mjtLimited.mjLIMITED_AUTO and spec.compiler.autolimits
    if (joint.limited == LIMITED or auto) and low < high:
        return []
    if joint.name in robot.ranges or joint.type == HINGE:
        wanted = np.array(robot.ranges.get(joint.name, (-pi, pi)))
        if joint.type == HINGE and spec.compiler.degree:
            wanted = np.degrees(wanted)
    else:
        return [
            f"expected a range for joint '{joint.name}', which the action moves and is a slide; "
            "its model has none: "
            f"say ranges={{'{joint.name}': (low, high)}}"
        ]
    joint.limited, joint.range = LIMITED, wanted
    return []


def _base(spec: mujoco.MjSpec, robot: Robot) -> str:
    """Name of the body that the first palm's tree begins with."""
    body = spec.site(robot.arms[0].palm).parent
    while body.parent is not None and body.parent.name != "world":
        body = body.parent
    if not body.name:
        body.name = free_name(spec.body, f"{robot.name}_base")
    return str(body.name)


def _name(spec: mujoco.MjSpec) -> None:
    """Give every geom a name: what touches what is said by names. What nobody refers to gives way
    to names of ours.
    """
    for things, lookup in (
        (spec.sensors, spec.sensor),
        (spec.lights, spec.light),
        (spec.cameras, spec.camera),
    ):
        for thing in things:
            if _is_ours(thing.name):
                thing.name = free_name(lookup, f"{thing.name} of the model")
    for i, geom in enumerate(spec.worldbody.geoms):
        # MuJoCo reads the names of a tuple (_mark_own) as a list, parted by blanks
        plain = "_".join(geom.name.split()) or f"world_geom_{i}"
        if plain != geom.name:
            _rename(spec, geom, free_name(spec.geom, plain))
    for body in spec.bodies:
        for i, geom in enumerate(body.geoms):
            geom.name = geom.name or free_name(spec.geom, f"geom {i} of {body.name or 'a body'}")


def _is_ours(name: str) -> bool:
    """Whether a sensor, a light or a camera of ours may have this name."""
    return name in OURS or name.startswith(("palm_", "link_")) or "_corner_" in name


def _rename(spec: mujoco.MjSpec, geom: Any, name: str) -> None:
    for pair in spec.pairs if geom.name else ():
        if pair.geomname1 == geom.name:
            pair.geomname1 = name
        if pair.geomname2 == geom.name:
            pair.geomname2 = name
    geom.name = name


def _mark_own(spec: mujoco.MjSpec) -> None:
    """Remember which geoms of the world are the robot's own, and no obstacles of the scene."""
    own = list(spec.worldbody.geoms)
    if own:
        spec.add_tuple(
            name=ROBOT_IN_WORLD,
            objtype=[int(GEOM)] * len(own),
            objname=[geom.name for geom in own],
            objprm=[0.0] * len(own),
        )


def _solid(spec: mujoco.MjSpec) -> dict[str, Any]:
    """What makes a geom of the scene collide with whatever of the robot collides at all, whatever
    the robot's default class says.
    """
    bits = 1
    for geom in spec.geoms:
        bits |= int(geom.contype) | int(geom.conaffinity)
    return {"contype": bits, "conaffinity": bits, **SOLID}


def _goals(world: Any, scene: Scene) -> None:
    for arm in scene.robot.arms:
        body = world.add_body(name=goal_body(arm.name), mocap=True, pos=scene.robot.centre)
        ball = {"type": SPHERE, "size": (0.008, 0, 0), "rgba": (0.95, 0.25, 0.25, 1)}
        body.add_geom(name=goal_body(arm.name), **ball, **MARKER)
    if scene.object_half is not None:
        body = world.add_body(name="object", mocap=True, pos=scene.robot.centre)
        box = {"type": BOX, "size": scene.object_half, "rgba": (0.25, 0.70, 0.35, 0.6)}
        body.add_geom(name="object", **box, **MARKER)


def _soles(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Mark each sole's lower corners with sites, and give its contact with the floor a pair of its
    own.
    """
    if not robot.soles:
        return
    for sole, places in corners(spec, robot).items():
        for i, place in enumerate(places):
            spec.geom(sole).parent.add_site(
                name=sole_corner(sole, i), pos=_rounded(place), size=(0.002, 0, 0)
            )
        spec.add_pair(
            geomname1="floor", geomname2=sole, condim=4, friction=(1, 1, 0.02, 0.0001, 0.0001)
        )


def _sensors(spec: mujoco.MjSpec, robot: Robot, config: EnvConfig, *, base: str) -> None:
    for arm in robot.arms:
        _sense(spec, palm_sensor(arm.name), "position", SITE, arm.palm)
    if robot.soles:
        _sense(spec, "com", "com", BODY, base)
        _sense(spec, "upright", "up", FRAME, robot.torso)
        for sole in robot.soles:
            for i in range(4):
                _sense(spec, sole_corner(sole, i), "position", SITE, sole_corner(sole, i))
        if config.balance == "com+zmp":
            _sense(spec, "com_velocity", "velocity", BODY, base)


def _sense(spec: mujoco.MjSpec, name: str, what: str, kind: Any, of: str) -> None:
    spec.add_sensor(name=name, type=SENSORS[what], objtype=kind, objname=of)


def _rounded(values: Any) -> list[float]:
    """Coordinates to twelve digits: sums such as 0.1 + 0.2 are meant as written."""
    return [float(f"{value + 0.0:.12g}") for value in values]
