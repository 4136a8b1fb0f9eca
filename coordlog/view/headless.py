"""A viewer without a window, to take pictures with where there is no display."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

from rerun.experimental import ViewerClient

from coordlog.errors import ConfigError, ViewerError
from coordlog.view.viewer import HOST, SILENT, START_SECONDS, Viewer

Answer = TypeVar("Answer")
FRAMES = 5
"""Pictures asked for before one is taken: the viewer's own notices at its start fade over the first
three it paints."""
PATIENCE = 60.0
"""A picture is taken after this long [s] even if something in it still moves."""
BUSY = 180.0
"""A viewer that has not answered for this long [s] is given up.

Software painting takes its time on a machine with other work.
"""


class Headless(Viewer):
    """A viewer without a window, to take pictures with."""

    def __init__(self, *, size: tuple[int, int] = (1600, 1000)) -> None:
        """Prepare one of so many pixels, width and height."""
        super().__init__("--headless", "--window-size", f"{size[0]}x{size[1]}")

    def __enter__(self) -> Headless:
        """Start it, and wait until it answers.

        Raises:
            ViewerError: if it does not.
        """
        super().__enter__()
        try:
            self._client = self._connect()
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def _connect(self) -> ViewerClient:
        deadline = time.monotonic() + START_SECONDS
        while self.process.poll() is None and time.monotonic() < deadline:
            with suppress(*SILENT, TimeoutError):  # it does not listen yet
                client = ViewerClient.connect(self.url)
                client.get_state()
                return client
            time.sleep(0.1)
        if self.process.poll() is not None:
            raise self.failure()
        raise ViewerError(
            f"the viewer did not answer on {HOST}:{self.port} within {START_SECONDS:g} s; try "
            "again, or use --save FILE"
        )

    def open(self, *files: Path) -> None:
        """Load a recording, after a blueprint for it if there is one, and stop its clock."""
        patiently(lambda: self._client.open([str(file.resolve()) for file in files]))
        deadline = time.monotonic() + START_SECONDS
        while patiently(self._client.get_state).loading and time.monotonic() < deadline:
            time.sleep(0.05)
        patiently(lambda: self._client.set_time(play_state="paused"))

    def seek(self, at: float | None) -> None:
        """Put the cursor of the present timeline to a time [s] or an episode's number; None: to its
        end.

        Raises:
            ConfigError: if the recording has no such time.
        """
        state = patiently(self._client.get_state)
        recording = next(
            each for each in state.recordings if each.store_id == state.active_recording
        )
        timeline = next(
            each for each in recording.timelines if each.name == recording.current_timeline
        )
        unit = 1e9 if timeline.time_type == "duration" else 1.0
        first, last = (timeline.start or 0) / unit, (timeline.end or 0) / unit
        at = last if at is None else at
        if not first <= at <= last:
            raise ConfigError(
                f"--at: expected {first:g} to {last:g} on the timeline '{timeline.name}', got "
                f"{at:g}"
            )
        if timeline.time_type == "duration":
            patiently(
                lambda: self._client.set_time(timeline.name, duration=at, play_state="paused")
            )
        else:
            patiently(
                lambda: self._client.set_time(timeline.name, sequence=int(at), play_state="paused")
            )

    def picture(self, kind: str = "") -> bytes:
        """PNG of the window, or of the first view of a kind such as "3D", once nothing in it moves
        any more.
        """
        views = patiently(self._client.get_state).views
        place = next(view.view_id for view in views if view.view_class == kind) if kind else None
        deadline, pictures = time.monotonic() + PATIENCE, [b""]
        while (
            len(pictures) <= FRAMES or pictures[-1] != pictures[-2]
        ) and time.monotonic() < deadline:
            pictures.append(bytes(patiently(lambda: self._client.take_screenshot(place))))
            time.sleep(0.1)
        return pictures[-1]

    def views(self) -> list[str]:
        """Names of all views."""
        return [view.name for view in patiently(self._client.get_state).views]

    def complaints(self) -> list[str]:
        """What views report that they could not show, and errors in the viewer's log."""
        reports = [
            f"{view.name}: {report}"
            for view in patiently(self._client.get_state).views
            for report in view.reports
        ]
        return reports + [
            entry.message for entry in patiently(self._client.get_logs) if entry.level == "ERROR"
        ]


def screenshot(
    rrd: Path, png: Path, *, at: float | None = None, size: tuple[int, int] = (1600, 1000)
) -> list[str]:
    """Take a picture of a recording without a display.

    Args:
        rrd: The recording.
        png: Where the picture goes.
        at: Time [s], or the number of an episode in an overview; None for the end.
        size: Width and height in pixels.

    Returns:
        What the viewer could not show, one sentence each; empty if all went well.

    Raises:
        ViewerError: if the viewer does not start, most often for want of Vulkan.
        ConfigError: if the recording has no such time.
    """
    with Headless(size=size) as viewer:
        viewer.open(rrd)
        viewer.seek(at)
        png.write_bytes(viewer.picture())
        return viewer.complaints()


def patiently(ask: Callable[[], Answer]) -> Answer:
    """Ask a viewer again that is too busy painting to answer in time.

    Raises:
        TimeoutError: if it stays so.
    """
    deadline = time.monotonic() + BUSY
    while True:
        try:
            return ask()
        except TimeoutError:
            if time.monotonic() > deadline:
                raise
