"""Cameras after the fact: images of an episode from its log alone.

The episode is simulated again from its first state and its actions. Only where every position and
velocity comes back bit for bit is it rendered: what a camera shows is what the log proves. Without
a display, through EGL or OSMesa.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from copy import copy

import mujoco
import numpy as np

from coordlog.episode import INITIAL_STATE, Array
from coordlog.errors import ConfigError, FormatError, unknown
from coordlog.exchange.blocks import Options
from coordlog.exchange.source import Loaded
from coordlog.mjcf import load_attached, load_dressed
from coordlog.record.beside import Beside
from coordlog.sim.physics import STATE
from coordlog.sim.render import offscreen
from coordlog.sim.replay import Log, exact_here, replay

_FREE = re.compile(r"pos=(?P<pos>[-\d.,e]+)\s+lookat=(?P<lookat>[-\d.,e]+)")
KINDS = ("rgb", "depth", "segmentation")
"""What a camera may show: `NAME` or `NAME:rgb`, `NAME:depth`, `NAME:segmentation`."""


def frames(loaded: Loaded, options: Options) -> Iterator[dict[str, Array]]:
    """The T + 1 states of an episode as images by camera, as `Canvas.shown` gives them.

    Raises:
        FormatError: if the log does not come back bit for bit.
        ConfigError: if the model has no such camera.
        SimulationError: if there is no way to render here.
    """
    model = load_attached(loaded.attachments)
    start = np.frombuffer(loaded.attachments.get(INITIAL_STATE, b""), np.float64)
    require_exact(loaded, model, start)
    views = {}
    for camera in options.cameras:
        name, kind = split(camera)
        views[camera] = (view_of(name, model), kind)
    if not any(kind == "segmentation" for _, kind in views.values()):  # geoms by their ids
        model = load_dressed(loaded.attachments, Beside(loaded.path))
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, start, STATE)
    with Canvas(model, options.width, options.height) as canvas:
        for qpos in loaded.episode.qpos:
            data.qpos[:] = qpos
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_camlight(model, data)
            yield {camera: canvas.shown(data, *view) for camera, view in views.items()}


class Canvas:
    """An offscreen image of a model, the same buffers for every state; a context manager.

    Example:
        `with Canvas(model, 224, 224) as canvas: image = canvas.shown(data, view)`
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        """Make the graphics context: MUJOCO_GL's choice, or EGL where there is no display.

        Raises:
            SimulationError: if there is none to be had.
        """
        self._model = copy(model)
        self._model.vis.global_.offwidth = width
        self._model.vis.global_.offheight = height
        self._area = mujoco.MjrRect(0, 0, width, height)
        self._scene = mujoco.MjvScene(self._model, maxgeom=10_000)
        self._options = mujoco.MjvOption()
        self._image = np.empty((height, width, 3), np.uint8)
        self._depth = np.empty((height, width), np.float32)
        self._graphics, self._context = offscreen(self._model, width, height)
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR

    def shown(self, data: mujoco.MjData, view: mujoco.MjvCamera, kind: str = "rgb") -> Array:
        """One state through one camera, top row first.

        Returns:
            Of kind "rgb" (height, width, 3) uint8; "depth" (height, width, 1) float32, the distance
            along the axis of view [m]; "segmentation" (height, width, 1) int32, the geom that is
            seen by its id, -1 where there is none.
        """
        mujoco.mjv_updateScene(
            self._model,
            data,
            self._options,
            None,
            view,
            mujoco.mjtCatBit.mjCAT_ALL,
            self._scene,
        )
        by_id = kind != "rgb"  # without it edges are blended, and depths with them
        for flag in (mujoco.mjtRndFlag.mjRND_SEGMENT, mujoco.mjtRndFlag.mjRND_IDCOLOR):
            self._scene.flags[flag] = by_id
        mujoco.mjr_render(self._area, self._scene, self._context)
        if kind == "depth":
            mujoco.mjr_readPixels(None, self._depth, self._area, self._context)
            return self._metres()[::-1, :, None].copy()
        mujoco.mjr_readPixels(self._image, None, self._area, self._context)
        if kind == "segmentation":
            return self._geoms()[::-1, :, None].copy()
        return self._image[::-1].copy()

    def _metres(self) -> Array:
        """The depth buffer, 1 at the near plane and 0 at the far one, as distances [m]."""
        extent, planes = self._model.stat.extent, self._model.vis.map
        near, far = planes.znear * extent, planes.zfar * extent
        if self._scene.camera[0].orthographic:
            return np.asarray(far - self._depth * np.float32(far - near))
        return np.asarray(
            near * far / (near + self._depth.astype(float) * (far - near)), np.float32
        )

    def _geoms(self) -> Array:
        """Colours that count the things of the scene from 1, as ids of geoms."""
        ids = np.full(self._scene.ngeom + 1, -1, np.int32)
        for item in self._scene.geoms[: self._scene.ngeom]:
            if item.objtype == mujoco.mjtObj.mjOBJ_GEOM and item.segid >= 0:
                ids[item.segid + 1] = item.objid
        place = self._image.astype(np.int32) @ np.array([1, 1 << 8, 1 << 16], np.int32)
        return ids[place]

    def __enter__(self) -> Canvas:
        """For `with`."""
        return self

    def __exit__(self, *_: object) -> None:
        """Let go of the graphics context."""
        self._context.free()
        self._graphics.free()


def require_exact(loaded: Loaded, model: mujoco.MjModel, start: Array) -> None:
    """Simulate an episode again and hold it to the log, bit for bit.

    Raises:
        FormatError: naming the first step that differs, or what about this machine cannot give the
            same bits.
    """
    episode = loaded.episode
    reason = exact_here(episode.header)
    if reason:
        raise FormatError(
            f"{loaded.path}: {reason}: images are rendered only of states that are proven; use "
            "that MuJoCo, or leave --camera away"
        )
    trace = replay([Log.of(episode, model, start)])[0]
    for name in ("qpos", "qvel"):
        logged, again = getattr(episode, name), trace.columns[name]
        different = np.flatnonzero((logged.view(np.uint64) != again.view(np.uint64)).any(axis=1))
        if len(different):
            raise FormatError(
                f"{loaded.path}: step {different[0]}: {name} simulated again differs from the log; "
                "`coordlog check` says more"
            )


def split(camera: str) -> tuple[str, str]:
    """A camera's name, and which of `KINDS` it is to show."""
    name, colon, kind = camera.rpartition(":")
    return (name, kind) if colon and kind in KINDS else (camera, "rgb")


def view_of(camera: str, model: mujoco.MjModel) -> mujoco.MjvCamera:
    """A camera of the model by name, or a free one, "pos=x,y,z lookat=x,y,z" [m].

    Raises:
        ConfigError: if the model has no camera of this name, or a free one cannot be understood.
    """
    found = _FREE.fullmatch(camera.strip())
    if found is None:
        number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, camera)
        if number >= 0:
            view = mujoco.MjvCamera()
            view.type = mujoco.mjtCamera.mjCAMERA_FIXED
            view.fixedcamid = number
            return view
        known = [model.camera(i).name for i in range(model.ncam)]
        if known:
            raise unknown("camera", camera, known)
        raise ConfigError(
            f"unknown camera '{camera}': the model has none; place one with --camera "
            '"pos=1.5,-1,1.2 lookat=0,0,0.8"'
        )
    try:
        place, target = (np.array(found[key].split(","), float) for key in ("pos", "lookat"))
        away = target - place
    except ValueError:
        raise ConfigError(
            f"--camera '{camera}': expected three numbers each for pos and lookat [m]"
        ) from None
    distance = float(np.linalg.norm(away))
    if len(away) != 3 or not distance:
        raise ConfigError(f"--camera '{camera}': expected two different points of three numbers")
    view = mujoco.MjvCamera()
    view.type = mujoco.mjtCamera.mjCAMERA_FREE
    view.lookat[:], view.distance = target, distance
    view.azimuth = np.degrees(np.arctan2(away[1], away[0]))
    view.elevation = np.degrees(np.arcsin(away[2] / distance))
    return view


def label(camera: str) -> str:
    """A camera's name as part of a feature's: free cameras by their place."""
    return re.sub(r"[^A-Za-z0-9]+", "_", camera.replace("-", "m")).strip("_")
