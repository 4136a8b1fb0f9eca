"""An episode of somebody else's simulation in the viewer: all that is known of it."""

import mujoco
import numpy as np
from numpy.testing import assert_allclose

from coordlog.record.foreign import recording
from coordlog.view.files import draw_files
from tests.view.recordings import Recording

PENDULUM = """<mujoco><worldbody>
  <geom name="wall" type="box" size=".1 .1 .1" pos="0 .5 1"/>
  <body pos="0 0 1"><joint name="swing" axis="0 1 0"/>
    <geom type="capsule" size=".03" fromto="0 0 0 0 0 -.5"/></body>
</worldbody><actuator><motor name="push" joint="swing"/></actuator></mujoco>"""


def test_scene_joints_actions_and_rewards_are_shown(tmp_path):
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    data = mujoco.MjData(model)
    rewards = [[float(i), -1.0] for i in range(6)]
    with recording(model, data, tmp_path, source=PENDULUM) as log:
        for i, reward in enumerate(rewards):
            data.ctrl[:] = 0.1 * i
            mujoco.mj_step(model, data, 5)
            log.step(data.ctrl, reward=reward, truncated=i == 5)
    drawn = draw_files(list(tmp_path.glob("*.mcap")))
    assert not drawn.partial
    shown = Recording(drawn.stream, tmp_path / "a.rrd")
    assert_allclose(np.ravel(shown.column("/action", "Scalars:scalars")), 0.1 * np.arange(6))
    assert_allclose(np.ravel(shown.column("/reward", "Scalars:scalars")), np.ravel(rewards))
    assert len(shown.column("/joint", "Scalars:scalars")) == 7
    assert len(shown.column("/world/world/box", "Boxes3D:centers")) == 1
