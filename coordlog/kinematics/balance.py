"""Is the robot's weight over its feet? Elementwise arithmetic only, so a batch and a single
simulation agree bit for bit.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from coordlog.episode import Array

CONTACT_HEIGHT = 0.002
"""A corner of a sole lower than this [m] carries weight."""
GRAVITY = 9.81


def support_margin(point: Array, corners: Array) -> Array:
    """Signed distance of a ground point to the edge of the support polygon, (...): positive inside
    [m].

    The polygon is the convex hull of the sole corners on the floor. Inside it, the distance to the
    edge is the least, over all directions n, of max_i n·c_i - n·p; the directions normal to a pair
    of corners contain every edge's, and no other direction is less. Without at least three corners
    on the floor that span an area there is no polygon: -inf.

    Args:
        point: Ground projection, shape (..., 2).
        corners: Sole corners, shape (..., C, 3), C ≥ 3; those higher than CONTACT_HEIGHT do not
            count.

    Returns:
        Margin, shape (...). Outside the polygon it is negative (a bound on the distance, not the
        distance itself).
    """
    # Corners first and contiguous: the reductions below run over the first axis, several times
    # faster than over the last.
    x, y, z = np.ascontiguousarray(np.moveaxis(corners, (-1, -2), (0, 1)))  # (C, ...) each
    x, y = x - point[..., 0], y - point[..., 1]
    low = z < CONTACT_HEIGHT
    # those in the air move to one on the floor, which leaves the hull of those on the floor as it
    # is
    if not low.all():
        standing = low.argmax(axis=0)[None]
        x, y = (np.where(low, side, np.take_along_axis(side, standing, axis=0)) for side in (x, y))
    first, second = _pairs(len(x))
    nx, ny = y[second] - y[first], x[first] - x[second]  # (P, ...)
    length = np.sqrt(nx * nx + ny * ny)
    usable = length > 1e-6
    scale = 1.0 / np.where(usable, length, np.inf)
    along = (nx * scale) * x[:, None]  # (C, P, ...)
    along += (ny * scale) * y[:, None]
    farthest, nearest = along.max(axis=0), along.min(axis=0)
    width = np.where(usable, farthest - nearest, np.inf).min(axis=0)
    margin = np.where(usable, np.minimum(farthest, -nearest), np.inf).min(axis=0)
    return np.where((width > 1e-6) & (width < np.inf), margin, -np.inf)


@cache
def _pairs(count: int) -> tuple[Array, Array]:
    """Indices of the first and of the second of all pairs of `count` things."""
    first, second = np.triu_indices(count, k=1)
    return first, second


def zero_moment_point(com: Array, acceleration: Array) -> Array:
    """Ground point about which the robot's weight and inertia have no moment, (..., 2) [m].

    The robot as one point mass: p = c - z c̈ / (g + z̈), horizontal parts.

    Source: Vukobratović and Borovac 2004, "Zero-moment point: thirty-five years of its life".

    Args:
        com: Centre of mass, shape (..., 3), above a floor at z = 0.
        acceleration: Its acceleration, shape (..., 3) [m/s²].
    """
    lift = np.maximum(GRAVITY + acceleration[..., 2], 1e-3)
    share = com[..., 2] / lift
    return np.stack(
        [com[..., 0] - share * acceleration[..., 0], com[..., 1] - share * acceleration[..., 1]],
        axis=-1,
    )
