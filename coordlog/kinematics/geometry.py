"""Where everything is: an episode's joint angles as poses of geoms, palms, centre of mass and
soles, arrays in and arrays out.

What draws an episode needs these numbers and no MuJoCo. Quaternions are scalar first, as MuJoCo's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from coordlog.episode import INITIAL_STATE, Array, Episode
from coordlog.errors import FormatError
from coordlog.kinematics.balance import CONTACT_HEIGHT
from coordlog.kinematics.pairs import own_in_world
from coordlog.mjcf.dressed import SHOWN_GROUPS, Find, load_dressed
from coordlog.mjcf.looks import colour_of, mesh_of
from coordlog.robots.robot import Robot
from coordlog.tasks.scene import goal_body, sole_corner

STATE = mujoco.mjtState.mjSTATE_INTEGRATION
KINDS = {
    getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}"): kind
    for kind in ("plane", "sphere", "capsule", "ellipsoid", "cylinder", "box")
}
MESH = int(mujoco.mjtGeom.mjGEOM_MESH)
DRAWN = {int(kind) for kind in KINDS} | {MESH}
"""Kinds that are drawn as they are, not as a box."""


@dataclass(frozen=True, eq=False)
class Geom:
    """One shape of the model.

    `place` says whether it moves with the robot, stands in the world, or is carried by a mocap
    body.
    """

    index: int
    name: str
    kind: str
    """"plane", "sphere", "capsule", "ellipsoid", "cylinder", "box" or "mesh".

    What else MuJoCo knows is drawn as its bounding box.
    """
    size: tuple[float, float, float]
    """Half extents as MuJoCo means them for this kind [m]."""
    colour: tuple[float, float, float, float]
    place: str
    """"robot", "world", "goal", "object" or "obstacle"."""
    mesh: tuple[Array, Array] | None = None
    """Of a mesh: its vertices (v, 3) [m] in the geom's frame, and its triangles (t, 3)."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Poses over n configurations."""

    position: Array  # (n, n_geom, 3) m
    quaternion: Array  # (n, n_geom, 4) wxyz
    palms: Array  # (n, k, 3) m
    com: Array  # (n, 3) m, of the whole robot
    corners: Array  # (n, 4 per sole, 3) m, lower corners of the soles

    def support(self) -> list[Array]:
        """Corners (c, 2) [m] of the support polygon at each configuration, counter-clockwise.

        Empty where there is none.
        """
        low, points = self.corners[..., 2] < CONTACT_HEIGHT, self.corners[..., :2]
        polygons: list[Array] = [np.zeros((0, 2))] * len(low)
        left = np.arange(len(low))
        while len(
            left
            # the polygon of one configuration serves all others where the same corners span one
        ):
            on = np.flatnonzero(low[left[0]])
            turn = on[hull(points[left[0], on])]
            same = (low[left] == low[left[0]]).all(axis=1) & is_hull(
                points[left][:, turn], points[left][:, on]
            )
            same[0] = True
            for i in left[same]:
                polygons[i] = points[i, turn]
            left = left[~same]
        return polygons


class Geometry:
    """Forward kinematics of one episode's model, with the episode's own goals and obstacles in
    place.
    """

    def __init__(self, model: mujoco.MjModel, robot: Robot, initial: Array | None = None) -> None:
        """Look up every name once.

        Args:
            model: Robot and scene.
            robot: Palms and soles, by name.
            initial: mjSTATE_INTEGRATION vector of the first state, whose goals and obstacles hold
                throughout; None: the model's own.

        Raises:
            FormatError: if the model lacks a site the robot's spec names, or the state is not of
                this model.
        """
        self._model, self._data = model, mujoco.MjData(model)
        if initial is not None:
            wanted = mujoco.mj_stateSize(model, STATE)
            if initial.shape != (wanted,):
                raise FormatError(
                    f"attached initial state: expected {wanted} numbers for the attached model, "
                    f"got shape {initial.shape}"
                )
            mujoco.mj_setState(model, self._data, initial, STATE)
        try:
            self._palms = [model.site(arm.palm).id for arm in robot.arms]
            self._corners = [
                model.site(sole_corner(sole, i)).id for sole in robot.soles for i in range(4)
            ]
            joints = [model.joint(name) for name in robot.action_joints]
        except KeyError as error:
            raise FormatError(
                f"the attached model lacks what robot '{robot.name}' names: "
                f"{str(error).splitlines()[0]}"
            ) from error
        self.joints: Array = np.array([joint.qposadr[0] for joint in joints], dtype=int)
        """Places of the action joints in qpos, (n_u,)."""
        self.limits: Array = np.array([joint.range for joint in joints]).reshape(-1, 2)
        """Their ranges, (n_u, 2) [rad]."""
        bearer = int(model.site_bodyid[self._palms[0]]) if self._palms else min(1, model.nbody - 1)
        self._base = int(model.body_rootid[bearer])
        self._goals = {goal_body(arm.name) for arm in robot.arms}
        self._own = set(own_in_world(model).tolist())
        self.geoms = [self._geom(i) for i in range(model.ngeom)]
        boxed = [geom.index for geom in self.geoms if int(model.geom_type[geom.index]) not in DRAWN]
        self._middle = np.zeros((model.ngeom, 3))
        """From each geom's frame to the middle of what is drawn of it [m]."""
        self._middle[boxed] = model.geom_aabb[boxed, :3]

    @classmethod
    def of(
        cls, episode: Episode, attachments: Mapping[str, bytes], find: Find | None = None
    ) -> Geometry:
        """The geometry of a recorded episode, from the file's attachments; with what finds files
        beside it, wearing what its robot looks like.

        Raises:
            FormatError: if the model is missing, damaged, asks for other files, or is not the
                episode's.
        """
        model = load_dressed(attachments, find)
        if model.nq != episode.qpos.shape[1]:
            raise FormatError(
                f"the attached model: expected nq = {episode.qpos.shape[1]} as in the steps, got "
                f"{model.nq}"
            )
        state = attachments.get(INITIAL_STATE)
        start = None if state is None else np.frombuffer(state[: len(state) // 8 * 8], dtype="<f8")
        return cls(model, Robot.from_json(episode.header.env["robot"]), start)

    def of_place(self, place: str) -> list[Geom]:
        """Geoms of the robot, the world, … that are to be seen, in model order."""
        return [geom for geom in self.geoms if geom.place == place and geom.colour[3] > 0]

    def motion(self, qpos: Array) -> Motion:
        """Poses at each of n configurations, qpos (n, n_q)."""
        model, data = self._model, self._data
        n = len(qpos)
        bodies = np.empty((n, model.nbody, 4))
        position, palms = np.empty((n, model.ngeom, 3)), np.empty((n, len(self._palms), 3))
        com, corners = np.empty((n, 3)), np.empty((n, len(self._corners), 3))
        for i in range(n):
            data.qpos[:] = qpos[i]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            bodies[i], position[i], com[i] = (
                data.xquat,
                data.geom_xpos,
                data.subtree_com[self._base],
            )
            if self._palms:
                palms[i], corners[i] = data.site_xpos[self._palms], data.site_xpos[self._corners]
        quaternion = _product(bodies[:, model.geom_bodyid], model.geom_quat)
        if self._middle.any():
            position = position + turned(quaternion, self._middle)
        return Motion(position, quaternion, palms, com, corners)

    def palms(self, qpos: Array) -> Array:
        """Palm positions alone at each of n configurations, qpos (n, n_q): (n, k, 3) [m]."""
        places = np.empty((len(qpos), len(self._palms), 3))
        for i, row in enumerate(qpos):
            self._data.qpos[:] = row
            mujoco.mj_kinematics(self._model, self._data)
            places[i] = self._data.site_xpos[self._palms]
        return places

    def palms_of(self, path: Array, time: Array, episode: Episode) -> Array:
        """Where the palms are when the action joints stand at `path` (n, n_u) [rad] at `time` (n,)
        [s]: (n, k, 3) [m].

        All other coordinates (the free base, legs, head) are those of the executed step nearest in
        time.
        """
        nearest = np.abs(episode.time[None, :] - time[:, None]).argmin(axis=1)
        qpos = episode.qpos[nearest].copy()
        qpos[:, self.joints] = path
        return self.palms(qpos)

    def _geom(self, index: int) -> Geom:
        model = self._model
        geom, body = model.geom(index), int(model.geom_bodyid[index])
        form, mesh = int(geom.type[0]), None
        kind = KINDS.get(form, "box")
        size = tuple(geom.size) if form in KINDS else tuple(model.geom_aabb[index, 3:])
        if form == MESH:
            kind, mesh = "mesh", mesh_of(model, int(model.geom_dataid[index]))
        place = "robot"
        if body == 0:
            place = "world"
        elif model.body_mocapid[body] >= 0:
            name = model.body(body).name
            place = "goal" if name in self._goals else "object" if name == "object" else "obstacle"
        if index in self._own:
            place = "robot"
        red, green, blue, alpha = colour_of(model, index)
        colour = (red, green, blue, alpha * (model.geom_group[index] < SHOWN_GROUPS))
        return Geom(index, geom_label(model, index), kind, size, colour, place, mesh)


def geom_label(model: mujoco.MjModel, index: int) -> str:
    """A geom's name; by its body where it has none, as in models of others."""
    body = model.body(int(model.geom_bodyid[index])).name or "a body"
    return str(model.geom(index).name or f"body {body} (geom {index})")


def turned(quaternion: Array, vector: Array) -> Array:
    """Vectors (…, 3) turned by unit quaternions (…, 4), scalar first."""
    w, u = quaternion[..., :1], quaternion[..., 1:]
    across = 2.0 * np.cross(u, np.broadcast_to(vector, u.shape))
    return np.asarray(vector + w * across + np.cross(u, across))


def hull(points: Array) -> list[int]:
    """Which of n points (n, 2) are the corners of their convex hull, counter-clockwise; none if
    they span no area.

    Source: Andrew 1979, "Another efficient algorithm for convex hulls in two dimensions".
    """
    place = points.tolist()
    ordered = sorted(range(len(place)), key=place.__getitem__)
    corners: list[int] = []
    for run in (ordered, ordered[::-1]):
        chain: list[int] = []
        for i in run:
            while len(chain) > 1 and _turn(place[chain[-2]], place[chain[-1]], place[i]) <= 0:
                chain.pop()
            chain.append(i)
        corners += chain[:-1]
    return corners if len(corners) > 2 else []


def is_hull(corners: Array, points: Array) -> Array:
    """Whether polygons (n, c, 2) turn left everywhere and have all their points (n, p, 2) inside or
    on the edge, (n,) bool.
    """
    if corners.shape[1] == 0:
        return np.full(len(points), points.shape[1] < 3)
    edge = np.roll(corners, -1, axis=1) - corners
    after = np.roll(edge, -1, axis=1)
    turns = edge[..., 0] * after[..., 1] - edge[..., 1] * after[..., 0]
    apart = points[:, None] - corners[:, :, None]  # (n, c, p, 2)
    inside = edge[:, :, None, 0] * apart[..., 1] - edge[:, :, None, 1] * apart[..., 0]
    return np.asarray((turns > 0.0).all(axis=1) & (inside >= 0.0).all(axis=(1, 2)))


def _turn(a: Sequence[float], b: Sequence[float], c: Sequence[float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _product(p: Array, q: Array) -> Array:
    """Hamilton product of unit quaternions, scalar first, elementwise over leading axes."""
    pw, px, py, pz = np.moveaxis(p, -1, 0)
    qw, qx, qy, qz = np.moveaxis(np.broadcast_to(q, p.shape), -1, 0)
    return np.stack(
        [
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
        ],
        axis=-1,
    )
