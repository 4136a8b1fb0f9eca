"""Which geoms of a model can meet at all, by MuJoCo's own rules, and which are of what."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from coordlog.episode import Array
from coordlog.kinematics.levers import Levers
from coordlog.tasks.scene import ROBOT_IN_WORLD

NEIGHBOURS = 2
"""Bodies of the robot this many links apart, or fewer, stand close by design: they must not touch,
but keep no clearance."""

# as numbers: NumPy looks enumerations up one by one
_EXACT = [
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{kind}")) for kind in ("PLANE", "SPHERE", "CAPSULE", "BOX")
]
_GROUND = [int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD)]


def contact_pairs(
    model: mujoco.MjModel,
    levers: Levers,
    joints: set[int],
    soles: Sequence[int] = (),
    resting: Sequence[tuple[int, int]] = (),
) -> Array:
    """Pairs of geoms that MuJoCo lets collide and a joint among `joints` moves apart, (P', 2).

    A pair that the model lists for itself counts whatever its masks are. Soles may stand on the
    ground: on planes and height fields of the world; `resting` pairs lie against one another by
    design.
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
    listed = np.isin(first * model.ngeom + second, special[0] * model.ngeom + special[1])
    ground = np.isin(model.geom_type, _GROUND) & (model.geom_bodyid == 0)
    foot = np.isin(np.arange(model.ngeom), list(soles))
    stands = (foot[first] & ground[second]) | (ground[first] & foot[second])
    rests = np.isin(
        first * model.ngeom + second,
        [min(pair) * model.ngeom + max(pair) for pair in resting],
    )
    driven = np.array(
        [
            [joint in levers.above(int(body)) for joint in sorted(joints)]
            for body in model.geom_bodyid
        ]
    )
    apart = (driven[first] != driven[second]).any(axis=1)
    keep = (((masks > 0) & ~kin & ~excluded) | listed) & apart & ~(stands | rests)
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


def overestimate(model: mujoco.MjModel, pairs: Array) -> Array:
    """By how much the engine may overestimate the distance of each pair, (P',) [m].

    Between spheres, capsules and boxes it has closed forms; other shapes, meshes among them, it
    approaches by iteration, to within its own tolerance.
    """
    iterated = ~np.isin(model.geom_type[pairs], _EXACT).all(axis=1)
    return np.asarray(iterated * (2.0 * model.opt.ccd_tolerance))


def distance_bounds(
    model: mujoco.MjModel, data: mujoco.MjData, pairs: Array, centre: Array
) -> Array:
    """Lower bounds on the distances of pairs at n configurations, (n, P') [m].

    Sphere to sphere, and spheres to planes and boxes of the world as they are.

    Args:
        model: Bounding spheres.
        data: Where the geoms of the world stand.
        pairs: Geom ids, (P', 2).
        centre: Middles of all geoms, (n, n_geom, 3).
    """
    first, second = pairs.T
    bound = (
        np.linalg.norm(centre[:, first] - centre[:, second], axis=2)
        - model.geom_rbound[first]
        - model.geom_rbound[second]
    )
    for geom in np.unique(pairs[model.geom_bodyid[pairs] == 0]):
        columns = np.flatnonzero((first == geom) | (second == geom))
        other = np.where(first[columns] == geom, second[columns], first[columns])
        away = (centre[:, other] - data.geom_xpos[geom]) @ data.geom_xmat[geom].reshape(3, 3)
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
            bound[:, columns] = away[..., 2] - model.geom_rbound[other]
        elif model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
            outside = np.maximum(np.abs(away) - model.geom_size[geom], 0.0)
            bound[:, columns] = np.linalg.norm(outside, axis=2) - model.geom_rbound[other]
    return np.asarray(bound)


def below(model: mujoco.MjModel, bodies: Sequence[int]) -> list[int]:
    """Bodies that others carry, as ids."""
    found = list[int]()
    for body in range(1, model.nbody):  # after what carries it
        if int(model.body_parentid[body]) in {*bodies, *found}:
            found.append(body)
    return found


def obstacles(model: mujoco.MjModel) -> Array:
    """Ids of the solid geoms of the world that are not the floor and not the robot's own: panels
    and spheres.
    """
    bodies = model.geom_bodyid
    still = (bodies == 0) | (model.body_mocapid[bodies] >= 0)
    still[own_in_world(model)] = False
    return np.flatnonzero(
        still & (model.geom_contype > 0) & (model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE)
    )


def own_in_world(model: mujoco.MjModel) -> Array:
    """Ids of the geoms of the world that are the robot's own."""
    own = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TUPLE, ROBOT_IN_WORLD)
    if own < 0:
        return np.zeros(0, dtype=int)
    first = int(model.tuple_adr[own])
    return np.asarray(model.tuple_objid[first : first + int(model.tuple_size[own])])
