"""Kinematics and distances written plainly in NumPy: the independent judge of everything that
claims to be clear of something.

It reads the numbers of a model and calls nothing of MuJoCo. Distances are of convex shapes: a
sphere or capsule is a segment and a radius, whose distance to anything convex is convex along it
and found by ternary search; two solids by alternating projections.
"""

from __future__ import annotations

import numpy as np

PLANE, SPHERE, CAPSULE, ELLIPSOID, BOX = 0, 2, 3, 4, 6


def rotate(quaternion, vector):
    w, xyz = quaternion[..., :1], quaternion[..., 1:]
    cross = 2.0 * np.cross(xyz, vector)
    return vector + w * cross + np.cross(xyz, cross)


def product(p, q):
    w = p[..., :1] * q[..., :1] - (p[..., 1:] * q[..., 1:]).sum(-1, keepdims=True)
    return np.concatenate(
        [w, p[..., :1] * q[..., 1:] + q[..., :1] * p[..., 1:] + np.cross(p[..., 1:], q[..., 1:])],
        axis=-1,
    )


class Plain:
    """Forward kinematics of a tree of hinges, vectorised over configurations."""

    def __init__(self, model, *, mocap_pos):
        self.model, self.mocap_pos = model, mocap_pos

    def bodies(self, qpos):
        """Positions (n, n_body, 3) and quaternions (n, n_body, 4)."""
        m, n = self.model, len(qpos)
        pos, quat = np.zeros((n, m.nbody, 3)), np.zeros((n, m.nbody, 4))
        quat[:, 0, 0] = 1.0
        for body in range(1, m.nbody):
            parent = m.body_parentid[body]
            joints = range(m.body_jntadr[body], m.body_jntadr[body] + m.body_jntnum[body])
            if m.body_mocapid[body] >= 0:
                pos[:, body], quat[:, body] = (
                    self.mocap_pos[m.body_mocapid[body]],
                    m.body_quat[body],
                )
            elif len(joints) and m.jnt_type[joints[0]] == 0:
                place = m.jnt_qposadr[joints[0]]
                pos[:, body], quat[:, body] = (
                    qpos[:, place : place + 3],
                    qpos[:, place + 3 : place + 7],
                )
            else:
                pos[:, body] = pos[:, parent] + rotate(quat[:, parent], m.body_pos[body])
                quat[:, body] = product(quat[:, parent], np.broadcast_to(m.body_quat[body], (n, 4)))
                for joint in joints:
                    half = qpos[:, m.jnt_qposadr[joint], None] / 2
                    turn = np.concatenate([np.cos(half), np.sin(half) * m.jnt_axis[joint]], axis=1)
                    quat[:, body] = product(
                        quat[:, body], turn
                    )  # the anchors of our joints are the origins of their bodies
        return pos, quat

    def geoms(self, qpos):
        """Centres (n, n_geom, 3) and axes (n, n_geom, 3, 3), columns in the world."""
        m = self.model
        pos, quat = self.bodies(qpos)
        own = m.geom_bodyid
        centre = pos[:, own] + rotate(
            quat[:, own], np.broadcast_to(m.geom_pos, (len(qpos), m.ngeom, 3))
        )
        turn = product(quat[:, own], np.broadcast_to(m.geom_quat, (len(qpos), m.ngeom, 4)))
        return centre, np.stack(
            [rotate(turn, np.broadcast_to(axis, (*turn.shape[:-1], 3))) for axis in np.eye(3)],
            axis=-1,
        )

    def com(self, qpos):
        m = self.model
        pos, quat = self.bodies(qpos)
        share = m.body_mass / m.body_mass.sum()
        return ((pos + rotate(quat, np.broadcast_to(m.body_ipos, pos.shape))) * share[:, None]).sum(
            axis=1
        )

    def distances(self, qpos, pairs, *, cap=np.inf):
        """Distance of each pair at each configuration (n, P) [m], or at least `cap` where it is
        more than that.

        Negative where shapes with a radius overlap; zero where two solid shapes do.
        """
        m, pairs = self.model, np.asarray(pairs)
        centre, axes = self.geoms(qpos)
        found = np.full((len(qpos), len(pairs)), np.inf)
        for column, (a, b) in enumerate(pairs):
            if m.geom_type[a] not in (SPHERE, CAPSULE):
                a, b = b, a
            own, other = (centre[:, a], axes[:, a]), (centre[:, b], axes[:, b])
            radius = np.linalg.norm(m.geom_size[a]) + (
                m.geom_size[a, 0] if m.geom_type[a] == CAPSULE else 0.0
            )
            bound = to_shape(centre[:, a], m.geom_type[b], m.geom_size[b], *other) - radius
            near = np.flatnonzero(bound < cap)
            found[:, column] = bound
            if len(near):
                near_own, near_other = tuple(x[near] for x in own), tuple(x[near] for x in other)
                found[near, column] = between(
                    m.geom_type[a],
                    m.geom_size[a],
                    near_own,
                    m.geom_type[b],
                    m.geom_size[b],
                    near_other,
                )
        return found


def to_shape(point, kind, size, centre, axes):
    """Distance of points (n, 3) to a shape; for a solid one zero inside."""
    local = np.einsum("nij,ni->nj", axes, point - centre)
    if kind == PLANE:
        return local[:, 2]
    if kind in (SPHERE, CAPSULE):
        half = size[1] if kind == CAPSULE else 0.0
        along = np.stack(
            [np.zeros(len(local)), np.zeros(len(local)), np.clip(local[:, 2], -half, half)], axis=1
        )
        return np.linalg.norm(local - along, axis=1) - size[0]
    return np.linalg.norm(local - onto(local, kind, size), axis=1)


def onto(local, kind, size):
    """Nearest points of a box or ellipsoid, in its frame."""
    if kind == BOX:
        return np.clip(local, -size, size)
    outside = ((local / size) ** 2).sum(axis=1) > 1.0
    low, high = (
        np.zeros(len(local)),
        np.full(len(local), size.max() * np.linalg.norm(local, axis=1).max(initial=1e-9)),
    )
    for _ in range(32):  # Σ (size x / (t + size²))² = 1 has one root t ≥ 0 for a point outside
        t = 0.5 * (low + high)
        far = ((size * local / (t[:, None] + size**2)) ** 2).sum(axis=1) > 1.0
        low, high = np.where(far, t, low), np.where(far, high, t)
    return np.where(outside[:, None], size**2 * local / (high[:, None] + size**2), local)


def between(kind_a, size_a, a, kind_b, size_b, b):
    if kind_a in (SPHERE, CAPSULE):
        half = size_a[1] if kind_a == CAPSULE else 0.0
        low, high = np.full(len(a[0]), -half), np.full(len(a[0]), half)
        for _ in range(30 if half else 1):
            third = (high - low) / 3.0
            left, right = (
                to_shape(a[0] + x[:, None] * a[1][:, :, 2], kind_b, size_b, *b)
                for x in (low + third, high - third)
            )
            low, high = (
                np.where(left > right, low + third, low),
                np.where(left > right, high, high - third),
            )
        return (
            to_shape(a[0] + (0.5 * (low + high))[:, None] * a[1][:, :, 2], kind_b, size_b, *b)
            - size_a[0]
        )
    if kind_b == PLANE:
        down = -np.einsum("nij,ni->nj", a[1], b[1][:, :, 2])
        far = (
            np.sign(down) * size_a
            if kind_a == BOX
            else size_a**2 * down / np.linalg.norm(size_a * down, axis=1)[:, None]
        )
        return to_shape(a[0] + np.einsum("nij,nj->ni", a[1], far), kind_b, size_b, *b)
    if kind_a == PLANE:
        return between(kind_b, size_b, b, kind_a, size_a, a)
    point = b[0].copy()
    for _ in range(400):
        before = point
        on_a = world(onto(np.einsum("nij,ni->nj", a[1], point - a[0]), kind_a, size_a), *a)
        point = world(onto(np.einsum("nij,ni->nj", b[1], on_a - b[0]), kind_b, size_b), *b)
        if np.abs(point - before).max() < 1e-9:
            break
    return np.linalg.norm(on_a - point, axis=1)


def world(local, centre, axes):
    return centre + np.einsum("nij,nj->ni", axes, local)
