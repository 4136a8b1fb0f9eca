"""A robot in its scene as an image, rendered offscreen; works without a display.

Only a copy of the model is dressed up (light, floor, see-through panels), so a picture costs the
physics and the logs nothing.
"""

from __future__ import annotations

import os
from copy import copy
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from coordlog.episode import Array
from coordlog.errors import SimulationError, StorageError, unknown
from coordlog.kinematics.pairs import obstacles
from coordlog.mjcf.dressed import load_dressed, show_hidden
from coordlog.robots.robot import Robot
from coordlog.sim.env import BatchEnv
from coordlog.tasks.scene import Scene, goal_body, palm_sensor

POSTURES = ("start", "end")
BACKDROP = np.array([0.93, 0.945, 0.96])
FADE = (1.35, 2.0)
"""From the first to the second of these multiples of the camera's distance the floor fades into the
backdrop."""
OVERSAMPLING = 2
"""Pixels rendered per pixel of the image and axis: edges against the backdrop come out smooth."""
SEE_THROUGH = 0.3
"""Opacity of a panel that stands between the camera and a goal."""
_DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")


class View(NamedTuple):
    """Where the camera is: metres and degrees, as MuJoCo's free camera."""

    lookat: tuple[float, float, float]
    distance: float
    azimuth: float
    elevation: float


def view_of(robot: Robot, model: mujoco.MjModel | None = None) -> View:
    """A robot on its feet from ahead of its left, one that moves in a plane from above, any other
    from ahead and a little above.

    Args:
        robot: Where it works, and whether it stands on feet.
        model: What its joints' axes are read from; without it only a robot on feet does not lie in
            a plane.
    """
    x, y, z = robot.centre
    if robot.soles:
        return View((x + 0.05, y, 0.75 * z), 2.7 * robot.reach, 244.0, -13.0)
    if model is None or _is_flat(robot, model):
        return View((x, y, z), 2.7 * robot.reach, 90.0, -89.0)
    return View((x, y, z), 2.6 * robot.reach, 225.0, -20.0)


def _is_flat(robot: Robot, model: mujoco.MjModel) -> bool:
    """Whether all joints of the action turn about the vertical."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    joints = [model.joint(name).id for name in robot.action_joints]
    upright = np.abs(data.xaxis[joints, 2]) > 0.999
    hinges = model.jnt_type[joints] == mujoco.mjtJoint.mjJNT_HINGE
    return bool((upright & hinges).all())


def picture(
    scene: Scene, *, width: int = 960, height: int = 720, seed: int = 0, posture: str = "end"
) -> Array:
    """A scene's first problem of a seed.

    Args:
        scene: What to draw.
        width: Of the image [pixels].
        height: Of the image [pixels].
        seed: Seed of the problem.
        posture: "start" (the robot as an episode starts) or "end" (its palms on their goals, by
            inverse kinematics).

    Returns:
        RGB, shape (height, width, 3), uint8.

    Raises:
        ConfigError: for an unknown posture.
        SimulationError: if there is no way to render here.
    """
    if posture not in POSTURES:
        raise unknown("posture", posture, POSTURES)
    env = BatchEnv(scene, n=1, threads=1)
    problem = env.problem(seed=seed, split="train", index=0)
    env.reset(np.array([0]), [problem])
    qpos = env.physics.qpos[0].copy()
    if posture == "end":
        env.draw.reach.place(problem.spheres)
        angles = env.draw.reach.solve(problem.goals)
        if angles is not None:
            qpos[env.task.qpos_index] = angles
    model = load_dressed(env.attachments(0), env.looks.meshes.get)
    mocap_pos = env.physics.mocap_pos[0]
    return picture_of(
        model, qpos, mocap_pos, view=view_of(scene.robot, model), width=width, height=height
    )


def picture_of(
    model: mujoco.MjModel,
    qpos: Array,
    mocap_pos: Array,
    *,
    view: View,
    width: int = 960,
    height: int = 720,
) -> Array:
    """Any state of any model, a log's too.

    Args:
        model: Robot and scene.
        qpos: Shape (n_q,).
        mocap_pos: Places of goals, object and spheres, shape (n_mocap, 3) [m].
        view: Where the camera is.
        width: Of the image [pixels].
        height: Of the image [pixels].

    Returns:
        RGB, shape (height, width, 3), uint8.

    Raises:
        SimulationError: if there is no way to render here.
    """
    with Painter(model, view=view, width=width, height=height) as painter:
        return painter.paint(qpos, mocap_pos)


def write_png(path: Path, image: Array) -> None:
    """Write an RGB image as PNG.

    Raises:
        StorageError: if the file cannot be written.
    """
    from PIL import Image  # matplotlib brings it; only pictures need it

    try:
        Image.fromarray(image).save(path, format="png")
    except OSError as error:
        raise StorageError(f"{path}: cannot write the picture: {error.strerror}") from error


class Painter:
    """Renders states of one model; keeps the graphics context between images. A context manager."""

    def __init__(self, model: mujoco.MjModel, *, view: View, width: int, height: int) -> None:
        """Make the graphics context.

        Raises:
            SimulationError: if there is none to be had.
        """
        self._width, self._height = width * OVERSAMPLING, height * OVERSAMPLING
        self._view, self._model = view, copy(model)
        _dress(self._model, self._width, self._height)
        self._data = mujoco.MjData(self._model)
        self._scene = mujoco.MjvScene(self._model, maxgeom=2000)
        self._camera = _camera(view)
        self._context, self._canvas = offscreen(self._model, self._width, self._height)

    def paint(self, qpos: Array, mocap_pos: Array, *, sizes: Array | None = None) -> Array:
        """One state as RGB (height, width, 3) uint8.

        `sizes` (n_geom, 3) replace the model's, for spheres that differ by episode [m].
        """
        if sizes is not None:
            solid = self._model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE
            self._model.geom_size[solid] = sizes[solid]
        self._data.qpos[:], self._data.mocap_pos[:] = qpos, mocap_pos
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        _reveal(
            self._model,
            self._data,
            np.array(self._view.lookat) - self._view.distance * self._gaze(),
        )
        colour, depth = self._render()
        fade = np.clip((depth / self._view.distance - FADE[0]) / (FADE[1] - FADE[0]), 0.0, 1.0)[
            ..., None
        ]
        image = colour + (BACKDROP - colour) * (fade * fade * (3.0 - 2.0 * fade))
        shape = (
            self._height // OVERSAMPLING,
            OVERSAMPLING,
            self._width // OVERSAMPLING,
            OVERSAMPLING,
            3,
        )
        return np.asarray(np.round(image.reshape(shape).mean(axis=(1, 3)) * 255), dtype=np.uint8)

    def close(self) -> None:
        """Let go of the graphics context; painting is over."""
        self._context.make_current()
        self._canvas.free()
        self._context.free()

    def __enter__(self) -> Painter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _gaze(self) -> Array:
        azimuth, elevation = np.radians(self._view.azimuth), np.radians(self._view.elevation)
        return np.array(
            [
                np.cos(elevation) * np.cos(azimuth),
                np.cos(elevation) * np.sin(azimuth),
                np.sin(elevation),
            ]
        )

    def _hang_backdrop(self) -> None:
        """A bright wall behind everything: what is see-through would else show black."""
        gaze, away = self._gaze(), (FADE[1] - 1.0) * self._view.distance
        place, turn = np.array(self._view.lookat) + away * gaze, np.zeros(4)
        mujoco.mju_quatZ2Vec(turn, gaze)
        frame = np.zeros(9)
        mujoco.mju_quat2Mat(frame, turn)
        wall, size = (
            self._scene.geoms[self._scene.ngeom],
            np.array([*[4.0 * self._view.distance] * 2, 0.01]),
        )
        mujoco.mjv_initGeom(
            wall,
            mujoco.mjtGeom.mjGEOM_BOX,
            size,
            place,
            frame,
            np.array([*BACKDROP, 1.0], dtype=np.float32),
        )
        wall.emission = 1.0
        self._scene.ngeom += 1

    def _render(self) -> tuple[Array, Array]:
        """Colour in [0, 1], (H, W, 3), and distance along the camera's axis [m], (H, W).

        Top row first.
        """
        options = mujoco.MjvOption()
        options.sitegroup[:] = 0
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(
            self._model, self._data, options, None, self._camera, everything, self._scene
        )
        self._hang_backdrop()
        self._context.make_current()
        area = mujoco.MjrRect(0, 0, self._width, self._height)
        colour = np.empty((self._height, self._width, 3), dtype=np.uint8)
        window = np.empty((self._height, self._width), dtype=np.float32)
        mujoco.mjr_render(area, self._scene, self._canvas)
        mujoco.mjr_readPixels(colour, None, area, self._canvas)
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = (
            1  # what is see-through is at its distance too
        )
        mujoco.mjr_render(area, self._scene, self._canvas)
        mujoco.mjr_readPixels(None, window, area, self._canvas)
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = 0
        near, far = (
            getattr(self._model.vis.map, name) * self._model.stat.extent
            for name in ("znear", "zfar")
        )
        depth = near * far / (far - window[::-1].astype(np.float64) * (far - near))
        return colour[::-1] / 255.0, depth


def _camera(view: View) -> mujoco.MjvCamera:
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.lookat[:] = view.lookat
    camera.distance, camera.azimuth, camera.elevation = view.distance, view.azimuth, view.elevation
    return camera


def _dress(model: mujoco.MjModel, width: int, height: int) -> None:
    """Studio light, a floor that meets the backdrop, and room for the image."""
    model.vis.global_.offwidth, model.vis.global_.offheight = width, height
    model.vis.quality.shadowsize, model.vis.quality.offsamples = (
        4096,
        0,
    )  # OVERSAMPLING smooths edges already
    (
        model.vis.headlight.ambient[:],
        model.vis.headlight.diffuse[:],
        model.vis.headlight.specular[:],
    ) = 0.50, 0.28, 0.05
    model.light_type[:] = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    model.light_pos[:], model.light_dir[:] = (0.6, 0.4, 2.0), (-0.30, -0.20, -0.93)
    model.light_diffuse[:], model.light_specular[:] = 0.32, 0.10
    show_hidden(model)
    floors = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    model.geom_rgba[floors] = [*BACKDROP, 1.0]
    model.geom_size[floors] = [6.0, 6.0, 1.0]


def _reveal(model: mujoco.MjModel, data: mujoco.MjData, eye: Array) -> None:
    """Make boxes of the world see-through that hide a goal or a link between the base and a
    palm.
    """
    bodies = _shown(model)
    for geom in obstacles(model):
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
            hides = any(
                _crosses(eye, data.xpos[body], model.geom_pos[geom], model.geom_size[geom])
                for body in bodies
            )
            model.geom_rgba[geom, 3] = SEE_THROUGH if hides else 1.0


def _shown(model: mujoco.MjModel) -> set[int]:
    bodies = {i for i in range(model.nbody) if model.body(i).name.startswith(goal_body(""))}
    for sensor in range(model.nsensor):
        if model.sensor(sensor).name.startswith(palm_sensor("")):
            body = int(model.site_bodyid[model.sensor_objid[sensor]])
            while body:
                bodies.add(body)
                body = int(model.body_parentid[body])
    return bodies


def _crosses(start: Array, end: Array, centre: Array, half: Array) -> bool:
    """The segment meets the axis-aligned box (the slab test)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = (np.stack([centre - half, centre + half]) - start) / (end - start)
    enter, leave = np.nanmin(sides, axis=0).max(), np.nanmax(sides, axis=0).min()
    return bool(max(enter, 0.0) <= min(leave, 1.0))


def offscreen(
    model: mujoco.MjModel, width: int, height: int
) -> tuple[mujoco.GLContext, mujoco.MjrContext]:
    """A graphics context to render in: MUJOCO_GL's choice, or EGL where there is no display.

    Raises:
        SimulationError: if there is none to be had.
    """
    try:
        if "MUJOCO_GL" in os.environ or any(name in os.environ for name in _DISPLAYS):
            from mujoco.gl_context import GLContext
        else:
            from mujoco.egl import GLContext
        context = GLContext(width, height)
        context.make_current()
        canvas = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, canvas)
    except (ImportError, AttributeError, RuntimeError, OSError, mujoco.FatalError) as error:
        raise SimulationError(
            f"pictures: no OpenGL to render with ({error}); install EGL (on Debian: libegl1 and "
            "libgl1-mesa-dri) or set MUJOCO_GL"
        ) from error
    return context, canvas
