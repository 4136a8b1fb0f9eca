"""The viewer as a process of ours: bound to 127.0.0.1, telemetry off, in a window or without one.

The viewer's own helpers listen on all interfaces, so its binary is started here and connected to. It reads an `.rrd` bit by bit: the
file must stay where it is for as long as the viewer shows it.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType

import rerun_cli
from rerun.experimental import ViewerClient

from coordlog.errors import ConfigError, ViewerError

HOST = "127.0.0.1"
BINARY = Path(rerun_cli.__file__).parent / ("rerun.exe" if sys.platform == "win32" else "rerun")
"""The command `rerun` is a script around this; stopping the script would leave the viewer running."""
SILENT = (RuntimeError, ConnectionError)
"""What a client raises when there is no viewer to answer it."""
START_SECONDS = 30.0
FRAMES = 5
"""Pictures asked for before one is taken: the viewer's own notices at its start fade over the first three it paints."""
PATIENCE = 60.0
"""A picture is taken after this long [s] even if something in it still moves."""
NO_VULKAN = (
    "the viewer found no Vulkan device: install a software one (Debian, Ubuntu: apt-get install mesa-vulkan-drivers), "
    "or use --save FILE and open it on another machine"
)
TOO_SLOW = "the viewer runs but did not answer in time, as on a busy machine; try again, or use --save FILE and open it elsewhere"
NO_DISPLAY = "no display: expected one named by DISPLAY or WAYLAND_DISPLAY; use --web, --screenshot FILE or --save FILE"


class Viewer:
    """A viewer process and its private settings; leaving the context ends it."""

    def __init__(self, *arguments: str, port: int = 0) -> None:
        """Prepare to start it.

        Args:
            arguments: Of the command line, after those that bind it to this machine.
            port: Where it listens on 127.0.0.1; 0 picks a free port.

        Raises:
            ViewerError: if the port is taken.
        """
        self.port = claim(port)
        self._arguments = ["--bind", HOST, "--port", str(self.port), "--hide-welcome-screen", *arguments]

    @property
    def url(self) -> str:
        """Where recordings are sent to and clients connect."""
        return f"rerun+http://{HOST}:{self.port}/proxy"

    def __enter__(self) -> Viewer:
        """Start it.

        Raises:
            ViewerError: if its program is not there or cannot be run.
        """
        self._folder = tempfile.TemporaryDirectory(prefix="coordlog-viewer-")
        self._log = Path(self._folder.name) / "log"
        try:
            settings = environment(Path(self._folder.name))
            with self._log.open("wb") as log:
                command = [str(BINARY), *self._arguments]
                self.process = subprocess.Popen(command, env=settings, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        except OSError as error:
            self._folder.cleanup()
            raise ViewerError(f"the viewer cannot be run: {error.strerror}: {BINARY}; install rerun-sdk again") from error
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """End it, and remove its settings.

        Raises:
            ViewerError: instead of the error of a client whose viewer had ended by itself.
        """
        try:
            if isinstance(error, (*SILENT, TimeoutError)) and self._ends_within(2.0):
                raise self.failure() from error
            if isinstance(error, TimeoutError):
                raise ViewerError(TOO_SLOW) from error
        finally:
            self.process.terminate()
            if not self._ends_within(5.0):
                self.process.kill()
                self.process.wait()
            self._folder.cleanup()

    def _ends_within(self, seconds: float) -> bool:
        try:
            self.process.wait(timeout=seconds)
        except subprocess.TimeoutExpired:
            return False
        return True

    def failure(self) -> ViewerError:
        """Why a viewer that has ended did so."""
        log = self._log.read_text(errors="replace")
        if "render context" in log or "adapter" in log:
            return ViewerError(NO_VULKAN)
        if "EventLoopError" in log:
            return ViewerError(NO_DISPLAY)
        said = [line for line in log.splitlines() if line.strip()]
        what = said[-1].strip() if said else "it said nothing"
        return ViewerError(f"the viewer ended with exit code {self.process.returncode} ({what}); use --save FILE and open it elsewhere")


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
            with suppress(*SILENT):  # it does not listen yet
                client = ViewerClient.connect(self.url)
                client.get_state()
                return client
            time.sleep(0.1)
        if self.process.poll() is not None:
            raise self.failure()
        raise ViewerError(f"the viewer did not answer on {HOST}:{self.port} within {START_SECONDS:g} s; try again, or use --save FILE")

    def open(self, *files: Path) -> None:
        """Load a recording, after a blueprint for it if there is one, and stop its clock."""
        self._client.open([str(file.resolve()) for file in files])
        deadline = time.monotonic() + START_SECONDS
        while self._client.get_state().loading and time.monotonic() < deadline:
            time.sleep(0.05)
        self._client.set_time(play_state="paused")

    def seek(self, at: float | None) -> None:
        """Put the cursor of the present timeline to a time [s] or an episode's number; None: to its end.

        Raises:
            ConfigError: if the recording has no such time.
        """
        state = self._client.get_state()
        recording = next(each for each in state.recordings if each.store_id == state.active_recording)
        timeline = next(each for each in recording.timelines if each.name == recording.current_timeline)
        unit = 1e9 if timeline.time_type == "duration" else 1.0
        first, last = (timeline.start or 0) / unit, (timeline.end or 0) / unit
        at = last if at is None else at
        if not first <= at <= last:
            raise ConfigError(f"--at: expected {first:g} to {last:g} on the timeline '{timeline.name}', got {at:g}")
        if timeline.time_type == "duration":
            self._client.set_time(timeline.name, duration=at, play_state="paused")
        else:
            self._client.set_time(timeline.name, sequence=int(at), play_state="paused")

    def picture(self, kind: str = "") -> bytes:
        """PNG of the window, or of the first view of a kind such as "3D", once nothing in it moves any more."""
        views = self._client.get_state().views
        place = next(view.view_id for view in views if view.view_class == kind) if kind else None
        deadline, pictures = time.monotonic() + PATIENCE, [b""]
        while (len(pictures) <= FRAMES or pictures[-1] != pictures[-2]) and time.monotonic() < deadline:
            with suppress(TimeoutError):  # a slow machine has not painted it yet
                pictures.append(bytes(self._client.take_screenshot(place)))
            time.sleep(0.1)
        if not pictures[-1]:
            raise TimeoutError
        return pictures[-1]

    def views(self) -> list[str]:
        """Names of all views."""
        return [view.name for view in self._client.get_state().views]

    def complaints(self) -> list[str]:
        """What views report that they could not show, and errors in the viewer's log."""
        reports = [f"{view.name}: {report}" for view in self._client.get_state().views for report in view.reports]
        return reports + [entry.message for entry in self._client.get_logs() if entry.level == "ERROR"]


def screenshot(rrd: Path, png: Path, *, at: float | None = None, size: tuple[int, int] = (1600, 1000)) -> list[str]:
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


def open_window(rrds: Sequence[Path], *, port: int = 0) -> None:
    """Show recordings in the viewer's window, and return when it is closed.

    Raises:
        ViewerError: without a display, or if the viewer does not start.
    """
    require_display()
    with Viewer(*(str(rrd.resolve()) for rrd in rrds), port=port) as viewer:
        if viewer.process.wait() != 0:
            raise viewer.failure()


def require_display() -> None:
    """Refuse to open a window where there is none to open.

    Raises:
        ViewerError: without a display.
    """
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise ViewerError(NO_DISPLAY)


def claim(port: int) -> int:
    """A port that is free on 127.0.0.1 now: the one asked for, or any if that is 0.

    Raises:
        ViewerError: if it is taken.
    """
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError as error:
            raise ViewerError(
                f"port {port} on {HOST} cannot be used: {error.strerror}; leave --port out and a free one is taken"
            ) from error
        return int(probe.getsockname()[1])


def environment(folder: Path) -> dict[str, str]:
    """Environment in which the viewer keeps its settings in a folder of ours, with telemetry off."""
    settings = {**os.environ, "XDG_CONFIG_HOME": str(folder), "XDG_DATA_HOME": str(folder), "RUST_LOG": "error"}
    settings.setdefault("XDG_RUNTIME_DIR", str(folder))
    subprocess.run([str(BINARY), "analytics", "disable"], env=settings, capture_output=True, check=False)
    return settings
