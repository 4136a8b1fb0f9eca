"""The viewer is ours alone: where it listens, what it reports, what its pictures show."""

import io
import json
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from dataclasses import replace

import numpy as np
import psutil
import pytest
from PIL import Image

from coordlog.errors import ConfigError, ViewerError
from coordlog.view import palette, scene, viewer
from coordlog.view.headless import Headless, screenshot
from coordlog.view.overview import to_overview
from coordlog.view.recording import to_rerun
from coordlog.view.viewer import BINARY, claim, open_window
from coordlog.view.web import web_viewer
from tests.view.recordings import Recording

SIZE = (1000, 700)


def pixels(png):
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)


def near(image, colour, tolerance=8):
    """Pixels that are a colour, (height, width) bool."""
    return np.abs(image - np.array(colour[:3])).max(axis=-1) <= tolerance


def hue(image, colour):
    """Pixels that are a lit surface of a colour: the same direction in RGB, however bright."""
    direction = np.array(colour[:3]) / np.linalg.norm(colour[:3])
    length = np.linalg.norm(image, axis=-1) + 1e-9
    return (image @ direction / length > 0.998) & (length > 90)


@pytest.fixture(scope="module")
def pictures(smoothed, shows, tmp_path_factory):
    """Pictures of the scene as it is, without hands, and of the whole overview.

    And what the viewer complained about.
    """
    folder = tmp_path_factory.mktemp("pictures")
    Recording(to_rerun([smoothed]), folder / "whole.rrd")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scene, "draw_hands", lambda stream, stage: None)
        Recording(to_rerun([smoothed]), folder / "handless.rrd")
    Recording(
        to_overview([replace(show, file=name) for name, show in shows.items()]),
        folder / "overview.rrd",
    )
    taken, complaints = {}, []
    try:
        with Headless(size=SIZE) as headless:
            for name, at, kind in (
                ("whole", 0.24, "3D"),
                ("handless", 0.24, "3D"),
                ("overview", 2, ""),
            ):
                headless.open(folder / f"{name}.rrd")
                headless.seek(at)
                taken[name] = pixels(headless.picture(kind))
                complaints += headless.complaints()
    except ViewerError as error:
        if "Vulkan" in str(error):
            pytest.skip(str(error))
        raise
    return taken, complaints


def test_no_view_reports_an_error(pictures):
    assert pictures[1] == []


def test_robot_and_table_are_seen(pictures):
    image = pictures[0]["whole"]
    area = image.shape[0] * image.shape[1]
    assert hue(image, (0.62, 0.45, 0.30)).sum() > 0.03 * area  # the table
    assert hue(image, (0.90, 0.52, 0.32)).sum() > 0.004 * area  # the right side of the robot
    assert hue(image, (0.26, 0.52, 0.80)).sum() > 0.004 * area  # the left side


@pytest.mark.parametrize("arm", [0, 1])
def test_executed_path_and_spline_are_seen(pictures, arm):
    whole, handless = pictures[0]["whole"], pictures[0]["handless"]
    executed, spline = palette.ARMS[arm], palette.bright(palette.ARMS[arm])
    assert near(handless, spline).sum() == 0
    assert near(whole, spline).sum() >= 20
    assert (near(whole, executed) & ~near(handless, executed)).sum() >= 20


def test_contacts_flash_red(pictures):
    assert near(pictures[0]["whole"], palette.BAD, 16).sum() >= 50  # two of them at 0.24 s


def test_the_overview_is_drawn(pictures):
    image = pictures[0]["overview"]
    assert near(image, palette.BACKGROUND, 4).mean() > 0.05
    assert near(image, palette.BACKGROUND, 4).mean() < 0.6
    assert hue(image, palette.JOINTS[0]).sum() > 50  # bars of the histogram


def test_a_screenshot_is_a_file_of_the_size_asked_for(shows, tmp_path):
    Recording(to_rerun([shows["planar"]]), tmp_path / "a.rrd")
    try:
        assert screenshot(tmp_path / "a.rrd", tmp_path / "a.png", at=1.0, size=(640, 480)) == []
    except ViewerError as error:
        if "Vulkan" in str(error):
            pytest.skip(str(error))
        raise
    with Image.open(tmp_path / "a.png") as image:
        assert image.size == (640, 480)
    with pytest.raises(ConfigError, match=r"--at: expected 0 to 1\.6 on"):
        screenshot(tmp_path / "a.rrd", tmp_path / "b.png", at=99.0)
    assert not (tmp_path / "b.png").exists()


def test_without_vulkan_there_is_one_sentence(shows, tmp_path, monkeypatch):
    monkeypatch.setenv("VK_DRIVER_FILES", "/nowhere.json")
    monkeypatch.setenv("VK_ICD_FILENAMES", "/nowhere.json")
    Recording(to_rerun([shows["planar"]]), tmp_path / "a.rrd")
    with pytest.raises(ViewerError, match=r"no Vulkan device: install .* or use --save"):
        screenshot(tmp_path / "a.rrd", tmp_path / "a.png")


def test_without_a_display_there_is_one_sentence(tmp_path, monkeypatch):
    monkeypatch.setattr(viewer.sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(
        ViewerError, match=r"no display: .* --web, --screenshot FILE or --save FILE"
    ):
        open_window([tmp_path / "a.rrd"])


def test_a_port_that_is_taken_is_said():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(ViewerError, match=f"port {port} on 127.0.0.1 cannot be used"):
            claim(port)
    assert claim(port) == port


def test_telemetry_is_off_and_the_users_own_settings_stay_as_they_are(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "theirs"))
    environment = viewer.environment(tmp_path / "ours")
    said = subprocess.run(
        [BINARY, "analytics", "config"], env=environment, capture_output=True, text=True, check=True
    ).stdout
    assert json.loads(said[said.index("{") :])["analytics_enabled"] is False
    assert not (tmp_path / "theirs").exists()


def test_the_page_is_served_to_this_machine_only_and_may_reach_nothing_else(shows, tmp_path):
    Recording(to_rerun([shows["planar"]]), tmp_path / "a.rrd")
    before = {child.pid for child in psutil.Process().children()}
    with web_viewer(tmp_path / "a.rrd") as address:
        with urllib.request.urlopen(address) as answer:
            policy, page = answer.headers["Content-Security-Policy"], answer.read().decode()
        assert "Rerun" in page
        allowed = {word for word in policy.replace(";", " ").split() if "//" in word}
        assert len(allowed) == 1
        assert allowed.pop().startswith("http://127.0.0.1:")
        children = [child for child in psutil.Process().children() if child.pid not in before]
        listening = [
            each.laddr.ip
            for child in [*children, psutil.Process()]
            for each in child.net_connections()
            if each.status == "LISTEN"
        ]
        assert len(listening) >= 3
        assert set(listening) == {"127.0.0.1"}
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(address.split("?")[0] + "no-such-file")
    assert not any(
        child.is_running() and child.status() != psutil.STATUS_ZOMBIE for child in children
    )


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel does that on Linux")
def test_a_viewer_ends_with_the_process_that_started_it_however_that_ends():
    program = (
        "from coordlog.view.viewer import Viewer\n"
        "with Viewer('--serve-web', '--web-viewer-port', '0') as viewer:\n"
        "    print(viewer.process.pid, flush=True)\n"
        "    viewer.process.wait()"
    )
    words = [sys.executable, "-c", program]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as parent:
        child = psutil.Process(int(parent.stdout.readline()))
        assert child.is_running()
        parent.kill()
    _, alive = psutil.wait_procs([child], timeout=20)
    assert not alive
