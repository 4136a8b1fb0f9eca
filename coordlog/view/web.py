"""The viewer in a browser on this machine: nothing listens beyond 127.0.0.1, and the page can reach
nothing else.

The viewer's page asks for fonts and reports its use to hosts of its own, whatever the settings of
the viewer that serves it. So it is passed on through a server of ours that adds a content security
policy: the browser itself refuses every other address.
"""

from __future__ import annotations

import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.client import HTTPException
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import ClassVar
from urllib.parse import quote, urlsplit

from coordlog.errors import ViewerError
from coordlog.view.viewer import HOST, START_SECONDS, Viewer, claim

POLICY = (
    "default-src 'self' data: blob:; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval' blob:; "
    "style-src 'self' 'unsafe-inline'; "
    "connect-src 'self' data: blob: {source}"
)
"""What the page may load: its own parts, and recordings from {source}."""
PASSED_ON = ("Content-Type", "rerun-final-length")


class Server(ThreadingHTTPServer):
    """A server that says nothing when a browser goes away in the middle of an answer."""

    daemon_threads = True

    def handle_error(self, request: object, client_address: object) -> None:
        """Print what is a fault of ours, and nothing else."""
        if not isinstance(sys.exc_info()[1], ConnectionError | TimeoutError):
            super().handle_error(request, client_address)  # type: ignore[arg-type]


class Page(BaseHTTPRequestHandler):
    """Answers a browser with what the viewer's own server says, under our policy."""

    origin: ClassVar[str]
    policy: ClassVar[str]

    def do_GET(self) -> None:
        """Pass one file of the viewer on."""
        try:
            with urllib.request.urlopen(
                self.origin + urlsplit(self.path).path, timeout=START_SECONDS
            ) as answer:
                content, headers = (
                    answer.read(),
                    [(name, answer.headers[name]) for name in PASSED_ON if name in answer.headers],
                )
        except (OSError, HTTPException):  # URLError is an OSError
            self.send_error(404)
            return
        self.send_response(200)
        for name, value in [
            *headers,
            ("Content-Length", str(len(content))),
            ("Content-Security-Policy", self.policy),
        ]:
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: object) -> None:
        """Say nothing: the terminal belongs to the command."""


@contextmanager
def web_viewer(rrd: Path, *, port: int = 0) -> Iterator[str]:
    """Serve a recording and the viewer's page on 127.0.0.1 for as long as the context lasts, and
    yield the page's address.

    Args:
        rrd: The recording.
        port: Of the page; 0 picks a free one.

    Raises:
        ViewerError: if the port is taken or the viewer does not start.
    """
    port, inner = claim(port), claim(0)
    with Viewer(str(rrd.resolve()), "--serve-web", "--web-viewer-port", str(inner)) as viewer:
        origin = f"http://{HOST}:{inner}"
        _wait(viewer, origin)
        page = type(
            "BoundPage",
            (Page,),
            {"origin": origin, "policy": POLICY.format(source=f"http://{HOST}:{viewer.port}")},
        )
        with Server((HOST, port), page) as server:
            Thread(target=server.serve_forever, daemon=True).start()
            shown = quote(viewer.url, safe=":/")
            options = "theme=dark&hide_welcome_screen&persist=0"
            yield f"http://{HOST}:{port}/?url={shown}&{options}"
            server.shutdown()


def serve(rrd: Path, *, port: int = 0, ready: Callable[[str], None]) -> None:
    """Serve a recording until interrupted; `ready` is told the page's address.

    Raises:
        ViewerError: if the port is taken or the viewer does not start.
    """
    with web_viewer(rrd, port=port) as address:
        ready(address)
        try:
            while True:
                time.sleep(3600.0)
        except KeyboardInterrupt:
            return


def _wait(viewer: Viewer, origin: str) -> None:
    deadline = time.monotonic() + START_SECONDS
    while time.monotonic() < deadline:
        if viewer.process.poll() is not None:
            raise viewer.failure()
        try:
            with urllib.request.urlopen(origin, timeout=START_SECONDS):
                return
        except urllib.error.URLError:
            time.sleep(0.1)
    raise ViewerError(
        f"the viewer's page did not come up on {origin} within {START_SECONDS:g} s; use --save "
        "FILE and open it elsewhere"
    )
