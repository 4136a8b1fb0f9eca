"""Levers are remembered for a kinematic tree, and for that tree alone."""

from __future__ import annotations

from copy import copy

import numpy as np

from coordlog.sim.config import EnvConfig
from coordlog.sim.levers import Levers
from coordlog.sim.physics import compile_model
from coordlog.sim.scene import compose, find


def test_models_of_one_tree_share_what_was_found_and_another_tree_does_not() -> None:
    model = compile_model(compose(find("spheres"), EnvConfig()))
    joint, body = model.joint("l_elbow_y").id, int(model.geom_bodyid[model.geom("l_forearm_1").id])
    point = np.array([0.0, 0.02, -0.1])
    found = Levers(model).lever(joint, body, point, 0.01)
    assert found == Levers(model)._lever(joint, body, point, 0.01), "remembered as computed"
    other = copy(model)
    other.geom_size[:] *= 2.0  # another episode's spheres
    assert Levers(other)._known is Levers(model)._known
    longer = copy(model)
    longer.body_pos[body] *= 1.5
    longer.jnt_pos[joint] += 0.01
    assert Levers(longer)._known is not Levers(model)._known
    assert Levers(longer).lever(joint, body, point, 0.01) == Levers(longer)._lever(joint, body, point, 0.01) != found
