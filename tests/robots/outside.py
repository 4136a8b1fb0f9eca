"""A two-link arm as others write theirs, with one thing changed at a time."""

from coordlog.robots.robot import Arm, Robot
from coordlog.tasks.scene import Scene

ARM = """
<mujoco>
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.004" integrator="implicitfast">{option}</option>
  <default>
    <joint damping="1" armature="0.05"/>
    <geom type="capsule" size="0.03" mass="0.3" {geom}/>
    <position kp="{kp}"/>
  </default>
  {asset}
  <worldbody>{world}
    <body name="stand" pos="0 0 0.3">{free}<geom {base} type="box" size="0.05 0.05 0.05"/>
      <body name="upper" pos="0 0 0.1">
        <joint name="a" axis="0 1 0" range="-1.5 1.5"/><geom {upper} fromto="0 0 0.05 0 0 0.22"/>
        <body name="fore" pos="0 0 0.3">
          <joint name="b" axis="0 1 0" {b}/><geom {fore}/>
          <site name="tip" pos="0 0 0.28"/>
        </body>
      </body>
    </body>
  </worldbody>
  {more}
  <actuator>
    <position name="a" joint="a" inheritrange="1"/>{servo}
  </actuator>
</mujoco>
"""
PLAIN = {
    "option": "",
    "geom": "",
    "kp": "200",
    "asset": "",
    "world": "",
    "free": "",
    "base": 'name="base"',
    "upper": 'name="upper"',
    "b": 'range="-2.4 2.4"',
    "fore": 'name="fore" fromto="0 0 0 0 0 0.2"',
    "more": "",
    "servo": '<position name="b" joint="b" inheritrange="1"/>',
}


def text(**changes):
    return ARM.format(**PLAIN | changes)


def robot(mjcf=None, *, pose=(0.4, 0.8), palm="tip", **changes):
    spec = {name: changes.pop(name) for name in list(changes) if name not in PLAIN}
    return Robot(
        "thing",
        mjcf or text(**changes),
        (Arm("arm", palm, ("a", "b")),),
        poses={"stand": {"a": pose[0], "b": pose[1]}},
        centre=(0.2, 0.0, 0.5),
        reach=0.6,
        **spec,
    )


def scene(*args, **changes):
    return Scene("thing", "an arm of somebody else's", robot(*args, **changes))
