"""How far a joint can move a point: bounds from the lengths of the kinematic tree alone."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from coordlog.episode import Array

HINGE, SLIDE, BALL, FREE = (
    int(getattr(mujoco.mjtJoint, f"mjJNT_{kind}")) for kind in ("HINGE", "SLIDE", "BALL", "FREE")
)
SPARE = (0.1, 0.01)
"""Share of a slide's stroke, and metres, by which it may leave its range: stops are soft."""


def strokes(model: mujoco.MjModel, qpos: Array | None = None) -> Array:
    """Ends of every slide's way [m], (n_jnt, 2), with some to spare; infinite for other joints.

    Of an unlimited slide the way is that of the configurations qpos (n, n_q), and at least a
    metre to both sides of its zero.
    """
    ways = np.tile([-np.inf, np.inf], (model.njnt, 1))
    for joint in np.flatnonzero(model.jnt_type == SLIDE):
        place = model.jnt_qposadr[joint]
        limited = bool(model.jnt_limited[joint])
        low, high = model.jnt_range[joint] if limited else (-1.0, 1.0)
        if qpos is not None and len(qpos):
            low, high = min(low, qpos[:, place].min()), max(high, qpos[:, place].max())
        spare = SPARE[0] * (high - low) + SPARE[1]
        ways[joint] = low - spare, high + spare
    return ways


class Levers:
    """Bounds in metres per radian of a hinge, or per metre of a slide, in every posture.

    Turning a hinge moves a point by its distance from the axis, at most the length of the chain of
    links between them. The bound adds up that chain as if it were stretched, slides run out to the
    ends of their ways; only the first link is taken at right angles to the axis, where no joint of
    the same body can change that. A slide moves all that is beyond it by
    as much as itself.

    Example:
        >>> levers = Levers(model)  # doctest: +SKIP
        >>> levers.of([hand], np.zeros((1, 3)), np.zeros(1))  # doctest: +SKIP
        array([[0.62, 0.31, 1.  ]])
    """

    def __init__(self, model: mujoco.MjModel, ways: Array | None = None) -> None:
        """Look at the joints of a model.

        Args:
            model: Hinges, slides, balls and free bodies.
            ways: As from `strokes`; by default, of the model alone.
        """
        self._model = model
        ways = strokes(model) if ways is None else ways
        zero = model.qpos0[model.jnt_qposadr]
        run = np.where(
            model.jnt_type == SLIDE, np.abs(ways - zero[:, None]).max(axis=1, initial=0.0), 0.0
        )
        self._runs = np.zeros(model.nbody)
        np.add.at(self._runs, model.jnt_bodyid, run)
        offsets = np.zeros(model.nbody)
        np.add.at(offsets, model.jnt_bodyid, 2.0 * np.linalg.norm(model.jnt_pos, axis=1))
        anchors = self._runs + offsets
        # What turns within the same body beyond a joint changes its arm, in direction and length.
        last = model.body_jntadr[model.jnt_bodyid] + model.body_jntnum[model.jnt_bodyid] - 1
        self._rigid = (np.arange(model.njnt) == last) & (self._runs[model.jnt_bodyid] == 0.0)
        self._loose = np.where(self._rigid, 0.0, anchors[model.jnt_bodyid])
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
        """Upper bound of ∂position/∂joint for a ball around each point, (m, n_jnt).

        Metres per radian, for slides metres per metre; 0 for a joint that moves the point not at
        all. Of a free body the rotation is meant.

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
        fixed = (model.jnt_type[joint] == HINGE) & self._rigid[joint]
        axis = model.jnt_axis[joint] * fixed[:, None]
        arm -= (arm * axis).sum(axis=1, keepdims=True) * axis
        lever = np.linalg.norm(arm, axis=1) + extent + self._loose[joint]
        levers = np.zeros((len(bodies), model.njnt))
        levers[item, joint] = np.where(model.jnt_type[joint] == SLIDE, 1.0, lever)
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
    """Which joints, and last a shift of each free body, move each geom, and how far at most,
    (n_geom, n_jnt + n_free) each.
    """
    reach = levers.of(model.geom_bodyid.tolist(), model.geom_pos, model.geom_rbound)
    shifted = reach[:, model.jnt_type == FREE] > 0.0
    own = model.jnt_bodyid[model.jnt_type == FREE]
    shifted |= model.geom_bodyid[:, None] == own  # a point in its middle does not turn, but shifts
    reach = np.column_stack([reach, shifted])
    return reach > 0, reach
