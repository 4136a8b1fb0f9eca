"""Images come of proven states alone, and become what LeRobot shows."""

from pathlib import Path

import numpy as np
import pytest

from coordlog.episode import INITIAL_STATE
from coordlog.errors import ConfigError, FormatError, SimulationError
from coordlog.exchange import cameras
from coordlog.exchange.blocks import Options
from coordlog.exchange.source import Loaded
from coordlog.mjcf import load_attached
from tests.spoken import sound

PLANAR = next((Path(__file__).parents[1] / "data" / "v1" / "planar").glob("*.mcap"))
CAMERA = "pos=0.3,-0.2,2 lookat=0.3,0,0"
SMALL = Options("lerobot", (CAMERA,), 64, 48)


@pytest.fixture(scope="module")
def loaded():
    return Loaded(PLANAR)


@pytest.fixture(scope="module")
def model(loaded):
    return load_attached(loaded.attachments)


@pytest.fixture(scope="module")
def shown(loaded):
    try:
        return [images[CAMERA] for images in cameras.frames(loaded, SMALL)]
    except SimulationError:
        pytest.skip("no OpenGL here")


def test_every_state_is_seen_and_the_robot_moves(shown, loaded):
    assert len(shown) == len(loaded.episode) + 1
    assert all(image.shape == (48, 64, 3) for image in shown)
    assert (shown[0] != shown[-1]).any()
    assert shown[0].std() > 5


def test_a_log_that_does_not_come_back_is_not_shown(loaded, model):
    start = np.frombuffer(loaded.attachments[INITIAL_STATE], np.float64).copy()
    cameras.require_exact(loaded, model, start)
    start[1] += 1e-12
    with pytest.raises(FormatError, match="step 0: qpos simulated again differs"):
        cameras.require_exact(loaded, model, start)


@pytest.mark.parametrize(
    ("camera", "said"),
    [
        ("nowhere", "unknown camera 'nowhere'; choose one of: front"),
        ("pos=1,2 lookat=0,0,0", "expected"),
        ("pos=0,0,0 lookat=0,0,0", "two different points"),
        ("pos=a,b,c lookat=0,0,0", "unknown camera"),
    ],
)
def test_a_camera_that_is_none_is_said(model, camera, said):
    with pytest.raises(ConfigError, match=said):
        cameras.view_of(camera, model)


def test_a_free_camera_looks_where_it_is_told(model):
    view = cameras.view_of("pos=1,1,1 lookat=0,0,1", model)
    assert (view.distance, view.azimuth, view.elevation) == pytest.approx((2**0.5, -135.0, 0.0))


@pytest.mark.usefixtures("shown")
def test_a_set_with_a_camera_has_a_video_of_every_step(tmp_path):
    import av
    from robovet.checks import run_doctor
    from robovet.dataset import LeRobotDataset

    command = ("export", PLANAR, "--to", "lerobot", "--out", tmp_path / "set")
    assert sound(*command, "--camera", CAMERA, "--size", "64x64").stderr == ""
    (video,) = (tmp_path / "set").rglob("*.mp4")
    with av.open(str(video)) as file:
        stamps = [float(frame.time) for frame in file.decode(video=0)]
    np.testing.assert_allclose(stamps, np.arange(len(Loaded(PLANAR).episode)) / 25, atol=1e-4)
    report = run_doctor(LeRobotDataset(tmp_path / "set"))
    assert (report.counts["FAIL"], report.counts["WARN"]) == (0, 0)


def test_depth_and_segmentation_are_those_of_mujocos_own_renderer(loaded, model, shown):
    import mujoco

    data = mujoco.MjData(model)
    data.qpos[:] = loaded.episode.qpos[0]
    mujoco.mj_forward(model, data)
    view = cameras.view_of(CAMERA, model)
    with cameras.Canvas(model, 64, 48) as canvas:
        first = canvas.shown(data, view)
        depth, seen = (canvas.shown(data, view, kind) for kind in ("depth", "segmentation"))
        np.testing.assert_array_equal(canvas.shown(data, view), first)
    with mujoco.Renderer(model, 48, 64) as renderer:
        renderer.update_scene(data, view)
        renderer.enable_depth_rendering()
        np.testing.assert_allclose(depth[:, :, 0], renderer.render(), rtol=1e-5)
        renderer.disable_depth_rendering()
        renderer.enable_segmentation_rendering()
        renderer.update_scene(data, view)
        ids, kinds = np.moveaxis(renderer.render(), 2, 0)
    wanted = np.where(kinds == mujoco.mjtObj.mjOBJ_GEOM, ids, -1)
    np.testing.assert_array_equal(seen[:, :, 0], wanted)
    assert len(np.unique(seen)) > 2


def test_depth_goes_into_arrays_and_not_into_videos(tmp_path, shown):
    import h5py

    from coordlog.exchange.blocks import export
    from coordlog.exchange.source import entries

    chosen, _ = entries([PLANAR])
    seen = (f"{CAMERA}:depth", f"{CAMERA}:segmentation")
    with pytest.raises(ConfigError, match="videos hold colours alone"):
        export(chosen, tmp_path / "set", Options("lerobot", seen, 64, 48))
    export(chosen, tmp_path / "set", Options("robomimic", seen, 64, 48))
    with h5py.File(tmp_path / "set" / "data.hdf5") as file:
        obs = file["data/demo_0/obs"]
        (depth,) = (item for name, item in obs.items() if name.endswith("_depth"))
        assert (depth.shape[1:], depth.dtype) == ((48, 64, 1), np.float32)
        assert any(name.endswith("_segmentation") for name in obs)
