"""`coordlog view --web` in a real browser: Chromium without a window, painting in software."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

from tests.view.browser import BINARY, Browser

EPISODE = next((Path(__file__).parents[1] / "data" / "v2" / "planar").glob("*.mcap"))
PATIENCE = 240.0
"""Seconds until the robot is seen, on a machine with other work; 15 on an idle one."""
REFUSED = ("Content Security Policy", "Failed to fetch")
"""What the console says of the hosts that the page may not reach."""


@pytest.mark.skipif(BINARY is None, reason="no Chromium: apt-get install chromium")
def test_a_browser_shows_the_robot_and_may_go_away(tmp_path):
    command = [sys.executable, "-m", "coordlog.cli", "view", str(EPISODE), "--web", "--alone"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as served:
        try:
            address = served.stdout.readline().split()[0]
            with Browser(tmp_path) as browser:
                browser.go(address)
                colours, deadline = 0, time.monotonic() + PATIENCE
                while colours < 1000 and time.monotonic() < deadline:
                    time.sleep(2.0)
                    picture = browser.picture()
                    colours = len(np.unique(picture.reshape(-1, 3), axis=0))
                said = browser.complaints()
            # the browser is gone, killed while it was being answered
            started = psutil.Process(served.pid).children(recursive=True)
        finally:
            served.send_signal(signal.SIGTERM)
        out, err = served.communicate(timeout=60)
    assert colours >= 1000  # lit surfaces; a blank page has one, menus without a robot 400
    assert [each for each in said if not any(word in each for word in REFUSED)] == []
    assert (served.returncode, out, err) == (0, "", "")
    assert started
    assert not any(psutil.pid_exists(each.pid) for each in started)
