"""How far a joint can move a point: bounds that hold in every posture, from the lengths of the kinematic tree alone."""

from __future__ import annotations

import mujoco
import numpy as np

from coordlog.episode import Array
from coordlog.errors import FormatError


class Levers:
    """Bounds in metres per radian for a model whose joints are hinges, on at most one free base.

    Turning a hinge moves a point by its distance from the axis, at most the length of the chain of links between them. The bound adds
    up that chain as if it were stretched; only the first link is taken at right angles to the axis, which no other joint can change.
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
                raise FormatError(f"joint '{model.joint(joint).name}': expected hinges on at most one free base, got another kind of joint")
        anchors = np.zeros(model.nbody)
        np.add.at(anchors, model.jnt_bodyid, 2.0 * np.linalg.norm(model.jnt_pos, axis=1))
        self._anchors, self._parents = anchors.tolist(), model.body_parentid.tolist()
        self._lengths = np.linalg.norm(model.body_pos, axis=1).tolist()
        self._above: dict[int, frozenset[int]] = {0: frozenset()}

    def above(self, body: int) -> frozenset[int]:
        """Joints that move a body: its own and those of every body between it and the world."""
        if body not in self._above:
            first = int(self._model.body_jntadr[body])
            own = range(first, first + int(self._model.body_jntnum[body]))
            self._above[body] = self.above(self._parents[body]).union(own)
        return self._above[body]

    def lever(self, joint: int, body: int, point: Array, extent: float = 0.0) -> float:
        """Metres by which a radian of a joint moves what lies within `extent` of a point of a body, at most.

        Args:
            joint: Joint id, one of `above(body)`; for a free base its rotation is meant.
            body: Body id.
            point: In the frame of the body, shape (3,) [m].
            extent: Radius about the point [m].
        """
        model, home = self._model, int(self._model.jnt_bodyid[joint])
        length = 0.0 if body == home else float(np.linalg.norm(point))
        while body != home:
            extent += length + self._anchors[body]
            length, point, body = self._lengths[body], model.body_pos[body], self._parents[body]
        arm = point - model.jnt_pos[joint]
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE:
            arm = arm - (arm @ model.jnt_axis[joint]) * model.jnt_axis[joint]
        return float(np.linalg.norm(arm)) + extent


def moved(model: mujoco.MjModel, levers: Levers) -> tuple[Array, Array]:
    """Which joints (and last: a shift of the base) move each geom, and how far at most, (n_geom, n_jnt + 1) each."""
    moves, reach = np.zeros((model.ngeom, model.njnt + 1), dtype=bool), np.zeros((model.ngeom, model.njnt + 1))
    for geom in range(model.ngeom):
        body, radius = int(model.geom_bodyid[geom]), float(model.geom_rbound[geom])
        for joint in levers.above(body):
            moves[geom, joint], reach[geom, joint] = True, levers.lever(joint, body, model.geom_pos[geom], radius)
            if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
                moves[geom, -1], reach[geom, -1] = True, 1.0
    return moves, reach
