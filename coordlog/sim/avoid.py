"""Sliding past spheres: joint motions that would bring an arm's last link too fast towards one are turned along its surface.

A velocity damper: the closer the link, the slower it may come (Faverjon and Tournassoud 1987). What is in the way of a straight joint
line is so passed by going around it, as a function of where everything is now, which a policy can learn; a plan drawn by chance it cannot.
"""

from __future__ import annotations

import numpy as np

from coordlog.episode import Array
from coordlog.sim.ik import Reach

SAFE = 0.025
"""Distance from a link's surface to a sphere at which it may not come any closer [m]."""
NEAR = 0.14
"""Spheres further away than this do not matter [m]."""
CLOSING = 0.2
"""Share of the distance that is left to `SAFE` by which a link may come closer in one step."""
ROUNDS = 4
"""Passes over all links and spheres: turning away from one may turn towards another."""
LINK_RADIUS = 0.02
"""Radius that a last link is taken to have [m]."""


def slide(reach: Reach, angles: Array, move: Array, *, spheres: Array, effort: Array) -> Array:
    """A motion of the joints that is slowed towards near spheres and turned along them.

    Args:
        reach: Kinematics.
        angles: Joint angles, (n_u,) [rad].
        move: What is wanted of them in one step, (n_u,) [rad].
        spheres: Rows of x, y, z, radius [m].
        effort: How far each joint can move in one step, (n_u,) [rad]; those that can do more give way more.
    """
    rows, allowed = _constraints(reach, angles, spheres)
    move = move.copy()
    for _ in range(ROUNDS if len(rows) else 0):
        for row, limit in zip(rows, allowed, strict=True):
            excess = row @ move - limit
            if excess > 0:
                give = effort**2 * row
                move -= excess * give / max(row @ give, 1e-9)
    return move


def turned(reach: Reach, angles: Array, action: Array, *, spheres: Array, step: Array) -> Array:
    """An action whose motion slides past near spheres, no entry beyond ±1, (n_u,).

    Args:
        reach: Kinematics.
        angles: Joint angles, (n_u,) [rad].
        action: What is wanted, (n_u,).
        spheres: Rows of x, y, z, radius [m].
        step: How far action 1 moves each joint in one step, (n_u,) [rad]; 0 for one that is locked, which then gives no way either.
    """
    found = slide(reach, angles, action * step, spheres=spheres, effort=step) / np.where(step > 0, step, 1.0)
    return np.asarray(found / max(1.0, np.abs(found).max()))


def _constraints(reach: Reach, angles: Array, spheres: Array) -> tuple[list[Array], list[float]]:
    """For each near pair of last link and sphere: how a joint's motion closes the distance, (n_u,) [m/rad], and by how much it may [m]."""
    found = reach.approaches(angles, spheres, within=NEAR + LINK_RADIUS)
    return [link.closing for link in found], [CLOSING * (link.gap - LINK_RADIUS - SAFE) for link in found]
