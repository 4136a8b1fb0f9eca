"""Videos of rendered episodes, as LeRobot keeps them: AV1 through PyAV, one file for consecutive
episodes.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from coordlog.episode import Array, Json
from coordlog.exchange import statistics
from coordlog.exchange.blocks import Options
from coordlog.exchange.cameras import frames
from coordlog.exchange.source import Loaded

CODEC, PIXELS, CRF, GOP = "libsvtav1", "yuv420p", 30, 2
"""LeRobot's own defaults: AV1, an intra frame every second frame for random access."""
SAMPLED = 100
"""Frames of an episode that its image statistics look at, at most."""


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
            stream: Any = file.add_stream(CODEC, rate=self._fps, options=options)
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
            import av

            os.environ.setdefault("SVT_LOG", "1")
            av.logging.set_level(av.logging.ERROR)
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Finish the files; after an error just let go of them."""
        for file, stream in self._files.values():
            if error is None:
                for packet in stream.encode(None):
                    file.mux(packet)
            file.close()


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
