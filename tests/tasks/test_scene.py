"""The scenes' models: what collides, what only marks, and panels that a limb cannot pierce
unnoticed."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from coordlog.errors import ConfigError, SimulationError
from coordlog.kinematics.pairs import obstacles
from coordlog.mjcf import compile_model, compose
from coordlog.tasks.config import EnvConfig
from coordlog.tasks.scene import SCENES, find, sphere_geom

PAPER = ("free", "spheres", "table", "shelf")
CAPSULE = mujoco.mjtGeom.mjGEOM_CAPSULE


@pytest.fixture(scope="module")
def models():
    return {name: compile_model(compose(scene, EnvConfig())) for name, scene in SCENES.items()}


def limbs(model, robot):
    """Radius and axis length of every capsule that the action moves, [m]."""
    moved = set()
    for name in robot.action_joints:
        moved.add(int(model.joint(name).bodyid[0]))
    for body in range(model.nbody):  # children come after their parents
        if int(model.body_parentid[body]) in moved:
            moved.add(body)
    return [(size[0], 2 * size[1]) for kind, body, size in zip(model.geom_type, model.geom_bodyid, model.geom_size, strict=True)
            if kind == CAPSULE and body in moved]  # fmt: skip


def capsule_and_box(half, radius, length):
    """A free capsule and a plate 30 cm by 60 cm at the origin, `half` its half thickness."""
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody><geom type="box" size=".15 .3 {half}"/><body><freejoint/>'
        f'<geom type="capsule" size="{radius} {length / 2}" mass="1"/></body></worldbody></mujoco>'
    )


def missed(model, *, poses, rng):
    """Of random poses whose axis runs through the plate: how many, and how many MuJoCo reports as
    free."""
    data, half = mujoco.MjData(model), model.geom_size[1, 1]
    along = np.linspace(-half, half, 101)[:, None]
    piercing = unnoticed = 0
    for _ in range(poses):
        data.qpos[:3] = rng.uniform(-1, 1, 3) * [0.15, 0.3, model.geom_size[0, 2] + half]
        data.qpos[3:] = rng.normal(size=4)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        axis = data.geom_xpos[1] + along * data.geom_xmat[1].reshape(3, 3)[:, 2]
        if (np.abs(axis) < model.geom_size[0]).all(axis=1).any():
            piercing += 1
            unnoticed += data.ncon == 0
    return piercing, unnoticed


def test_a_scene_is_found_by_name_and_an_unknown_one_lists_the_choices():
    assert find("table") is SCENES["table"]
    with pytest.raises(
        ConfigError,
        match=r"unknown scene 'desk'; choose one of: a FILE.py:NAME of your own, free, hold, planar, shelf, spheres, table",
    ):
        find("desk")


def test_the_text_is_the_same_every_time():
    for scene in SCENES.values():
        assert compose(scene, EnvConfig()) == compose(scene, EnvConfig())


def test_text_and_model_need_no_file():
    for scene in SCENES.values():
        assert "file=" not in compose(scene, EnvConfig()).text


@pytest.mark.parametrize("name", PAPER)
def test_panels_are_too_thick_for_a_moving_limb_to_pierce_unnoticed(models, name):
    for panel in SCENES[name].panels:
        for radius, length in limbs(models[name], SCENES[name].robot):
            assert 2 * min(panel.half) + 2 * radius > length, (
                f"{panel.name}: a capsule of {length:.3f} m fits through"
            )
        assert min(panel.half) >= max(
            radius for radius, _ in limbs(models[name], SCENES[name].robot)
        )


def test_the_rule_covers_the_arms(models):
    assert (
        len(limbs(models["table"], SCENES["table"].robot)) >= 6
    )  # two upper arms, two forearms of two capsules each


def test_mujoco_does_not_notice_a_capsule_through_a_thin_plate():
    """The reason for the rule: straight through the middle, both ends clear, and no contact."""
    radius, length = 0.02, 0.094  # the forearm's
    for half, contacts in ((0.005, 0), (0.03, 1)):
        model = capsule_and_box(half, radius, length)
        data = mujoco.MjData(model)
        data.qpos[:3] = 0.01, 0.02, 0.003
        data.qpos[3:] = 1, 0.05, 0.03, 0
        mujoco.mj_forward(model, data)
        assert (data.ncon > 0) == contacts, half


def test_the_rule_is_sharp_enough():
    rng = np.random.default_rng(0)
    for radius, length in (
        (0.024, 0.074),
        (0.02, 0.094),
        (0.018, 0.068),
    ):  # upper arm, forearm, hand
        thin = missed(capsule_and_box(0.003, radius, length), poses=600, rng=rng)
        thick = missed(capsule_and_box(0.03, radius, length), poses=600, rng=rng)
        assert thin[1] > 0.02 * thin[0]
        assert thick[0] > 150
        assert thick[1] == 0


def test_the_object_and_the_goals_touch_nothing(models):
    for model in models.values():
        for i in range(model.ngeom):
            name = model.geom(i).name
            if name == "object" or name.startswith("goal_"):
                assert not model.geom_contype[i], name
                assert not model.geom_conaffinity[i], name


def test_only_soles_on_the_floor_have_four_dimensions(models):
    for name in PAPER:
        model = models[name]
        assert (model.geom_condim == 3).all()
        assert (model.pair_dim == 4).all()
        pairs = {
            (model.geom(a).name, model.geom(b).name)
            for a, b in zip(model.pair_geom1, model.pair_geom2, strict=True)
        }
        assert {frozenset(pair) for pair in pairs} == {
            frozenset(("floor", sole)) for sole in SCENES[name].robot.soles
        }


def test_obstacles_are_the_panels_and_the_spheres_and_nothing_else(models):
    named = {
        name: {model.geom(int(i)).name for i in obstacles(model)} for name, model in models.items()
    }
    assert named["free"] == named["planar"] == set()
    assert named["spheres"] == {"sphere_0", "sphere_1", "sphere_2"}
    assert named["table"] == {"table"}
    assert named["shelf"] == {
        f"shelf_{part}" for part in ("bottom", "top", "back", "left", "right")
    }


def test_spheres_that_overlap_one_another_or_the_floor_are_no_contact(models):
    model = models["spheres"]
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    before = data.ncon
    data.mocap_pos[model.body("sphere_0").mocapid[0]] = 1.0, 1.0, 0.0
    data.mocap_pos[model.body("sphere_1").mocapid[0]] = 1.0, 1.0, 0.01
    mujoco.mj_forward(model, data)
    assert data.ncon == before


def test_the_object_stands_on_the_table_and_in_the_shelf(models):
    for name in ("table", "shelf"):
        scene = SCENES[name]
        for panel in scene.panels:
            for corner in np.array(np.meshgrid(*scene.object_box)).T.reshape(-1, 3):
                gap = np.abs(corner - panel.centre) - panel.half - scene.object_half
                assert gap.max() >= -1e-9, f"{panel.name} and the object at {corner}"
        floor = min(scene.object_box[2]) - scene.object_half[2]
        assert any(abs(panel.centre[2] + panel.half[2] - floor) < 0.011 for panel in scene.panels)


def test_radii_are_written_exactly():
    radii = (1 / 30, 0.05, 0.0123456789012345678)
    model = compile_model(compose(SCENES["spheres"], EnvConfig(), radii))
    assert tuple(float(model.geom(sphere_geom(i)).size[0]) for i in range(3)) == radii


def test_a_diverged_state_is_not_reset_by_mujoco(models):
    for model in models.values():
        assert model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_AUTORESET


def test_the_zero_moment_points_sensor_is_there_when_asked_for():
    def names(config):
        model = compile_model(compose(SCENES["free"], config))
        return {model.sensor(i).name for i in range(model.nsensor)}

    assert names(EnvConfig(balance="com+zmp")) - names(EnvConfig()) == {"com_velocity"}


def test_text_that_mujoco_refuses_is_said_with_its_reason():
    with pytest.raises(SimulationError, match="MuJoCo says: XML Error"):
        compile_model("<mujoco><worldbody><geom type='cube'/></worldbody></mujoco>")


def test_an_object_without_a_place_is_refused():
    with pytest.raises(
        ConfigError,
        match="scene 'free': an object needs both object_half and object_box, got one of them",
    ):
        replace(SCENES["free"], object_box=None)


def test_an_object_between_three_arms_is_refused():
    with pytest.raises(
        ConfigError, match="scene 'planar': an object needs two arms, the left one first, got 3"
    ):
        replace(SCENES["planar"], object_half=(0.1, 0.1, 0.1), object_box=((0, 1), (0, 1), (0, 1)))


def test_spheres_without_a_place_are_refused():
    with pytest.raises(ConfigError, match="scene 'free': spheres need a sphere_box"):
        replace(SCENES["free"], spheres=2)
