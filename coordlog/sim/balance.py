"""Is the robot's weight over its feet? Elementwise arithmetic only, so a batch and a single simulation agree bit for bit."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from coordlog.episode import Array

CONTACT_HEIGHT = 0.002
"""A corner of a sole lower than this [m] carries weight."""
GRAVITY = 9.81


def support_margin(point: Array, corners: Array) -> Array:
    """Signed distance of a ground point to the edge of the support polygon, (...): positive inside [m].

    The polygon is the convex hull of the sole corners on the floor. Inside it, the distance to the edge is the least, over all
    directions n, of max_i n·c_i - n·p; the directions normal to a pair of corners contain every edge's, and no other direction is less.
    Without at least three corners on the floor that span an area there is no polygon: -inf.

    Args:
        point: Ground projection, shape (..., 2).
        corners: Sole corners, shape (..., C, 3), C ≥ 3; those higher than CONTACT_HEIGHT do not count.

    Returns:
        Margin, shape (...). Outside the polygon it is negative (a bound on the distance, not the distance itself).
    """
    low = corners[..., 2] < CONTACT_HEIGHT
    x = corners[..., 0] - point[..., 0, None]
    y = corners[..., 1] - point[..., 1, None]
    first, second = (list(side) for side in zip(*combinations(range(corners.shape[-2]), 2), strict=True))
    nx, ny = y[..., second] - y[..., first], x[..., first] - x[..., second]
    length = np.sqrt(nx * nx + ny * ny)
    usable = low[..., first] & low[..., second] & (length > 1e-6)
    scale = np.where(usable, 1.0 / np.where(length > 1e-6, length, 1.0), 0.0)
    nx, ny = (nx * scale)[..., None], (ny * scale)[..., None]
    along = np.where(low[..., None, :], nx * x[..., None, :] + ny * y[..., None, :], np.nan)
    with np.errstate(all="ignore"):
        farthest, nearest = np.fmax.reduce(along, axis=-1), np.fmin.reduce(along, axis=-1)
    width = np.where(usable, farthest - nearest, np.inf).min(axis=-1)
    margin = np.where(usable, np.minimum(farthest, -nearest), np.inf).min(axis=-1)
    return np.where(usable.any(axis=-1) & (width > 1e-6), margin, -np.inf)


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
    return np.stack([com[..., 0] - share * acceleration[..., 0], com[..., 1] - share * acceleration[..., 1]], axis=-1)
