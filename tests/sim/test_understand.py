"""A spec read off a model: arms without heads, robots that stand without a keyframe, gains that do
not diverge, and what no flag of an episode would say."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from coordlog.errors import ConfigError
from coordlog.mjcf import compile_model, compose
from coordlog.sim.doubts import doubts
from coordlog.sim.settling import faults, settle
from coordlog.sim.understand import understand
from coordlog.tasks.config import EnvConfig
from coordlog.tasks.scene import Scene
from tests.robots.outside import robot, scene, text

TENDON = (
    '<tendon><fixed name="t" {}><joint joint="a" coef="1"/><joint joint="b" coef="-1"/></fixed>'
    "</tendon>"
)
ROPE = (
    '<tendon><spatial name="rope" limited="true" range="0 .5"><site site="root"/>'
    '<site site="tip"/></spatial></tendon>'
)
LEG = """
<body name="{s}_thigh" pos="-0.2 {y} 0"><joint name="{s}_hip" axis="0 1 0" range="-1 1"/>
  <geom type="capsule" size=".04" fromto="0 0 0 0 0 -.3" mass="1"/>
  <body name="{s}_foot" pos="0 0 -.4"><joint name="{s}_ankle" axis="0 1 0" range="-1 1"/>
    <geom name="{s}_sole" type="box" size=".1 .04 .02" pos=".07 0 -.05" mass=".5"/></body></body>"""
ARM = """
<body name="{s}_upper" pos="0 {y} .4"><joint name="{s}_a" axis="0 1 0" range="-2 2"/>
  <joint name="{s}_b" axis="1 0 0" range="-1 1"/><geom type="capsule" size=".03" fromto="0 0 0 0 0 -.2" mass=".3"/>
  <body name="{s}_hand" pos="0 0 -.25"><joint name="{s}_c" axis="0 1 0" range="-2 0"/>
    <geom type="capsule" size=".02" fromto="0 0 0 .2 0 0" mass=".2"/><site name="{s}_palm" pos=".22 0 0"/></body></body>"""
WALKER = f"""
<mujoco><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/>
<default><joint damping=".2" armature=".01"/></default>
<worldbody><geom name="floor" type="plane" size="3 3 .1"/>
<body name="hull" pos="0 0 .6"><freejoint/><geom type="box" size=".05 .1 .2" pos="0 0 .2" mass="5"/>
  <body name="neck" pos="0 0 .45"><joint name="n1" axis="0 0 1" range="-1 1"/><geom size=".03" mass=".2"/>
    <body name="head"><joint name="n2" axis="0 1 0" range="-1 1"/><joint name="n3" axis="1 0 0" range="-1 1"/>
      <geom size=".08" pos="0 0 .1" mass=".5"/></body></body>
  {LEG.format(s="l", y=0.1)}{LEG.format(s="r", y=-0.1)}{ARM.format(s="l", y=0.2)}{ARM.format(s="r", y=-0.2)}
</body></worldbody>
<actuator>{"".join(f'<motor joint="{j}" ctrlrange="-60 60"/>' for s in "lr" for j in (f"{s}_hip", f"{s}_ankle", f"{s}_a", f"{s}_b", f"{s}_c"))}</actuator></mujoco>
"""


@pytest.fixture(scope="module")
def walker(tmp_path_factory):
    file = tmp_path_factory.mktemp("walker") / "walker.xml"
    file.write_text(WALKER)
    return understand(file)


def test_a_head_is_no_hand_and_legs_are_no_arms(walker):
    assert [arm.palm for arm in walker.robot.arms] == ["l_palm", "r_palm"]
    assert walker.robot.arms[0].joints == ("l_a", "l_b", "l_c")
    assert walker.robot.soles == ("l_sole", "r_sole")


def test_a_robot_on_feet_stands_without_a_keyframe_and_on_a_floor_of_the_scenes(walker):
    pose = walker.robot.poses["stand"]
    assert pose["l_hip"] != 0.0
    where = Scene("walker", "a walker", walker.robot)
    model = compile_model(compose(where, EnvConfig()))
    rest = settle(walker.robot, model, "stand")
    assert faults(walker.robot, model, "stand", rest) == []
    upright = replace(walker.robot, poses={"stand": dict.fromkeys(pose, 0.0)})
    fallen = settle(upright, model, "stand")
    assert "is not held" in faults(upright, model, "stand", fallen)[0]


def test_guessed_gains_stay_below_what_a_step_can_follow(walker):
    model = compile_model(compose(Scene("walker", "a walker", walker.robot), EnvConfig()))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    for name, (kp, _) in walker.robot.servo_gains.items():
        dof = model.joint(name).dofadr[0]
        assert np.sqrt(kp / inertia[dof, dof]) * model.opt.timestep < 1.0


def test_palms_that_are_not_there_are_named_with_what_is(tmp_path):
    (tmp_path / "arm.xml").write_text(text())
    with pytest.raises(
        ConfigError, match="called 'hand' as a palm, found none; it has the sites tip"
    ):
        understand(tmp_path / "arm.xml", ["hand"])
    found = understand(tmp_path / "arm.xml", ["fore"], name="mine")
    assert found.robot.name == "mine"
    assert found.robot.arms[0].joints == ("a", "b")


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ('type="slide" limited="false" damping="1e9"', "x is a slide without a range"),
        ('type="slide" range="0 .4" damping="1e7"', "x is held by its damping"),
        ('type="hinge" range="0 .4" damping="1e7"', "x is held by its damping"),
    ],
)
def test_a_joint_that_stands_still_and_has_no_servo_is_left_out(kind, said, tmp_path):
    (tmp_path / "arm.xml").write_text(text(free=f'<joint name="x" axis="1 0 0" {kind}/>'))
    found = understand(tmp_path / "arm.xml", ["tip"])
    assert found.robot.arms[0].joints == ("a", "b")
    assert any(said in note for note in found.notes)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"geom": 'contype="0" conaffinity="0"'}, "no collision can be seen"),
        (
            {
                "free": '<joint name="hang" axis="0 1 0" pos="0 0 1" damping="5"/>',
                "pose": (0.0, 0.0),
            },
            "joint 'hang' carries a palm and nothing drives it",
        ),
        (
            {
                "world": '<body name="puppeteer" mocap="true" pos="0 0 9"/>',
                "more": '<equality><weld body1="puppeteer" body2="fore"/></equality>',
            },
            "what ties 'puppeteer' and 'fore' is off",
        ),
    ],
)
def test_what_flags_cannot_say_is_said(changes, said):
    where = scene(**changes)
    model = compile_model(compose(where, EnvConfig()))
    assert said in " ".join(doubts(where.robot, model))
    assert doubts(robot(), compile_model(compose(scene(), EnvConfig()))) == []


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"servo": '<position joint="b" kp="200" ctrlrange="-.1 .1"/>'},
            "the servo of joint 'b' takes -0.1 to 0.1",
        ),
        (
            {"more": '<equality><joint joint1="b" joint2="a"/></equality>'},
            "an equality of the model keeps 'a', 'b' from moving freely",
        ),
        (
            {"more": '<equality><connect body1="fore" anchor="0 0 .2"/></equality>'},
            "an equality of the model keeps 'a', 'b' from moving freely",
        ),
        (
            {
                "more": '<tendon><fixed name="t"><joint joint="b" coef="1"/></fixed></tendon>',
                "servo": '<position joint="b" kp="200"/><position name="t" tendon="t" kp="9"/>',
            },
            "actuator 't' is no joint's servo, is held, and holds 'b' with it",
        ),
        (
            {"more": TENDON.format('limited="true" range="-1 .1"')},
            "tendon 't' is limited to -1 to 0.1, and keeps 'a', 'b' from moving freely",
        ),
        (
            {"more": TENDON.format('stiffness="20"')},
            "tendon 't' is a spring, and keeps 'a', 'b' from moving freely",
        ),
        (
            {
                "more": TENDON.format("") + '<equality><tendon tendon1="t"/></equality>',
            },
            "tendon 't' is tied by an equality, and keeps 'a', 'b' from moving freely",
        ),
        (
            {"more": ROPE, "world": '<site name="root"/>'},
            "tendon 'rope' is limited to 0 to 0.5, and keeps 'a', 'b' from moving freely",
        ),
    ],
)
def test_what_hinders_a_joint_of_the_action_is_said(changes, said):
    spec = robot(**changes)
    model = compile_model(compose(Scene("thing", "", spec), EnvConfig()))
    assert [said in each for each in doubts(spec, model)] == [True]
    free = compile_model(compose(Scene("thing", "", robot()), EnvConfig()))
    assert doubts(robot(), free) == []


def test_a_tendon_that_no_joint_can_stretch_to_its_limit_is_no_hindrance():
    spec = robot(more=TENDON.format('limited="true" range="-99 99"'))
    assert doubts(spec, compile_model(compose(Scene("thing", "", spec), EnvConfig()))) == []


def test_a_joint_that_follows_another_and_has_no_servo_is_no_arms(tmp_path):
    (tmp_path / "m.xml").write_text(
        text(servo="", more='<equality><joint joint1="b" joint2="a"/></equality>')
    )
    found = understand(tmp_path / "m.xml")
    assert found.robot.arms[0].joints == ("a",)
    assert "b follows a by an equality and has no servo: left out of the action" in found.notes


def test_a_small_arm_is_an_arm_and_joints_without_names_get_one(tmp_path):
    (tmp_path / "m.xml").write_text(text(servo="").replace('name="b"', ""))
    found = understand(tmp_path / "m.xml")
    assert found.robot.arms[0].palm == "tip"
    assert found.robot.arms[0].joints == ("a", "joint 0 of fore")
    assert set(found.robot.servo_gains) == {"joint 0 of fore"}


def test_a_muscle_becomes_a_servo_without_its_limits():
    muscle = '<muscle joint="b" ctrlrange="0 1"/>'
    where = scene(servo=muscle, servo_gains={"b": (200.0, 5.0)})
    model = compile_model(compose(where, EnvConfig()))
    assert not model.actuator_forcelimited[1]
    assert model.actuator_gainprm[1, :3].tolist() == [200.0, 0.0, 0.0]


def test_joints_that_an_equality_ties_are_named_where_a_pose_is_not_held():
    tie = '<equality><joint joint1="b" joint2="a"/></equality>'
    where = scene(more=tie)
    model = compile_model(compose(where, EnvConfig()))
    said = faults(where.robot, model, "stand", settle(where.robot, model, "stand"))
    assert "an equality ties it to 'a'" in " ".join(said)
