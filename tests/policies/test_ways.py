"""Goals are searched from postures that find them, so that an expert ends alike in like problems."""

import numpy as np

from coordlog.policies.expert import Expert
from coordlog.policies.ways import postures
from coordlog.robots.robot import Arm, Robot
from coordlog.sim.env import BatchEnv
from coordlog.tasks.goals import anywhere
from coordlog.tasks.scene import SCENES, Scene

JOINTS = ("swing", "spread", "twist", "elbow")
HANGING = """
<mujoco model="hanging">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.004" integrator="implicitfast"/>
  <default>
    <joint damping="0.5" armature="0.02"/>
    <geom type="capsule" size="0.02" mass="0.15"/>
    <position kp="60" inheritrange="1"/>
  </default>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="swing" axis="0 -1 0" range="-3.49 1.4"/>
      <joint name="spread" axis="-1 0 0" range="-3.32 0.17"/>
      <joint name="twist" axis="0 0 1" range="-1.57 1.57"/>
      <geom fromto="0 0 0 0 0 -0.25"/>
      <body name="lower" pos="0 0 -0.3">
        <joint name="elbow" axis="1 0 0" range="0 2.44"/>
        <geom fromto="0 0 -0.03 0 0 -0.25"/>
        <site name="palm" pos="0 0 -0.3"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="swing"/><position joint="spread"/>
    <position joint="twist"/><position joint="elbow"/>
  </actuator>
</mujoco>"""
"""An arm that hangs beside nothing, its start pose at the inner limit of its second joint."""


def hanging() -> BatchEnv:
    arm = Arm("arm", palm="palm", joints=JOINTS)
    poses = {"stand": {"spread": 0.15, "elbow": 0.24}}
    robot = Robot("hanging", HANGING, (arm,), poses=poses, centre=(0.0, 0.0, 1.0), reach=0.6)
    return BatchEnv(Scene("hang", "Anywhere", robot), n=1, threads=1)


def share(reach, goals, seed):
    return np.mean([reach.solve(goal, seed=seed) is not None for goal in goals])


def test_where_the_start_pose_finds_too_few_goals_another_posture_finds_nearly_all():
    reach = hanging().draw.reach
    rng = np.random.default_rng(7)  # goals that nothing was chosen by
    goals = [anywhere(rng, reach) for _ in range(100)]
    assert share(reach, goals, reach.standing_angles) < 0.9
    found = postures(reach)
    assert len(found) == 1
    assert share(reach, goals, found[0]) > 0.95


def test_an_expert_ends_in_postures_of_its_goals_not_of_chance():
    env = hanging()
    expert = Expert(env.task, env.draw.reach, 1)
    rng = np.random.default_rng(7)
    goals = [anywhere(rng, env.draw.reach) for _ in range(30)]
    ends = [
        [expert._ends(goal, np.random.default_rng(chance), None)[0] for goal in goals]
        for chance in range(2)
    ]
    assert np.array_equal(*ends)


def test_a_robot_whose_poses_find_its_goals_is_left_alone():
    assert postures(BatchEnv(SCENES["planar"], n=1, threads=1).draw.reach) == []
