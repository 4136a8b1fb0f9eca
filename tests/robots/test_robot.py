"""A robot spec that cannot work is refused with a sentence, and one that can survives the way into
a log and back."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

from coordlog.errors import ConfigError
from coordlog.mjcf import compile_model, compose
from coordlog.robots.card import as_card, robot_of
from coordlog.robots.humanoid import HUMANOID
from coordlog.robots.planar import PLANAR
from coordlog.robots.robot import Arm, Robot
from coordlog.sim.env import BatchEnv
from coordlog.sim.task import BoundTask
from coordlog.tasks.config import EnvConfig, RewardConfig
from coordlog.tasks.registry import make_task
from coordlog.tasks.scene import Scene, find


def build(robot):
    scene = replace(find("free"), robot=robot)
    config, reward = EnvConfig(), RewardConfig()
    rules = make_task("reach", config, reward)
    return BoundTask(rules, robot, compile_model(compose(scene, config)), config, reward)


def test_no_arm_is_refused():
    with pytest.raises(ConfigError, match="'humanoid': expected at least one arm, got none"):
        replace(HUMANOID, arms=())


def test_a_joint_used_twice_is_refused():
    greedy = replace(HUMANOID.arms[1], joints=("l_elbow_y", *HUMANOID.arms[1].joints))
    with pytest.raises(ConfigError, match="belongs to one arm or is shared by all"):
        replace(HUMANOID, arms=(HUMANOID.arms[0], greedy))
    with pytest.raises(ConfigError, match="got twice"):
        replace(HUMANOID, shared=(*HUMANOID.shared, "l_elbow_y"))


def test_soles_without_a_torso_are_refused():
    with pytest.raises(ConfigError, match="needs the name of its torso"):
        replace(HUMANOID, torso="")


def test_no_stand_pose_is_refused():
    with pytest.raises(ConfigError, match=r"start pose called 'stand', got \['home'\]"):
        replace(HUMANOID, poses={"home": {}})


def test_an_unknown_joint_is_named():
    robot = replace(HUMANOID, shared=("waist", *HUMANOID.shared))
    with pytest.raises(
        ConfigError, match=r"'humanoid': its spec names a joint 'waist', but its model has abs_x"
    ):
        build(robot)


def test_a_joint_without_a_servo_is_named():
    robot = replace(
        HUMANOID,
        mjcf=HUMANOID.mjcf.replace(
            '<position name="abs_z" joint="abs_z"', '<position name="other" joint="l_knee_y"'
        ),
    )
    with pytest.raises(
        ConfigError, match="joint 'abs_z' has no position servo, it has no actuator"
    ):
        build(robot)


def test_a_missing_sole_is_named():
    with pytest.raises(ConfigError, match="expected a geom called 'toe' as a sole, found none"):
        build(replace(HUMANOID, soles=("l_foot_sole", "toe")))


def test_a_missing_palm_is_named():
    arms = (replace(HUMANOID.arms[0], palm="third_palm"), HUMANOID.arms[1])
    with pytest.raises(
        ConfigError, match="arm 'left': expected a site or a body called 'third_palm' as its palm"
    ):
        build(replace(HUMANOID, arms=arms))


def test_a_robot_without_bodies_is_refused():
    empty = Robot(
        "ghost", "<mujoco><worldbody/></mujoco>", (Arm("a", "p", ("j",)),), poses={"stand": {}}
    )
    with pytest.raises(
        ConfigError, match=r"robot 'ghost': .*expected a body in its model, found none"
    ):
        compose(Scene("s", "", empty), EnvConfig())


@pytest.mark.parametrize("robot", [HUMANOID, PLANAR], ids=lambda robot: robot.name)
def test_a_spec_survives_json(robot):
    again = Robot.from_json(json.loads(json.dumps(robot.to_json())), mjcf=robot.mjcf)
    assert again == replace(
        robot, poses={pose: dict(joints) for pose, joints in robot.poses.items()}
    )
    assert again.served == robot.served


def test_shared_joints_come_first_and_serve_every_arm():
    assert HUMANOID.action_joints[:5] == ("abs_y", "abs_x", "abs_z", "bust_y", "bust_x")
    assert len(HUMANOID.action_joints) == 13
    assert HUMANOID.served == {
        "left": [0, 1, 2, 3, 4, 5, 6, 7, 8],
        "right": [0, 1, 2, 3, 4, 9, 10, 11, 12],
    }


def start(**changes):
    """The planar arm with some of its spec changed, put into its start pose."""
    return BatchEnv(replace(find("planar"), robot=replace(PLANAR, **changes)))


def test_a_model_that_is_no_xml_is_refused():
    with pytest.raises(
        ConfigError, match="robot 'planar': expected its model as MJCF or URDF that MuJoCo takes"
    ):
        start(mjcf="<mujoco>")


def test_a_pose_of_an_unknown_joint_is_named():
    with pytest.raises(
        ConfigError,
        match="robot 'planar': its pose 'stand' names a joint 'knee' that its model lacks",
    ):
        start(poses={"stand": {"knee": 1.0}})


def test_a_pose_outside_a_range_is_named():
    with pytest.raises(
        ConfigError,
        match="robot 'planar': its pose 'stand' has left_1 at 3 rad, outside its range -2 to 2",
    ):
        start(poses={"stand": {"left_1": 3.0}})


def test_a_name_of_any_letters_comes_back_from_a_card():
    named = replace(PLANAR, name='a "b"\\ \x7f\t手')
    again = robot_of(tomllib.loads(as_card(named, "m.xml")), Path())
    assert again.name == named.name
