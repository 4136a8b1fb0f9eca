"""The viewer as a process of ours: bound to 127.0.0.1, telemetry off, in a window or without one.

The viewer's own helpers listen on all interfaces, so its binary is started here and connected to.
It reads an `.rrd` bit by bit: the file must stay where it is for as long as the viewer shows it.
"""

from __future__ import annotations

import ctypes
import os
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import rerun_cli

from coordlog.errors import ViewerError

HOST = "127.0.0.1"
BINARY = Path(rerun_cli.__file__).parent / ("rerun.exe" if sys.platform == "win32" else "rerun")
"""The command `rerun` is a script around this.

Stopping the script would leave the viewer running.
"""
SILENT = (RuntimeError, ConnectionError)
"""What a client raises when there is no viewer to answer it."""
START_SECONDS = 30.0
PR_SET_PDEATHSIG = 1
NO_VULKAN = (
    "the viewer found no Vulkan device: install a software one (Debian, Ubuntu: apt-get install "
    "mesa-vulkan-drivers), "
    "or use --save FILE and open it on another machine"
)
TOO_SLOW = (
    "the viewer runs but did not answer in time, as on a busy machine; try again, or use --save "
    "FILE and open it elsewhere"
)
NO_DISPLAY = (
    "no display: expected one named by DISPLAY or WAYLAND_DISPLAY; use --web, --screenshot FILE or "
    "--save FILE"
)


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
        self._arguments = [
            "--bind",
            HOST,
            "--port",
            str(self.port),
            "--hide-welcome-screen",
            *arguments,
        ]

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
                self.process = subprocess.Popen(
                    command,
                    env=settings,
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=log,
                    preexec_fn=_bound(),
                )
        except OSError as error:
            self._folder.cleanup()
            raise ViewerError(
                f"the viewer cannot be run: {error.strerror}: {BINARY}; install rerun-sdk again"
            ) from error
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
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
        return ViewerError(
            f"the viewer ended with exit code {self.process.returncode} ({what}); use --save FILE "
            "and open it elsewhere"
        )


def _bound() -> Callable[[], object] | None:
    """What makes a new process end with this one, however that ends; None where Linux is not.

    Source: prctl(2), PR_SET_PDEATHSIG; no `finally` runs in a process that is killed.
    """
    if sys.platform != "linux":
        return None
    return partial(ctypes.CDLL(None).prctl, PR_SET_PDEATHSIG, int(signal.SIGKILL))


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
    if sys.platform == "linux" and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
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
                f"port {port} on {HOST} cannot be used: {error.strerror}; leave --port out and a "
                "free one is taken"
            ) from error
        return int(probe.getsockname()[1])


def environment(folder: Path) -> dict[str, str]:
    """Environment in which the viewer keeps its settings in a folder of ours, with telemetry
    off.
    """
    settings = {
        **os.environ,
        "XDG_CONFIG_HOME": str(folder),
        "XDG_DATA_HOME": str(folder),
        "RUST_LOG": "error",
    }
    settings.setdefault("XDG_RUNTIME_DIR", str(folder))
    subprocess.run(
        [str(BINARY), "analytics", "disable"], env=settings, capture_output=True, check=False
    )
    return settings
