"""Which geoms of a model can meet at all, by MuJoCo's own rules."""

from __future__ import annotations

import mujoco
import numpy as np

from coordlog.episode import Array
from coordlog.kinematics.levers import Levers

NEIGHBOURS = 2
"""Bodies of the robot this many links apart, or fewer, stand close by design: they must not touch,
but keep no clearance."""


def contact_pairs(model: mujoco.MjModel, levers: Levers, joints: set[int]) -> Array:
    """Pairs of geoms that MuJoCo lets collide and an action joint moves against one another, (P',
    2).
    """
    first, second = np.triu_indices(model.ngeom, k=1)
    masks = (model.geom_contype[first] & model.geom_conaffinity[second]) | (
        model.geom_contype[second] & model.geom_conaffinity[first]
    )
    weld = model.body_weldid[model.geom_bodyid]
    parent = model.body_weldid[model.body_parentid[weld]]
    a, b = weld[first], weld[second]
    kin = (a == b) | ((a > 0) & (b > 0) & ((a == parent[second]) | (b == parent[first])))
    bodies = np.sort(np.stack([model.geom_bodyid[first], model.geom_bodyid[second]]), axis=0)
    excluded = np.isin((bodies[0] << 16) + bodies[1], model.exclude_signature) | np.isin(
        (bodies[1] << 16) + bodies[0], model.exclude_signature
    )
    special = np.sort(np.stack([model.pair_geom1, model.pair_geom2]), axis=0)
    excluded |= np.isin(first * model.ngeom + second, special[0] * model.ngeom + special[1])
    driven = np.array(
        [
            [joint in levers.above(int(body)) for joint in sorted(joints)]
            for body in model.geom_bodyid
        ]
    )
    apart = (driven[first] != driven[second]).any(axis=1)
    keep = (masks > 0) & ~kin & ~excluded & apart
    return np.stack([first[keep], second[keep]], axis=1)


def neighbours(model: mujoco.MjModel, pairs: Array) -> Array:
    """Which pairs belong to bodies of one robot that are few links apart, (P',) bool."""
    up = [model.geom_bodyid[pairs]]  # (P', 2) each: the bodies, their parents, …; 0 is the world
    for _ in range(NEIGHBOURS):
        up.append(model.body_parentid[up[-1]])
    near = np.zeros(len(pairs), dtype=bool)
    for i, one in enumerate(up):
        for other in up[
            : len(up) - i
        ]:  # i links down on one side, no more than the rest on the other
            near |= (one[:, 0] == other[:, 1]) & (one[:, 0] > 0)
    return near
