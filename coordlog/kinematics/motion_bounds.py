"""Per-model data of a checker: collision pairs, and bounds on how joints change their distance."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import mujoco
import numpy as np

from coordlog.episode import Array
from coordlog.kinematics.levers import FREE, Levers, moved, strokes
from coordlog.kinematics.pairs import contact_pairs, neighbours

MODELS = 16
"""Models whose bounds are remembered: a folder of logs has few, and they take longer to find than a
path to be looked at."""


class Bounds(NamedTuple):
    """Pairs of geoms, and balance as one more pair after them if the robot stands on soles."""

    pairs: Array
    """Geom ids of the pairs that are looked at, (P', 2)."""
    keep: Array
    """Which of them keep a clearance, (P',) bool."""
    place: Array
    """Place of a pair of geoms among them, or -1, (n_geom, n_geom)."""
    mass: Array
    """Share of the robot's mass in each body, (n_body,)."""
    change: Array
    """Metres by which each pair's slack changes, at most, (P, n_jnt + n_free): per radian or metre
    of each joint, and per metre of each free body."""


class _Kinematics:
    """A model as a key: equal to every other with the same links, joints and shapes.

    What no joint moves may have another size.
    """

    _PARTS = (
        *(
            "body_parentid",
            "body_weldid",
            "body_rootid",
            "body_pos",
            "body_ipos",
            "body_mass",
            "jnt_type",
            "jnt_bodyid",
            "jnt_pos",
        ),
        *(
            "jnt_axis",
            "qpos0",
            "geom_bodyid",
            "geom_pos",
            "geom_contype",
            "geom_conaffinity",
            "exclude_signature",
            "pair_geom1",
            "pair_geom2",
        ),
        *("site_bodyid", "site_pos"),
    )

    def __init__(self, model: mujoco.MjModel, ways: Array) -> None:
        self.model, self.ways = model, ways
        moves = (model.body_weldid[model.geom_bodyid] > 0) & (
            model.body_mocapid[model.geom_bodyid] < 0
        )
        parts = [np.asarray(getattr(model, name)) for name in self._PARTS]
        self._bytes = (
            b"".join(part.tobytes() for part in parts)
            + (model.geom_rbound * moves).tobytes()
            + ways.tobytes()
        )

    def __hash__(self) -> int:
        return hash(self._bytes)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Kinematics) and self._bytes == other._bytes


def bounds(
    model: mujoco.MjModel,
    joints: list[int],
    corners: list[int],
    *,
    soles: Sequence[int] = (),
    resting: Sequence[tuple[int, int]] = (),
    ways: Array | None = None,
) -> Bounds:
    """Pairs of geoms that joints move apart, and bounds on how fast.

    Args:
        model: Robot and scene.
        joints: Ids of the joints that a path moves.
        corners: Ids of the sites at the corners of the soles.
        soles: Ids of the geoms that may touch the ground.
        resting: Pairs of geoms that lie against one another, and are left out.
        ways: As from `levers.strokes`; by default, of the model alone.
    """
    ways = strokes(model) if ways is None else ways
    others = (tuple(soles), tuple(resting))
    return _bounds(_Kinematics(model, ways), tuple(joints), tuple(corners), others)


@lru_cache(maxsize=MODELS)
def _bounds(
    kinematics: _Kinematics,
    joints: tuple[int, ...],
    corners: tuple[int, ...],
    others: tuple[tuple[int, ...], tuple[tuple[int, int], ...]],
) -> Bounds:
    model = kinematics.model
    levers = Levers(model, kinematics.ways)
    mass = model.body_mass * (model.body_rootid == model.body_rootid[model.jnt_bodyid[joints[0]]])
    mass = mass / mass.sum()
    pairs = contact_pairs(model, levers, set(joints), *others)
    index = np.full((model.ngeom, model.ngeom), -1)
    index[pairs[:, 0], pairs[:, 1]] = index[pairs[:, 1], pairs[:, 0]] = np.arange(len(pairs))
    moves, reach = moved(model, levers)
    first, second = pairs.T
    one, other = moves[first] & ~moves[second], moves[second] & ~moves[first]
    change = np.where(one, reach[first], 0.0) + np.where(other, reach[second], 0.0)
    if corners:
        change = np.concatenate([change, _balance(model, levers, mass, corners)[None]])
    found = Bounds(pairs, ~neighbours(model, pairs), index, mass, change)
    for array in found:
        array.setflags(write=False)  # it is shared
    return found


def _balance(model: mujoco.MjModel, levers: Levers, mass: Array, corners: tuple[int, ...]) -> Array:
    """Metres by which the margin of balance changes, at most, (n_jnt + n_free,)."""
    heavy = np.flatnonzero(mass)
    centre = mass[heavy] @ levers.of(heavy.tolist(), model.body_ipos[heavy], np.zeros(len(heavy)))
    soles = model.site_bodyid[list(corners)]
    feet = levers.of(soles.tolist(), model.site_pos[list(corners)], np.zeros(len(soles))).max(
        axis=0
    )
    free = int((model.jnt_type == FREE).sum())
    return np.append(centre + feet, np.zeros(free))  # a shift moves the mass and the feet alike
