"""Pictures show what they should; without OpenGL the error says what to install."""

import os
import subprocess
import sys

import numpy as np
import pytest

from coordlog.errors import ConfigError, SimulationError, StorageError
from coordlog.sim import render as pictures
from coordlog.sim.env import BatchEnv
from coordlog.sim.render import Painter, View, picture, picture_of, view_of, write_png
from coordlog.tasks.scene import SCENES, find

SMALL = {"width": 160, "height": 120}


def rendering():
    try:
        return picture(find("planar"), **SMALL)
    except SimulationError:
        return None


pytestmark = pytest.mark.skipif(rendering() is None, reason="no OpenGL here")


def share(image, hue):
    """Share of the pixels of a hue, by which channels stand out.

    Light and see-through things leave the order as it is.
    """
    red, green, blue = (image[..., i].astype(int) for i in range(3))
    found = {
        "blue": (blue > green + 20) & (green > red + 10),
        "brown": (red > green + 20) & (green > blue + 5),
        "green": (green > red + 20) & (green > blue + 20),
        "violet": (red > green + 30) & (blue > green + 30),
    }
    return float(found[hue].mean())


@pytest.fixture(scope="module")
def env():
    env = BatchEnv(SCENES["table"], n=1, threads=1)
    env.reset(np.array([0]), [env.problem(seed=0, split="train", index=0)])
    return env


@pytest.mark.parametrize("name", ["free", "spheres", "table", "shelf"])
def test_robot_obstacle_and_object_are_in_the_picture(name):
    image = picture(find(name), **SMALL)
    assert image.shape == (120, 160, 3)
    assert image.dtype == np.uint8
    assert share(image, "blue") > 0.005  # the robot's left
    assert share(image, "green") > 0.001  # the object
    assert 0.003 < share(image, "brown") < 0.5  # its right, and wood
    assert (share(image, "violet") > 0.002) == (name == "spheres")
    assert (share(image, "brown") > 0.03) == (name in ("table", "shelf"))
    corner = image[:3, :3].reshape(-1, 3) / 255.0
    assert corner == pytest.approx(np.tile(pictures.BACKDROP, (9, 1)), abs=0.01)


def test_start_and_end_differ_and_pictures_repeat():
    start, end = (picture(find("table"), posture=posture, **SMALL) for posture in ("start", "end"))
    assert (np.abs(start.astype(int) - end).max(axis=2) > 30).mean() > 0.005
    assert picture(find("table"), posture="end", **SMALL).tobytes() == end.tobytes()


def test_an_unknown_posture_is_refused():
    with pytest.raises(ConfigError, match="unknown posture 'sitting'; choose one of: end, start"):
        picture(find("free"), posture="sitting")


def test_the_model_that_is_drawn_stays_as_it_is(env):
    model = env.task.model
    before = (
        model.geom_rgba.copy(),
        model.geom_size.copy(),
        model.vis.global_.offwidth,
        model.light_dir.copy(),
    )
    picture_of(
        model, env.physics.qpos[0], env.physics.mocap_pos[0], view=view_of(env.scene.robot), **SMALL
    )
    after = (model.geom_rgba, model.geom_size, model.vis.global_.offwidth, model.light_dir)
    assert all(np.array_equal(one, other) for one, other in zip(before, after, strict=True))


def test_a_panel_that_hides_the_hands_is_see_through_and_no_other(env):
    shelf = BatchEnv(SCENES["shelf"], n=1, threads=1)
    shelf.reset(np.array([0]), [shelf.problem(seed=0, split="train", index=0)])
    for each, name, wanted in (
        (shelf, "shelf_left", pictures.SEE_THROUGH),
        (shelf, "shelf_right", 1.0),
        (env, "table", 1.0),
    ):
        with Painter(each.task.model, view=view_of(each.scene.robot), **SMALL) as painter:
            painter.paint(each.physics.qpos[0], each.physics.mocap_pos[0])
            assert painter._model.geom(name).rgba[3] == pytest.approx(wanted), name


def test_a_painter_draws_many_states_and_sizes():
    env = BatchEnv(SCENES["spheres"], n=1, threads=1)
    env.reset(np.array([0]), [env.problem(seed=0, split="train", index=0)])
    sizes = env.physics.model_of(0).geom_size
    with Painter(env.task.model, view=view_of(env.scene.robot), **SMALL) as painter:
        small = painter.paint(env.physics.qpos[0], env.physics.mocap_pos[0], sizes=sizes)
        bigger = sizes.copy()
        bigger[env.task.sphere_geoms, 0] = 0.12
        large = painter.paint(env.physics.qpos[0], env.physics.mocap_pos[0], sizes=bigger)
        assert share(large, "violet") > 1.5 * share(small, "violet")
        assert (
            painter.paint(env.physics.qpos[0], env.physics.mocap_pos[0], sizes=sizes).tobytes()
            == small.tobytes()
        )


def test_another_view_is_another_picture(env):
    behind = View((0.1, 0.0, 0.45), 1.4, 20.0, -10.0)
    one = picture_of(
        env.task.model, env.physics.qpos[0], env.physics.mocap_pos[0], view=behind, **SMALL
    )
    other = picture_of(
        env.task.model,
        env.physics.qpos[0],
        env.physics.mocap_pos[0],
        view=view_of(env.scene.robot),
        **SMALL,
    )
    assert (one != other).mean() > 0.05


def test_a_png_is_read_back_as_it_was(tmp_path):
    from PIL import Image

    image = np.random.default_rng(0).integers(0, 256, (30, 40, 3), dtype=np.uint8)
    write_png(tmp_path / "image.png", image)
    assert np.array_equal(np.asarray(Image.open(tmp_path / "image.png")), image)


def test_a_png_that_cannot_be_written_is_said(tmp_path):
    with pytest.raises(
        StorageError, match=r"missing/image\.png: cannot write the picture: No such file"
    ):
        write_png(tmp_path / "missing" / "image.png", np.zeros((2, 2, 3), dtype=np.uint8))


def test_without_opengl_the_error_says_what_to_install():
    code = (
        "from coordlog.sim.render import picture; from coordlog.tasks.scene import find; from coordlog.errors import SimulationError\n"
        "try: picture(find('planar'))\nexcept SimulationError as error: print(error)"
    )
    environment = {
        **os.environ,
        "MUJOCO_GL": "egl",
        "__EGL_VENDOR_LIBRARY_DIRS": "/nowhere",
        "__EGL_VENDOR_LIBRARY_FILENAMES": "/nowhere",
    }
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "pictures: no OpenGL to render with" in done.stdout
    assert "libegl1" in done.stdout
