"""Cameras after the fact: images of an episode from its log alone.

The episode is simulated again from its first state and its actions. Only where every position and
velocity comes back bit for bit is it rendered: what a camera shows is what the log proves. Without a
display, through EGL or OSMesa.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import mujoco
import numpy as np

from coordlog.episode import INITIAL_STATE, MODEL_MJB, MODEL_XML, Array, Json
from coordlog.errors import ConfigError, FormatError, SimulationError, unknown
from coordlog.exchange import statistics
from coordlog.exchange.blocks import Options
from coordlog.exchange.source import Loaded
from coordlog.mjcf import load_model
from coordlog.sim.physics import STATE
from coordlog.sim.replay import Log, exact_here, replay

CODEC, PIXELS, CRF, GOP = "libsvtav1", "yuv420p", 30, 2
"""LeRobot's own defaults: AV1, an intra frame every second frame for random access."""
SAMPLED = 100
"""Frames of an episode that its image statistics look at, at most."""
_FREE = re.compile(r"pos=(?P<pos>[-\d.,e]+)\s+lookat=(?P<lookat>[-\d.,e]+)")


class Shown(NamedTuple):
    """Where an episode lies in a camera's video, and the statistics of its images."""

    start: float
    """s"""
    stop: float
    """s"""
    stats: statistics.Stats


class Videos:
    """One video per camera, of consecutive episodes; a context manager.

    Example:
        `with Videos({"overhead": path}, options) as videos: videos.add(loaded)`
    """

    def __init__(self, paths: Mapping[str, Path], options: Options) -> None:
        self._paths, self._options = paths, options
        self._files: dict[str, tuple[Any, Any]] = {}
        self._frames = 0
        self._fps = Fraction(1)

    def add(self, loaded: Loaded) -> dict[str, Shown]:
        """Render the T states before the actions of an episode and append them.

        Raises:
            FormatError: if the log does not come back bit for bit.
        """
        if not self._paths:
            return {}
        if not self._files:
            self._open(loaded)
        length = len(loaded.episode)
        sampled = set(np.linspace(0, length - 1, min(length, SAMPLED)).astype(int).tolist())
        kept: dict[str, list[Array]] = {camera: [] for camera in self._paths}
        for step, images in enumerate(frames(loaded, self._options)):
            if step == length:
                break
            for camera, image in images.items():
                self._encode(camera, image, self._frames + step)
                if step in sampled:
                    kept[camera].append(image)
        start = float(self._frames / self._fps)
        self._frames += length
        stop = float(self._frames / self._fps)
        return {
            camera: Shown(start, stop, statistics.of_images(images))
            for camera, images in kept.items()
        }

    def _open(self, loaded: Loaded) -> None:
        import av

        period = float(loaded.episode.header.episode["control_period"])
        self._fps = Fraction(1 / period).limit_denominator(100_000)
        for camera, path in self._paths.items():
            file = av.open(str(path), "w")
            options = {"crf": str(CRF), "g": str(GOP)}
            stream = file.add_stream(CODEC, rate=self._fps, options=options)
            stream.width, stream.height = self._options.width, self._options.height
            stream.pix_fmt = PIXELS
            stream.time_base = 1 / self._fps
            self._files[camera] = (file, stream)

    def _encode(self, camera: str, image: Array, number: int) -> None:
        import av

        file, stream = self._files[camera]
        frame = av.VideoFrame.from_ndarray(image, format="rgb24")
        frame.pts, frame.time_base = number, 1 / self._fps
        for packet in stream.encode(frame):
            file.mux(packet)

    def __enter__(self) -> Videos:
        """Silence the encoder, which writes its banner to standard error."""
        if self._paths:
            import os

            import av

            os.environ.setdefault("SVT_LOG", "1")
            av.logging.set_level(av.logging.ERROR)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Finish the files; after an error just let go of them."""
        for file, stream in self._files.values():
            if error is None:
                for packet in stream.encode(None):
                    file.mux(packet)
            file.close()


def frames(loaded: Loaded, options: Options) -> Iterator[dict[str, Array]]:
    """The T + 1 states of an episode as images by camera, RGB (height, width, 3) uint8.

    Raises:
        FormatError: if the log does not come back bit for bit.
        ConfigError: if the model has no such camera.
        SimulationError: if there is no way to render here.
    """
    model = load_model(loaded.attachments.get(MODEL_XML), loaded.attachments.get(MODEL_MJB))
    start = np.frombuffer(loaded.attachments.get(INITIAL_STATE, b""), np.float64)
    require_exact(loaded, model, start)
    views = {camera: view_of(camera, model) for camera in options.cameras}
    for side, name in ((options.width, "offwidth"), (options.height, "offheight")):
        setattr(model.vis.global_, name, max(side, getattr(model.vis.global_, name)))
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, start, STATE)
    try:
        renderer = mujoco.Renderer(model, options.height, options.width)
    except (RuntimeError, AttributeError, mujoco.FatalError) as error:
        raise SimulationError(
            f"cannot render here: {error}; without a display set MUJOCO_GL=egl or MUJOCO_GL=osmesa"
        ) from error
    with renderer:
        for qpos in loaded.episode.qpos:
            data.qpos[:] = qpos
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_camlight(model, data)
            images = {}
            for camera, view in views.items():
                renderer.update_scene(data, camera=view)
                images[camera] = renderer.render().copy()
            yield images


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
            f"{loaded.path}: {reason}: images are rendered only of states that are proven; use that MuJoCo, or leave --camera away"
        )
    trace = replay([Log(episode.header, model, start, episode.action)])[0]
    for name in ("qpos", "qvel"):
        logged, again = getattr(episode, name), trace.columns[name]
        different = np.flatnonzero((logged.view(np.uint64) != again.view(np.uint64)).any(axis=1))
        if len(different):
            raise FormatError(
                f"{loaded.path}: step {different[0]}: {name} simulated again differs from the log; `coordlog check` says more"
            )


def view_of(camera: str, model: mujoco.MjModel) -> int | mujoco.MjvCamera:
    """A camera of the model by name, or a free one, "pos=x,y,z lookat=x,y,z" [m].

    Raises:
        ConfigError: if the model has no camera of this name, or a free one cannot be understood.
    """
    found = _FREE.fullmatch(camera.strip())
    if found is None:
        number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, camera)
        if number >= 0:
            return int(number)
        known = [model.camera(i).name for i in range(model.ncam)]
        if known:
            raise unknown("camera", camera, known)
        raise ConfigError(
            f'unknown camera \'{camera}\': the model has none; place one with --camera "pos=1.5,-1,1.2 lookat=0,0,0.8"'
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


def feature(width: int, height: int, fps: float) -> Json:
    """The declaration of a video in LeRobot's info.json."""
    info = {
        "video.height": height,
        "video.width": width,
        "video.codec": "av1",
        "video.pix_fmt": PIXELS,
        "video.is_depth_map": False,
        "video.fps": fps,
        "video.channels": 3,
        "has_audio": False,
    }
    names = ["height", "width", "channels"]
    return {"dtype": "video", "shape": [height, width, 3], "names": names, "info": info}
