"""Bounds that depend on the model alone: found once for all models alike, and never mistaken for
another's."""

from __future__ import annotations

from copy import copy

import mujoco
import numpy as np
import pytest

from coordlog.kinematics.motion_bounds import _bounds, bounds
from coordlog.sim.env import BatchEnv
from coordlog.tasks.scene import find, sole_corner


@pytest.fixture(scope="module")
def env() -> BatchEnv:
    return BatchEnv(find("spheres"), n=1, threads=1)


def parts(env: BatchEnv) -> tuple[mujoco.MjModel, list[int], list[int]]:
    model = copy(env.task.model)
    joints = [model.joint(name).id for name in env.task.robot.action_joints]
    return (
        model,
        joints,
        [model.site(sole_corner(sole, i)).id for sole in env.task.robot.soles for i in range(4)],
    )


def test_spheres_of_another_size_change_nothing(env: BatchEnv) -> None:
    model, joints, corners = parts(env)
    first = bounds(model, joints, corners)
    other = copy(model)
    other.geom_size[env.task.sphere_geoms, 0] = other.geom_rbound[env.task.sphere_geoms] = 0.2
    assert bounds(other, joints, corners) is first
    _bounds.cache_clear()
    again = bounds(other, joints, corners)
    for one, two in zip(first, again, strict=True):
        np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("part", ["body_pos", "geom_pos", "geom_rbound", "jnt_axis", "body_mass"])
def test_another_robot_has_its_own(env: BatchEnv, part: str) -> None:
    model, joints, corners = parts(env)
    first = bounds(model, joints, corners)
    other = copy(model)
    forearm = model.geom("l_forearm_0").id
    body = model.geom_bodyid[forearm]
    row = {"geom_pos": forearm, "geom_rbound": forearm, "jnt_axis": model.body_jntadr[body]}.get(
        part, body
    )
    getattr(other, part)[row] += 0.3
    found = bounds(other, joints, corners)
    assert found is not first
    assert not all(np.array_equal(one, two) for one, two in zip(first, found, strict=True))


def test_what_is_shared_cannot_be_changed(env: BatchEnv) -> None:
    found = bounds(*parts(env))
    with pytest.raises(ValueError, match="read-only"):
        found.change[0, 0] = 1.0
