"""How far a joint can move a point: bounds that hold in every posture, from the lengths of the
kinematic tree alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from coordlog.episode import Array
from coordlog.errors import FormatError


class Levers:
    """Bounds in metres per radian for a model whose joints are hinges, on at most one free base.

    Turning a hinge moves a point by its distance from the axis, at most the length of the chain of
    links between them. The bound adds up that chain as if it were stretched; only the first link is
    taken at right angles to the axis, which no other joint can change.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        """Look at the joints of a model.

        Raises:
            FormatError: for a joint that is neither a hinge nor a free base.
        """
        self._model = model
        hinge, free = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_FREE
        for joint in range(model.njnt):
            kind, body = model.jnt_type[joint], model.jnt_bodyid[joint]
            if kind != hinge and not (kind == free and model.body_parentid[body] == 0):
                raise FormatError(
                    f"joint '{model.joint(joint).name}': expected hinges on at most one free base, got another kind of joint"
                )
        anchors = np.zeros(model.nbody)
        np.add.at(anchors, model.jnt_bodyid, 2.0 * np.linalg.norm(model.jnt_pos, axis=1))
        self._anchors, self._parents = anchors.tolist(), model.body_parentid.tolist()
        self._lengths = np.linalg.norm(model.body_pos, axis=1).tolist()
        starts = zip(model.body_jntadr.tolist(), model.body_jntnum.tolist(), strict=True)
        self._joints = [range(first, first + count) for first, count in starts]
        self._above: dict[int, frozenset[int]] = {0: frozenset()}

    def above(self, body: int) -> frozenset[int]:
        """Joints that move a body: its own and those of every body between it and the world."""
        if body not in self._above:
            self._above[body] = self.above(self._parents[body]).union(self._joints[body])
        return self._above[body]

    def of(self, bodies: Sequence[int], points: Array, extents: Array) -> Array:
        """Metres by which a radian of each joint moves what lies within an extent of points of
        bodies, at most, (m, n_jnt).

        0 for a joint that moves it not at all; of a free base the rotation is meant.

        Args:
            bodies: A body id for each of the m points.
            points: In the frames of these bodies, (m, 3) [m].
            extents: Radius about each point, (m,) [m].
        """
        model, places = self._model, np.concatenate([points, self._model.body_pos])
        rows = self._walk(bodies, np.linalg.norm(points, axis=1).tolist(), extents.tolist())
        table = np.array(rows, dtype=np.float64).reshape(-1, 4)
        (item, joint, place), extent = table[:, :3].astype(np.intp).T, table[:, 3]
        arm = places[place] - model.jnt_pos[joint]
        axis = (
            model.jnt_axis[joint] * (model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE)[:, None]
        )
        arm -= (arm * axis).sum(axis=1, keepdims=True) * axis
        levers = np.zeros((len(bodies), model.njnt))
        levers[item, joint] = np.linalg.norm(arm, axis=1) + extent
        return levers

    def _walk(
        self, bodies: Sequence[int], lengths: list[float], extents: list[float]
    ) -> list[tuple[int, int, int, float]]:
        """From each point up to the world: the point, each joint on the way, the end of the last
        link there, and all links before it.
        """
        rows = list[tuple[int, int, int, float]]()
        for i, (home, length, reach) in enumerate(zip(bodies, lengths, extents, strict=True)):
            body, at = home, i
            while body:
                for joint in self._joints[body]:
                    rows.append((i, joint, at, reach))
                reach += length + self._anchors[body]
                length, at, body = self._lengths[body], len(bodies) + body, self._parents[body]
        return rows


def moved(model: mujoco.MjModel, levers: Levers) -> tuple[Array, Array]:
    """Which joints (and last: a shift of the base) move each geom, and how far at most, (n_geom,
    n_jnt + 1) each.
    """
    reach = levers.of(model.geom_bodyid.tolist(), model.geom_pos, model.geom_rbound)
    based = (reach[:, model.jnt_type == mujoco.mjtJoint.mjJNT_FREE] > 0).any(axis=1)
    reach = np.column_stack([reach, based])
    return reach > 0, reach
