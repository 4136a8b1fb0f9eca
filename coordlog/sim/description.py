"""A compiled model as other programs draw it: its links and shapes as URDF, and where each link is
in the link that carries it.

For looking only: what a log simulates from is the model's own text. URDF has boxes, cylinders,
capsules and spheres; a plane becomes a thin box, an ellipsoid a sphere of its volume, a mesh or
height field the box around it. A link that moves otherwise than by one hinge or slide through its
own origin is a `floating` one. Links without a name get that of their number.
"""

from __future__ import annotations

from collections.abc import Mapping
from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np

from coordlog.episode import Array
from coordlog.sim.inputs import place

WORLD = "world"
GRAIN = 2.0**-12
"""Coordinates are rounded to this [m, and entries of quaternions]: what nobody sees does not
compress."""
_FIRST_HIDDEN = 3
"""MuJoCo's viewers hide geoms of this group and above."""
_ENDLESS = 10.0
"""Side of a plane that has no end [m]."""


class Description:
    """How one model is drawn, and how its links move.

    Example:
        >>> description = Description(model)                        # doctest: +SKIP
        >>> description.transforms(episode.qpos, mocap).shape       # doctest: +SKIP
        (111, 24, 7)
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        """Look everything up once; the model is not kept."""
        self.links = (WORLD, *(model.body(i).name or f"body_{i}" for i in range(1, model.nbody)))
        self.parents = tuple(self.links[model.body_parentid[i]] for i in range(1, model.nbody))
        """Name of the link that carries each link but the world."""
        self.n_mocap = model.nmocap
        self._pos, self._quat = model.body_pos[1:].copy(), model.body_quat[1:].copy()
        self._mocap = np.flatnonzero(model.body_mocapid[1:] >= 0)
        self._mocap_id = model.body_mocapid[1:][self._mocap]
        self._moves = [
            _Move(model, body) for body in range(1, model.nbody) if model.body_jntnum[body]
        ]
        hinges = [move for move in self._moves if move.is_hinge]
        self._others = [move for move in self._moves if not move.is_hinge]
        self._hinges = np.array([move.row for move in hinges], np.intp)
        self._angles = np.array([move.address for move in hinges], np.intp)
        self._axis = np.array([move.axis for move in hinges]).reshape(-1, 3)
        self._turned = _product(
            self._quat[self._hinges], np.concatenate([np.zeros((len(hinges), 1)), self._axis], 1)
        )
        self._reference = np.array([move.reference for move in hinges])
        self._spheres = {
            model.geom(i).name: float(model.geom_size[i, 0])
            for i in range(model.ngeom)
            if model.geom_type[i] == mujoco.mjtGeom.mjGEOM_SPHERE and model.geom(i).name
        }
        self._template = _urdf(model, self.links, self.parents, self._moves, set(self._spheres))
        self._state_size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION)
        self._mocap_at = slice(
            place(model, mujoco.mjtState.mjSTATE_MOCAP_POS).start,
            place(model, mujoco.mjtState.mjSTATE_MOCAP_QUAT).stop,
        )

    def urdf(self, radii: Mapping[str, float] | None = None) -> str:
        """The robot and its scene as URDF.

        Args:
            radii: Radii of spheres by their geom's name, where they differ from the model's [m].
        """
        text = self._template
        for name, radius in (self._spheres | dict(radii or {})).items():
            text = text.replace(_token(name), f"{radius:.6g}")
        return text

    def mocap(self, state: Array) -> Array:
        """Poses of the mocap bodies in a full integration state, (n_mocap, 7): position,
        quaternion with w first; the model's own if the state is not one of this model.
        """
        if state.shape != (self._state_size,) or not self.n_mocap:
            poses = np.zeros((self.n_mocap, 7))
            poses[self._mocap_id] = np.hstack([self._pos[self._mocap], self._quat[self._mocap]])
            return poses
        values = state[self._mocap_at]
        pos, quat = values[: 3 * self.n_mocap], values[3 * self.n_mocap :]
        return np.hstack([pos.reshape(-1, 3), quat.reshape(-1, 4)])

    def transforms(self, qpos: Array, mocap: Array) -> Array:
        """Each link but the world in the link that carries it, (n, links, 7): translation [m] and
        quaternion, x first, as URDF and ROS have it; rounded to GRAIN.

        Args:
            qpos: MuJoCo's qpos, (n, n_q).
            mocap: Poses of the mocap bodies, (n, n_mocap, 7), quaternions with w first.
        """
        n = len(qpos)
        pos = np.repeat(self._pos[None], n, axis=0)
        quat = np.repeat(self._quat[None], n, axis=0)
        half = 0.5 * (qpos[:, self._angles] - self._reference)
        quat[:, self._hinges] = (
            np.cos(half)[..., None] * self._quat[self._hinges]
            + np.sin(half)[..., None] * self._turned
        )
        for move in self._others:
            pos[:, move.row], quat[:, move.row] = move.pose(qpos)
        if len(self._mocap):
            pos[:, self._mocap] = mocap[:, self._mocap_id, :3]
            quat[:, self._mocap] = mocap[:, self._mocap_id, 3:]
        found = np.concatenate([pos, quat[..., 1:], quat[..., :1]], axis=2)
        return np.rint(found / GRAIN) * GRAIN + 0.0


class _Move:
    """How one body moves in its parent: its joints, in order."""

    def __init__(self, model: mujoco.MjModel, body: int) -> None:
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        joints = [model.joint(i) for i in range(first, first + count)]
        self.row, self._base = body - 1, (model.body_pos[body].copy(), model.body_quat[body].copy())
        self._steps = [
            (
                int(joint.type[0]),
                int(joint.qposadr[0]),
                joint.pos.copy(),
                joint.axis.copy(),
                float(model.qpos0[joint.qposadr[0]]),
            )
            for joint in joints
        ]
        self.name = joints[0].name
        self.kind, self.address, anchor, self.axis, self.reference = self._steps[0]
        self.limits = tuple(joints[0].range) if model.jnt_limited[first] else None
        self.is_simple = count == 1 and self.kind in _URDF_KINDS and not anchor.any()
        self.is_hinge = self.is_simple and self.kind == int(mujoco.mjtJoint.mjJNT_HINGE)

    def pose(self, qpos: Array) -> tuple[Array, Array]:
        """Position (n, 3) and quaternion (n, 4), w first, in the parent.

        Source: MuJoCo's mj_kinematics.
        """
        pos, quat = (np.repeat(value[None], len(qpos), axis=0) for value in self._base)
        for kind, at, anchor, axis, reference in self._steps:
            if kind == int(mujoco.mjtJoint.mjJNT_FREE):
                quat = qpos[:, at + 3 : at + 7]
                return qpos[:, at : at + 3], quat / np.linalg.norm(quat, axis=1, keepdims=True)
            if kind == int(mujoco.mjtJoint.mjJNT_SLIDE):
                pos = pos + _rotated(quat, axis) * (qpos[:, at, None] - reference)
                continue
            before = pos + _rotated(quat, anchor)
            if kind == int(mujoco.mjtJoint.mjJNT_BALL):
                turn = qpos[:, at : at + 4]
                turn = turn / np.linalg.norm(turn, axis=1, keepdims=True)
            else:
                half = 0.5 * (qpos[:, at, None] - reference)
                turn = np.concatenate([np.cos(half), np.sin(half) * axis], axis=1)
            quat = _product(quat, turn)
            pos = before - _rotated(quat, anchor)
        return pos, quat


_URDF_KINDS = {
    int(mujoco.mjtJoint.mjJNT_HINGE): ("revolute", "continuous"),
    int(mujoco.mjtJoint.mjJNT_SLIDE): ("prismatic", "prismatic"),
}
"""URDF's word for a joint with limits, and for one without."""


def _urdf(
    model: mujoco.MjModel,
    links: tuple[str, ...],
    parents: tuple[str, ...],
    moves: list[_Move],
    spheres: set[str],
) -> str:
    lines = ['<robot name="scene">']
    for body, link in enumerate(links):
        lines.append(f"<link name={quoteattr(link)}>")
        lines += [_visual(model, geom, spheres) for geom in _shown(model, body)]
        lines.append("</link>")
    by_row = {move.row: move for move in moves}
    for row, (link, parent) in enumerate(zip(links[1:], parents, strict=True)):
        lines.append(_joint(model, row, link, parent, by_row.get(row)))
    return "\n".join([*lines, "</robot>"]) + "\n"


def _shown(model: mujoco.MjModel, body: int) -> list[int]:
    first = int(model.body_geomadr[body])
    geoms = range(first, first + int(model.body_geomnum[body])) if first >= 0 else range(0)
    return [i for i in geoms if model.geom_group[i] < _FIRST_HIDDEN] or list(geoms)


def _joint(model: mujoco.MjModel, row: int, link: str, parent: str, move: _Move | None) -> str:
    kind, inside, name = "fixed", "", f"to_{link}"
    if model.body_mocapid[row + 1] >= 0 or (move is not None and not move.is_simple):
        kind = "floating"
    elif move is not None:
        name = move.name or name
        kind = _URDF_KINDS[move.kind][move.limits is None]
        low, high = move.limits or (-1e3, 1e3)
        inside = f'<axis xyz="{_texts(move.axis)}"/>'
        if kind != "continuous":
            inside += f'<limit lower="{low:.6g}" upper="{high:.6g}" effort="0" velocity="0"/>'
    return (
        f'<joint name={quoteattr(name)} type="{kind}">'
        f"<parent link={quoteattr(parent)}/><child link={quoteattr(link)}/>"
        f"{_origin(model.body_pos[row + 1], model.body_quat[row + 1])}{inside}</joint>"
    )


def _visual(model: mujoco.MjModel, geom: int, spheres: set[str]) -> str:
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    pos, quat = model.geom_pos[geom], model.geom_quat[geom]
    name = model.geom(geom).name
    shapes = mujoco.mjtGeom
    if kind == shapes.mjGEOM_SPHERE:
        radius = _token(name) if name in spheres else f"{size[0]:.6g}"
        shape = f'<sphere radius="{radius}"/>'
    elif kind == shapes.mjGEOM_ELLIPSOID:
        shape = f'<sphere radius="{np.cbrt(size.prod()):.6g}"/>'
    elif kind in (shapes.mjGEOM_CAPSULE, shapes.mjGEOM_CYLINDER):
        tag = "capsule" if kind == shapes.mjGEOM_CAPSULE else "cylinder"
        shape = f'<{tag} radius="{size[0]:.6g}" length="{2 * size[1]:.6g}"/>'
    elif kind == shapes.mjGEOM_PLANE:
        sides = np.where(size[:2] > 0, 2 * size[:2], _ENDLESS)
        shape = f'<box size="{_texts((*sides, 0.001))}"/>'
    elif kind == shapes.mjGEOM_BOX:
        shape = f'<box size="{_texts(2 * size)}"/>'
    else:
        centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        pos = pos + _rotated(quat[None], centre)[0]
        shape = f'<box size="{_texts(2 * half)}"/>'
    colour = _texts(model.geom_rgba[geom])
    return (
        f"<visual>{_origin(pos, quat)}<geometry>{shape}</geometry>"
        f'<material name="m{geom}"><color rgba="{colour}"/></material></visual>'
    )


def _token(name: str) -> str:
    return f"{{radius of {name}}}"


def _origin(pos: Array, quat: Array) -> str:
    w, x, y, z = quat
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1, 1))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    if not (pos.any() or roll or pitch or yaw):
        return ""
    return f'<origin xyz="{_texts(pos)}" rpy="{_texts((roll, pitch, yaw))}"/>'


def _texts(values: Array | tuple[float, ...]) -> str:
    return " ".join(f"{value + 0.0:.6g}" for value in values)


def _rotated(quat: Array, vector: Array) -> Array:
    """A vector turned by quaternions (n, 4), w first."""
    w, axis = quat[:, :1], quat[:, 1:]
    cross = 2.0 * _cross(axis, vector)
    return np.asarray(vector + w * cross + _cross(axis, cross))


def _cross(a: Array, b: Array) -> Array:
    """np.cross of vectors in the last axis, which for a few rows takes five times as long."""
    (ax, ay, az), (bx, by, bz) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def _product(a: Array, b: Array) -> Array:
    """Products of quaternions, w first, (n, 4)."""
    w = a[:, :1] * b[:, :1] - (a[:, 1:] * b[:, 1:]).sum(axis=1, keepdims=True)
    xyz = a[:, :1] * b[:, 1:] + b[:, :1] * a[:, 1:] + _cross(a[:, 1:], b[:, 1:])
    return np.concatenate([w, xyz], axis=1)
