"""Where everything is: an episode's joint angles as poses of geoms, palms, centre of mass and soles, arrays in and arrays out.

What draws an episode needs these numbers and no MuJoCo. Quaternions are scalar first, as MuJoCo's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from coordlog.episode import INITIAL_STATE, MODEL_MJB, MODEL_XML, Array, Episode
from coordlog.errors import FormatError
from coordlog.sim.attached import load_model
from coordlog.sim.balance import CONTACT_HEIGHT
from coordlog.sim.robot import Robot
from coordlog.sim.scene import goal_body, sole_corner

STATE = mujoco.mjtState.mjSTATE_INTEGRATION
KINDS = {getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}"): kind for kind in ("plane", "sphere", "capsule", "ellipsoid", "cylinder", "box")}


@dataclass(frozen=True, eq=False)
class Geom:
    """One shape of the model; `place` says whether it moves with the robot, stands in the world, or is carried by a mocap body."""

    index: int
    name: str
    kind: str
    """"plane", "sphere", "capsule", "ellipsoid", "cylinder" or "box"; what else MuJoCo knows is drawn as its bounding box."""
    size: tuple[float, float, float]
    """Half extents as MuJoCo means them for this kind [m]."""
    colour: tuple[float, float, float, float]
    place: str
    """"robot", "world", "goal", "object" or "obstacle"."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Poses over n configurations."""

    position: Array  # (n, n_geom, 3) m
    quaternion: Array  # (n, n_geom, 4) wxyz
    palms: Array  # (n, k, 3) m
    com: Array  # (n, 3) m, of the whole robot
    support: list[Array]
    """Per configuration the corners (c, 2) [m] of the convex hull of the sole corners on the floor, counter-clockwise; may be empty."""


class Geometry:
    """Forward kinematics of one episode's model, with the episode's own goals and obstacles in place."""

    def __init__(self, model: mujoco.MjModel, robot: Robot, initial: Array | None = None) -> None:
        """Look up every name once.

        Args:
            model: Robot and scene.
            robot: Palms and soles, by name.
            initial: mjSTATE_INTEGRATION vector of the first state, whose goals and obstacles hold throughout; None: the model's own.

        Raises:
            FormatError: if the model lacks a site the robot's spec names, or the state is not of this model.
        """
        self._model, self._data = model, mujoco.MjData(model)
        if initial is not None:
            wanted = mujoco.mj_stateSize(model, STATE)
            if initial.shape != (wanted,):
                raise FormatError(f"attached initial state: expected {wanted} numbers for the attached model, got shape {initial.shape}")
            mujoco.mj_setState(model, self._data, initial, STATE)
        try:
            self._palms = [model.site(arm.palm).id for arm in robot.arms]
            self._corners = [model.site(sole_corner(sole, i)).id for sole in robot.soles for i in range(4)]
            joints = [model.joint(name) for name in robot.action_joints]
        except KeyError as error:
            raise FormatError(f"the attached model lacks what robot '{robot.name}' names: {str(error).splitlines()[0]}") from error
        self.joints: Array = np.array([joint.qposadr[0] for joint in joints])
        """Places of the action joints in qpos, (n_u,)."""
        self.limits: Array = np.array([joint.range for joint in joints])
        """Their ranges, (n_u, 2) [rad]."""
        self._base = int(model.body_rootid[model.site_bodyid[self._palms[0]]])
        self._goals = {goal_body(arm.name) for arm in robot.arms}
        self.geoms = [self._geom(i) for i in range(model.ngeom)]

    @classmethod
    def of(cls, episode: Episode, attachments: Mapping[str, bytes]) -> Geometry:
        """The geometry of a recorded episode, from the file's attachments.

        Raises:
            FormatError: if the model is missing, damaged, asks for other files, or is not the episode's.
        """
        robot = Robot.from_json(episode.header.env["robot"])
        model = load_model(attachments.get(MODEL_XML), attachments.get(MODEL_MJB))
        if model.nq != episode.qpos.shape[1]:
            raise FormatError(f"the attached model: expected nq = {episode.qpos.shape[1]} as in the steps, got {model.nq}")
        state = attachments.get(INITIAL_STATE)
        return cls(model, robot, None if state is None else np.frombuffer(state[: len(state) // 8 * 8], dtype="<f8"))

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
            bodies[i], position[i], com[i] = data.xquat, data.geom_xpos, data.subtree_com[self._base]
            palms[i], corners[i] = data.site_xpos[self._palms], data.site_xpos[self._corners]
        quaternion = _product(bodies[:, model.geom_bodyid], model.geom_quat)
        return Motion(position, quaternion, palms, com, [hull(each[each[:, 2] < CONTACT_HEIGHT, :2]) for each in corners])

    def palms_of(self, path: Array, time: Array, episode: Episode) -> Array:
        """Where the palms are when the action joints stand at `path` (n, n_u) [rad] at `time` (n,) [s]: (n, k, 3) [m].

        All other coordinates (the free base, legs, head) are those of the executed step nearest in time.
        """
        nearest = np.abs(episode.time[None, :] - time[:, None]).argmin(axis=1)
        qpos = episode.qpos[nearest].copy()
        qpos[:, self.joints] = path
        return self.motion(qpos).palms

    def _geom(self, index: int) -> Geom:
        model = self._model
        geom, body = model.geom(index), int(model.geom_bodyid[index])
        kind = KINDS.get(int(geom.type[0]), "box")
        size = tuple(geom.size) if int(geom.type[0]) in KINDS else tuple(model.geom_aabb[index, 3:])
        place = "robot"
        if body == 0:
            place = "world"
        elif model.body_mocapid[body] >= 0:
            name = model.body(body).name
            place = "goal" if name in self._goals else "object" if name == "object" else "obstacle"
        return Geom(index, geom.name, kind, size, tuple(geom.rgba), place)


def hull(points: Array) -> Array:
    """Corners of the convex hull of points in the plane, (n, 2) to (c, 2), counter-clockwise; empty if they span no area.

    Source: Andrew 1979, "Another efficient algorithm for convex hulls in two dimensions".
    """
    ordered = sorted(set(map(tuple, points.tolist())))
    chains = []
    for run in (ordered, ordered[::-1]):
        chain: list[tuple[float, ...]] = []
        for point in run:
            while len(chain) > 1 and _turn(chain[-2], chain[-1], point) <= 0:
                chain.pop()
            chain.append(point)
        chains += chain[:-1]
    return np.array(chains) if len(chains) > 2 else np.zeros((0, 2))


def _turn(a: tuple[float, ...], b: tuple[float, ...], c: tuple[float, ...]) -> float:
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
