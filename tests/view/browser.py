"""A real browser without a window, spoken to in its own developer protocol over a pipe."""

import base64
import io
import json
import os
import select
import shutil
import signal
import subprocess
import time

import numpy as np
from PIL import Image

BINARY = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
FLAGS = (
    *("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--no-first-run"),
    *("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    *("--window-size=480,520", "--remote-debugging-pipe"),
)
"""Software GL, a small window, and nothing asked of any host but the page's own."""
ANSWER = 120.0
"""Seconds until a browser that does not answer is given up."""


class Browser:
    """One page in one browser process; leaving the context kills it, as a crash would."""

    def __init__(self, folder):
        self._folder, self._number, self._session, self._pending = folder, 0, "", b""
        self.events = []

    def __enter__(self):
        hears, self._says = os.pipe()
        self._hears, says = os.pipe()
        # it reads what it is told at descriptor 3, and answers at 4
        script = f'exec "$0" "$@" 3<&{hears} 4>&{says}'
        self.process = subprocess.Popen(
            ["bash", "-c", script, str(BINARY), *FLAGS, f"--user-data-dir={self._folder}"],
            pass_fds=(hears, says),
            env={**os.environ, "HOME": str(self._folder)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        os.close(hears)
        os.close(says)
        target = self.ask("Target.createTarget", url="about:blank")["targetId"]
        attached = self.ask("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self.ask(f"{domain}.enable")
        # the viewer says ten thousand things that only its makers want to know
        self.ask("Page.addScriptToEvaluateOnNewDocument", source="console.debug = () => {}")
        return self

    def __exit__(self, *_):
        os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        os.close(self._says)
        os.close(self._hears)

    def go(self, address):
        """Open a page, and wait until it is loaded."""
        self.ask("Page.navigate", url=address)
        for said in self._messages():
            self.events.append(said)
            if said.get("method") == "Page.loadEventFired":
                return

    def picture(self):
        """What is seen, shape (height, width, 3)."""
        png = base64.b64decode(self.ask("Page.captureScreenshot")["data"])
        return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))

    def complaints(self):
        """Errors in the console, and those that a script did not catch."""
        found = []
        for each in self.events:
            said = each.get("params", {})
            entry = said.get("entry", {})
            if entry.get("level") == "error" or said.get("type") in ("error", "assert"):
                found.append(entry.get("text") or json.dumps(said))
            elif each.get("method") == "Runtime.exceptionThrown":
                found.append(json.dumps(said))
        return found

    def ask(self, method, **parameters):
        """Have something done, and return the answer."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._says, json.dumps(message).encode() + b"\0")
        for said in self._messages():
            if said.get("id") == self._number:
                assert "error" not in said, (method, said)
                return said["result"]
            self.events.append(said)
        raise AssertionError("not reached")

    def _messages(self):
        deadline = time.monotonic() + ANSWER
        while True:
            while b"\0" in self._pending:
                one, self._pending = self._pending.split(b"\0", 1)
                yield json.loads(one)
            assert time.monotonic() < deadline, "the browser does not answer"
            if select.select([self._hears], [], [], 1.0)[0]:
                self._pending += os.read(self._hears, 1 << 20)
