"""Which joints a log's /joint_states names."""

import mujoco
import pytest

from coordlog.mjcf import compose
from coordlog.sim.env import hinges
from coordlog.tasks.config import EnvConfig
from coordlog.tasks.scene import SCENES


@pytest.mark.parametrize("name", SCENES)
def test_every_joint_with_one_angle_is_named_with_its_place_in_qpos_and_qvel(name):
    model = mujoco.MjModel.from_xml_string(compose(SCENES[name], EnvConfig()).text)
    found = hinges(model)
    assert len(found) == model.nu  # one servo per joint on every robot that ships
    for joint in found:
        assert model.joint(joint["name"]).qposadr == joint["qpos"]
        assert model.joint(joint["name"]).dofadr == joint["qvel"]
