"""A real S3 server on the loopback address, which counts what it is asked and can be unwell."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any
from urllib.request import Request, urlopen

from moto.server import ThreadedMotoServer

ENVIRONMENT = {
    "AWS_ACCESS_KEY_ID": "testing",
    "AWS_SECRET_ACCESS_KEY": "testing",
    "AWS_REGION": "us-east-1",
}


class Server:
    """A server with an empty bucket, `robots`; what it holds survives `stop` and `start`."""

    def __init__(self) -> None:
        self.requests: list[str] = []
        """method and path of every request"""
        self.answers: list[int] = []
        """statuses to answer the next requests with, instead of serving them"""
        self.delay = 0.0
        """s before each answer"""
        self._port = 0
        self.start()
        urlopen(Request(f"{self.url}/robots", method="PUT")).close()
        self.requests.clear()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self._port}"

    def start(self) -> None:
        self._moto = ThreadedMotoServer(ip_address="127.0.0.1", port=self._port, verbose=False)
        self._moto.start()
        self._port = self._moto.get_host_and_port()[1]
        server: Any = self._moto._server
        server.app = self._counting(server.app)
        server.RequestHandlerClass.log_request = lambda *_: None

    def stop(self) -> None:
        server: Any = self._moto._server
        self._moto.stop()
        server.server_close()

    def _counting(self, app: Callable[..., Iterable[bytes]]) -> Callable[..., Iterable[bytes]]:
        def answer(environ: dict[str, Any], start: Callable[..., Any]) -> Iterable[bytes]:
            self.requests.append(f"{environ['REQUEST_METHOD']} {environ['PATH_INFO']}")
            time.sleep(self.delay)
            if self.answers:
                status = self.answers.pop(0)
                start(f"{status} Unwell", [("Content-Length", "0")])
                return [b""]
            return app(environ, start)

        return answer
