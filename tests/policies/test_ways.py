"""Goals are searched from postures that find them, and ways go round the robot itself by one and
the same posture, so that an expert acts alike in like problems.
"""

from itertools import pairwise

import numpy as np

from coordlog.policies.expert import Expert
from coordlog.policies.ways import found_ways, postures
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


POST = """
    <body name="post" pos="0.15 0.25 0.6"><geom type="box" size="0.15 0.05 0.3"/></body>"""
"""Of the robot, in the straight way of many an arm."""
FINGER = """
        <body name="finger" pos="0 0 -0.3">
          <joint name="grip" axis="1 0 0" range="0 1"/>
          <geom name="finger" fromto="0 0 -0.02 0 0 -0.08" size="0.01"/>
        </body>"""


def beside_a_post() -> BatchEnv:
    mjcf = HANGING.replace("<worldbody>", f"<worldbody>{POST}")
    mjcf = mjcf.replace('<site name="palm"', f'{FINGER}<site name="palm"')
    arm = Arm("arm", palm="palm", joints=JOINTS)
    poses = {"stand": {"spread": -0.1, "elbow": 0.3}}
    robot = Robot("hanging", mjcf, (arm,), poses=poses, centre=(0.0, 0.0, 1.0), reach=0.6)
    return BatchEnv(Scene("post", "Anywhere", robot), n=1, threads=1)


def clear(reach, way, *, own):
    return all(reach.free(a, b, clearance=0.0, own=own) for a, b in pairwise(way))


def test_where_straight_ways_touch_the_robot_one_posture_leads_around_for_all_goals():
    env = beside_a_post()
    reach, own = env.draw.reach, 0.015
    expert = Expert(env.task, reach, 1)
    ((via,),) = expert._ways
    rng = np.random.default_rng(7)  # goals that nothing was chosen by
    ends = [expert._ends(anywhere(rng, reach), rng, None)[0] for _ in range(100)]
    start = reach.standing_angles
    straight, around = (
        np.mean([clear(reach, [start, *by, end], own=own) for end in ends]) for by in ([], [via])
    )
    assert straight < 0.5
    assert around > 0.95


def test_a_robot_whose_straight_ways_are_free_goes_straight():
    env = hanging()
    assert found_ways(env.task, env.draw.reach, [], own=0.015) == [[]]


def test_a_finger_keeps_its_distance_from_the_robot_but_not_from_the_hand_it_is_on():
    reach = beside_a_post().draw.reach
    spread = np.linspace(-3.3, 0.1, 800)
    touching, near = (
        [reach.touches(np.array([0.0, a, 0.0, 0.0]), own=own) for a in spread]
        for own in (0.0, 0.02)
    )
    assert 0 < sum(touching) < sum(near) < len(spread)
    assert all(close for close, touch in zip(near, touching, strict=True) if touch)
    finger = reach._model.geom("finger").id
    assert reach._tip_geoms >= {finger}
