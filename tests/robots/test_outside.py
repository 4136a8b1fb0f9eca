"""Robots as others write them: what their models mean is taken as MuJoCo means it, and what cannot
work is said before anything is recorded, all at once."""

import re
import struct
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from coordlog.episode import Header
from coordlog.errors import ConfigError, SimulationError
from coordlog.mjcf import compile_model, compose, load_attached, pack_source
from coordlog.mjcf.source import whole
from coordlog.robots.robot import Arm
from coordlog.sim.env import BatchEnv
from coordlog.sim.examine import examine
from coordlog.sim.replay import Log, replay
from coordlog.tasks.config import EnvConfig
from coordlog.tasks.scene import Panel
from tests.robots.outside import robot, scene, text

ONE = np.zeros(1, dtype=int)
URDF = """
<robot name="arm">
  <link name="root"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
  <link name="up"><inertial><mass value="1"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="package://a/none.dae"/></geometry></visual>
    <collision><origin xyz="0 0 0.15"/><geometry><mesh filename="package://things/a.stl"/></geometry>
    </collision></link>
  <link name="hand"><inertial><mass value="0.2"/>
    <inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="a" type="revolute"><parent link="root"/><child link="up"/><axis xyz="0 1 0"/>
    <origin xyz="0 0 0.1"/><limit lower="-1.5" upper="1.5" effort="40" velocity="3"/></joint>
  <joint name="b" type="continuous"><parent link="up"/><child link="hand"/><axis xyz="0 1 0"/>
    <origin xyz="0 0 0.3"/></joint>
</robot>
"""


def stl(size=0.05):
    """A tetrahedron as a binary STL."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=np.float32) * size
    faces = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]
    body = b"".join(
        struct.pack("<12fH", 0, 0, 0, *corners[list(face)].ravel(), 0) for face in faces
    )
    return b"\0" * 80 + struct.pack("<I", len(faces)) + body


MESH = {
    "asset": '<asset><mesh name="m" file="m.stl"/></asset>',
    "fore": 'name="fore" type="mesh" mesh="m"',
}


def started(where, **options):
    env = BatchEnv(where, n=1, threads=1, **options)
    env.reset(ONE, [env.problem(seed=0, split="train", index=0)])
    return env


def rested(where):
    """Angles of the two joints in the settled start pose."""
    env = BatchEnv(where, n=1, threads=1)
    return env._rest[1:3]


def faulty(where):
    with pytest.raises(ConfigError) as error:
        BatchEnv(where, n=1, threads=1)
    return str(error.value)


def test_a_servo_is_found_by_its_joint_whatever_its_name():
    servo = '<position name="act2" joint="b" inheritrange="1"/>'
    assert rested(scene(servo=servo)) == pytest.approx([0.4, 0.8], abs=0.02)


def test_a_servo_with_a_gear_and_units_of_its_own_still_means_angles():
    servo = '<general joint="b" gear="2" gainprm="50" biastype="affine" biasprm="0 -100 -2"/>'
    assert rested(scene(servo=servo)) == pytest.approx([0.4, 0.8], abs=0.03)


@pytest.mark.parametrize(
    ("servo", "kind"),
    [
        ('<motor name="b" joint="b" ctrlrange="-20 20"/>', "torque motor"),
        ('<velocity name="b" joint="b" kv="5"/>', "velocity servo"),
        ('<intvelocity name="b" joint="b" kp="9" actrange="-2 2"/>', "velocity that is integrated"),
        ("", "no actuator"),
    ],
)
def test_what_is_no_position_servo_is_named_and_gets_one_where_gains_are_given(servo, kind):
    said = faulty(scene(servo=servo))
    assert kind in said
    assert "servo_gains" in said
    given = scene(servo=servo, servo_gains={"*": (200.0, 5.0)})
    assert rested(given) == pytest.approx([0.4, 0.8], abs=0.02)


def test_a_motor_that_becomes_a_servo_keeps_its_limit():
    servo = '<motor name="b" joint="b" gear="3" ctrlrange="-2 2"/>'
    where = scene(servo=servo, servo_gains={"b": (200.0, 5.0)})
    model = compile_model(compose(where, EnvConfig()))
    assert model.actuator("b").forcerange.tolist() == [-6.0, 6.0]


def test_an_actuator_that_is_no_joint_servo_is_held_and_moves_nothing_else():
    pull = {
        "more": '<tendon><fixed name="t"><joint joint="b" coef="1"/></fixed></tendon>',
        "servo": '<position name="b" joint="b" inheritrange="1"/><general name="pull" tendon="t" gainprm="30"/>',
    }
    assert rested(scene(**pull)) == pytest.approx([0.4, 0.8], abs=0.02)
    keyed = pull | {
        "more": pull["more"]
        + '<keyframe><key name="stand" qpos="0.4 0.8" ctrl="0 0 5.3"/></keyframe>'
    }
    assert BatchEnv(scene(**keyed))._rest is not None
    assert started(scene(**keyed)).physics.ctrl[0, 2] == 5.3
    said = started(scene(**keyed, held={"pull": 5.2}))
    assert said.physics.ctrl[0, 2] == 5.2


@pytest.mark.parametrize("condim", [1, 3, 4, 6])
@pytest.mark.parametrize(
    "pair", ["", '<contact><pair geom1="base" geom2="fore" condim="{}"/></contact>']
)
def test_a_contact_counts_by_what_it_joins_whatever_it_comes_from(condim, pair):
    where = scene(
        geom=f'condim="{condim}"',
        b='range="-3.1 3.1"',
        fore='name="fore" fromto="0 0 0 0 0 0.345"',
        more=pair.format(condim),
        pose=(0.0, -2.0),
    )
    env = started(where)
    into = env.task.servos[1]
    flags = []
    for _ in range(60):
        outcome = env.step(np.array([[0.0, -1.0]], dtype=np.float32), ONE)
        flags.append(bool(outcome.collision[0]))
        assert flags[-1] == (len(outcome.contacts[0]) > 0)
    assert into >= 0
    assert flags[0] is False
    assert flags[-1] is True
    names = {env.task.model.geom(int(g)).name for g in outcome.contacts[0]["geom1"]}
    assert names == {"base"}
    assert (outcome.contacts[0]["depth"] >= 0).all()


def test_what_is_near_but_does_not_touch_is_no_contact():
    env = started(scene(geom='gap="0.3"'))
    for _ in range(5):
        outcome = env.step(np.zeros((1, 2), dtype=np.float32), ONE)
        assert not outcome.collision[0]
        assert not len(outcome.contacts[0])


def test_the_robots_own_geoms_in_the_world_are_no_obstacles():
    world = '<geom name="plinth" type="box" size="0.05 0.05 0.115" pos="0 0 0.3"/>'
    env = started(scene(world=world))
    assert env.draw.reach.touches(np.array([0.4, 0.8]), clearance=0.02) is False
    assert env.draw.tally["feasible"] == 1


def test_what_lies_against_one_another_by_design_is_let_be_and_listed():
    extra = '<body name="lid" pos="0 0 0.079"><joint name="c" type="slide" axis="0 0 1"/><geom name="lid" type="box" size="0.04 0.04 0.03"/></body>'
    where = scene(free=extra)
    env = started(where)
    names = [[env.task.model.geom(g).name for g in pair] for pair in env.resting]
    assert names == [["base", "lid"]]
    assert not env.step(np.zeros((1, 2), dtype=np.float32), ONE).collision[0]
    assert env.describe()["resting"] == [list(pair) for pair in env.resting]


def test_a_palm_may_be_a_body():
    env = started(scene(palm="fore"))
    fore = env.task.model.body("fore").id
    data = mujoco.MjData(env.task.model)
    data.qpos[:] = env.physics.qpos[0]
    mujoco.mj_kinematics(env.task.model, data)
    assert env.task.palms(env.physics.sensors)[0, 0] == pytest.approx(data.xpos[fore])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"palm": "nowhere"}, "expected a site or a body called 'nowhere' as its palm"),
        ({"palm": "stand"}, "palm 'stand' of arm 'arm' is not moved by 'a', 'b'"),
        ({"free": "<freejoint/>"}, "a free base and no soles"),
        (
            {"kp": "4", "pose": (1.2, 0.8)},
            r"joint 'a' was asked to be at 1.200 rad and came to rest",
        ),
        ({"asset": MESH["asset"], "fore": MESH["fore"]}, "mesh 'm' reads m.stl, which is not in"),
        ({"world": '<geom name="goal_arm" size="0.1"/>'}, "geom 'goal_arm', which the scene adds"),
        ({"b": 'type="ball"', "servo": ""}, "joint 'b' is a ball or a free joint"),
    ],
)
def test_what_cannot_work_is_said_in_a_sentence(changes, said):
    assert said in faulty(scene(**changes))


def test_all_faults_of_a_model_are_said_at_once():
    said = faulty(scene(palm="nowhere", servo="", world='<geom name="goal_arm" size="0.1"/>'))
    for part in ("nowhere", "no position servo", "goal_arm"):
        assert part in said


def test_swapped_palms_are_found_out():
    one = robot()
    two = replace(
        one, arms=(Arm("left", "upper", ("b",)), Arm("right", "tip", ("a",))), poses={"stand": {}}
    )
    said = faulty(replace(scene(), robot=two))
    assert "palm 'upper' of arm 'left' is not moved by 'b'" in said
    assert "palm 'tip' of arm 'right' is moved by 'b' of arm 'left'" in said


def test_an_unlimited_joint_turns_all_the_way_round_unless_it_is_said_otherwise():
    free = scene(b="", servo='<position name="b" joint="b" kp="200"/>')
    assert started(free).task.limits[1] == pytest.approx([-np.pi, np.pi])
    said = scene(b="", servo='<position name="b" joint="b" kp="200"/>', ranges={"b": (-1.0, 2.0)})
    assert started(said).task.limits[1].tolist() == [-1.0, 2.0]


def test_flags_and_keyframes_of_the_models_own_stay():
    env = started(scene(option='<flag energy="enable"/>'))
    assert env.task.model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_ENERGY
    assert env.task.model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_AUTORESET


def test_geoms_without_names_are_called_by_their_bodies():
    env = started(scene(base="", upper="", fore='fromto="0 0 0 0 0 0.2"'))
    assert {"geom 0 of stand", "geom 0 of upper", "geom 0 of fore"} <= set(env.describe()["geoms"])


def test_meshes_go_along_as_the_corners_of_their_hulls(tmp_path):
    (tmp_path / "m.stl").write_bytes(stl())
    (tmp_path / "arm.xml").write_text(text(**MESH))
    models = []
    for mjcf, assets in (
        (tmp_path / "arm.xml", None),
        (text(**MESH), tmp_path),
        (text(**MESH), {"m.stl": stl()}),
    ):
        source = compose(replace(scene(), robot=robot(mjcf, assets=assets)), EnvConfig())
        packed = pack_source(source)
        assert str(tmp_path) not in source.text
        assert [name.split("/")[0] for name in packed] == ["model.xml.zst", "assets"]
        models.append(load_attached(packed))
    whole = mujoco.MjModel.from_xml_string(text(**MESH), {"m.stl": stl()})
    for model in models:
        assert model.nmeshvert == 4
        for name in ("stand", "upper", "fore"):
            assert model.body(name).mass == pytest.approx(whole.body(name).mass)
            assert model.body(name).inertia == pytest.approx(whole.body(name).inertia, rel=1e-6)
        data, other = mujoco.MjData(model), mujoco.MjData(whole)
        for each, d in ((model, data), (whole, other)):
            mujoco.mj_kinematics(each, d)
        corners = [
            d.geom("fore").xmat.reshape(3, 3) @ m.mesh_vert[:4].T + d.geom("fore").xpos[:, None]
            for m, d in ((model, data), (whole, other))
        ]
        assert np.sort(corners[0], axis=1) == pytest.approx(np.sort(corners[1], axis=1), abs=2e-6)


def test_a_urdf_gets_servos_and_replays(tmp_path):
    (tmp_path / "things").mkdir()
    (tmp_path / "things" / "a.stl").write_bytes(stl())
    (tmp_path / "robots").mkdir()
    file = tmp_path / "robots" / "arm.urdf"
    file.write_text(URDF)
    where = replace(
        scene(), robot=robot(file, palm="hand", servo_gains={"*": (300.0, 20.0)}, pose=(0.3, 0.2))
    )
    env = started(where)
    packed = env.attachments(0)
    actions = np.random.default_rng(0).uniform(-1, 1, (10, 2)).astype(np.float32)
    states = [env.physics.qpos[0].copy()]
    for action in actions:
        env.step(action[None], ONE)
        states.append(env.physics.qpos[0].copy())
    header = Header(
        {"schema_version": 2}, env.describe() | {"task": {"name": "reach", "fields": []}}, {}
    )
    log = Log(header, load_attached(packed), np.frombuffer(packed["initial_state.f64"]), actions)
    assert replay([log])[0].columns["qpos"].tobytes() == np.stack(states).tobytes()


@pytest.mark.parametrize(
    ("file", "data", "said"),
    [
        ("m.stl", b"version https://git-lfs.github.com/spec/v1\noid", "m.stl, which is a Git LFS"),
        ("m.stl", b"solid x\nfacet normal 0 0 1\n" * 9, "mesh 'm': stl_decoder"),
        ("m.obj", b"<!DOCTYPE html><html>404</html>", "mesh 'm': a web page"),
        ("M.OBJ", None, "M.OBJ, which is not in .* (there is m.obj: large and small letters"),
    ],
)
def test_a_mesh_that_is_something_else_is_called_by_its_name(file, data, said, tmp_path):
    (tmp_path / file.lower()).write_bytes(data or b"v 0 0 0\n")
    asset = f'<asset><mesh name="m" file="{file}"/></asset>'
    path = tmp_path / "model.xml"
    path.write_text(text(asset=asset, fore='name="fore" type="mesh" mesh="m"'))
    with pytest.raises(ConfigError) as told:
        whole(robot(path))
    parts = said.split(" .* ")
    assert all(part in str(told.value) for part in parts)
    assert not re.search("[0-9a-f]{64}", str(told.value))


def test_names_that_coordlog_uses_are_no_ones_trouble():
    """A light, a camera, sensors and an actuator as ours are called."""
    env = BatchEnv(
        scene(
            world='<light name="sun"/><camera name="front"/>',
            more='<sensor><framepos name="palm_arm" objtype="body" objname="fore"/></sensor>',
            servo='<motor name="b" site="tip" gear="0 0 1 0 0 0"/>',
            servo_gains={"b": (200.0, 5.0)},
        ),
        n=1,
    )
    assert env.task.model.sensor("palm_arm").objid[0] == env.task.model.site("tip").id
    assert env.task.model.actuator("b_1").trnid[0] == env.task.model.joint("b").id


def test_unreadable_meshes_and_plugins_are_named():
    dae = text(asset='<asset><mesh name="m" file="m.dae"/></asset>', fore=MESH["fore"])
    assert "m.dae, a format MuJoCo does not read" in faulty(
        replace(scene(), robot=robot(dae, assets={"m.dae": b""}))
    )


def test_a_report_says_everything_and_why_draws_fail():
    report = examine(scene(), draws=3)
    assert report.faults == []
    said = dict(report.facts)
    assert "held to" in said["start pose"]
    assert "100% of 3 draws" in said["problems"]
    far = replace(scene(), robot=robot(), object_half=None)
    assert examine(far, draws=1).faults == []
    assert len(examine(scene(palm="nowhere"), draws=1).faults) == 1


def test_draws_go_on_while_some_are_feasible_and_say_why_others_are_not():
    two = """
    <mujoco><option timestep="0.004"/><compiler angle="radian"/><default><position kp="200"/>
      <joint damping="1" armature=".05"/></default><worldbody>
      <body name="l" pos="0 0.2 0.3"><joint name="la" axis="0 0 1" range="-1.5 1.5"/>
        <joint name="lb" axis="0 1 0" range="-1.5 1.5"/><geom size=".02" pos=".1 0 0"/><site name="lt" pos=".3 0 0"/></body>
      <body name="r" pos="0 -0.2 0.3"><joint name="ra" axis="0 0 1" range="-1.5 1.5"/>
        <joint name="rb" axis="0 1 0" range="-1.5 1.5"/><geom size=".02" pos=".1 0 0"/><site name="rt" pos=".3 0 0"/></body>
    </worldbody><actuator>{}</actuator></mujoco>""".format(
        "".join(f'<position joint="{j}" inheritrange="1"/>' for j in ("la", "lb", "ra", "rb"))
    )
    base = robot(two)
    twin = replace(
        base,
        arms=(Arm("left", "lt", ("la", "lb")), Arm("right", "rt", ("ra", "rb"))),
        poses={"stand": {}},
    )
    never = replace(
        scene(),
        robot=twin,
        object_half=(0.02,) * 3,
        object_box=((3.0, 4.0), (0.0, 1.0), (0.0, 1.0)),
        palm_offset=0.05,
    )
    env = BatchEnv(never, n=1, threads=1)
    with pytest.raises(
        SimulationError, match=r"no feasible problem in 200 draws .*out of reach \(200 of 200\)"
    ):
        env.problem(seed=0, split="train", index=0)


@pytest.mark.parametrize("name", ["", 'name="my table"'])
def test_a_geom_of_the_world_needs_no_name_and_may_have_blanks_in_it(name):
    world = f'<geom {name} type="box" size="0.1 0.1 0.02" pos="0 0 0.2"/>'
    pair = '<contact><pair geom1="my table" geom2="fore"/></contact>' if name else ""
    model = started(scene(world=world, more=pair)).task.model
    assert model.tuple_size.tolist() == [1]
    assert model.npair == bool(name)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"servo": '<position joint="b"/><position joint="b"/>'}, "'b' has 2 position servos"),
        ({"option": '<flag contact="disable"/>'}, "switches contacts off"),
        ({"option": '<flag sleep="enable"/>'}, "lets bodies sleep"),
        ({"free": '<joint name="z" type="slide" axis="0 0 1"/>'}, "joint 'z', which carries a"),
        ({"b": 'range="nan 1"'}, 'range="nan 1": expected numbers'),
        ({"held": {"grip": 1.0}}, "held names the actuator 'grip'"),
        ({"servo_gains": {"c": (1.0, 1.0)}}, "servo_gains names the joint 'c'"),
        ({"ranges": {"c": (0.0, 1.0)}}, "ranges names the joint 'c'"),
        ({"option": '<flag actuation="disable"/>'}, "switches actuators off"),
        ({"world": '<site name="a&#10;b"/>'}, "with a line break or another control character"),
    ],
)
def test_what_would_go_wrong_without_a_word_is_said(changes, said):
    assert said in faulty(scene(**changes))


def test_a_timestep_of_nothing_is_refused():
    with pytest.raises(ConfigError, match="timestep 0 s"):
        compose(replace(scene(), robot=robot(text().replace("0.004", "0"))), EnvConfig())


@pytest.mark.parametrize(
    "changes", [{"pose": (float("nan"), 0.0)}, {"pose": ("a", 0.0)}, {"servo_gains": {"b": (0, 1)}}]
)
def test_a_spec_has_numbers_that_mean_something(changes):
    with pytest.raises(ConfigError, match="expected"):
        robot(**changes)


def test_sensors_that_a_model_switches_off_are_read_nevertheless():
    env = started(scene(option='<flag sensor="disable"/>'))
    assert env.task.palms(env.physics.sensors).any()


def test_a_gripper_whose_control_is_a_speed_is_left_still():
    servo = '<position joint="b"/><intvelocity name="f" joint="f" kp="5" actrange="-1 1"/>'
    world = (
        '<body pos="0 1 0"><joint name="f" axis="0 0 1"/><geom type="sphere" size="0.01"/></body>'
    )
    env = started(scene(servo=servo, world=world))
    held = env.physics.qpos[0, [env.task.model.joint("f").qposadr[0]]]
    assert held == pytest.approx([0.0], abs=1e-6)


def test_a_name_with_a_slash_is_no_folder(tmp_path):
    import coordlog

    where = replace(scene(), name="mine/first")
    (file,) = coordlog.record(where, "still", episodes=1, out=tmp_path)
    assert file.parent == tmp_path
    assert file.name.startswith("mine_first-")
    assert coordlog.open(file)[0].header.episode["scene"] == "mine/first"


CARD = """
[robot]
name = "r"
model = "arm.xml"
centre = [0.2, 0, 0.5]
reach = 0.6
[[arms]]
name = "arm"
palm = "tip"
joints = ["a", "b"]
[poses.stand]
a = 0.4
"""


@pytest.mark.parametrize(
    ("here", "there", "said"),
    [
        ("reach = 0.6", "reach = 0", "expected reach above 0 m"),
        ("[0.2, 0, 0.5]", "[0.2, 0]", "robot.centre: expected another number of values"),
        ('joints = ["a", "b"]', "joints = []", "arm 'arm' has no joints"),
        ("[[arms]]", "[ranges]\nb = [1.0, 0.0]\n[[arms]]", "expected ranges\\['b'\\] as"),
        ("[poses", '[[arms]]\nname = "arm"\npalm = "tip"\njoints = []\n[poses', "different names"),
    ],
)
def test_a_card_that_cannot_be_meant_is_refused(here, there, said, tmp_path):
    from coordlog.tasks.own import scene_of

    (tmp_path / "arm.xml").write_text(text())
    card = tmp_path / "card.toml"
    card.write_text(CARD.replace(here, there), encoding="utf-8-sig")
    with pytest.raises(ConfigError, match=said):
        compose(scene_of(str(card)), EnvConfig())


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"panels": (Panel("p", (2, 0, 0), (1, 1, 1)),) * 2}, "panels of different names"),
        ({"spheres": 1, "sphere_box": ((1, 0), (0, 1), (0, 1))}, "sphere_box as .low, high."),
        ({"spheres": 1, "sphere_box": ((float("nan"), 0),) * 3}, "sphere_box as .low, high."),
    ],
)
def test_a_scene_that_cannot_be_meant_is_refused(changes, said):
    with pytest.raises(ConfigError, match=said):
        replace(scene(), **changes)
