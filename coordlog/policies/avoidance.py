"""Sliding past what is near: joint motions that would bring a link too fast towards it are turned
along its surface.

A velocity damper: the closer the link, the slower it may come (Faverjon and Tournassoud 1987). What
is in the way of a straight joint line is so passed by going around it, as a function of where
everything is now, which a policy can learn; a plan drawn by chance it cannot.
"""

from __future__ import annotations

import numpy as np

from coordlog.episode import Array
from coordlog.kinematics.ik import Approach, Reach

SAFE, CLOSE = 0.03, 0.01
"""Gap between an arm's last link and an obstacle that may not become narrower: on the way, and with
the palms at the goals [m]."""
ON_THE_WAY = 0.15
"""Further than this from its goal, a palm is on the way [m].

Nearer, the gap shrinks in proportion.
"""
BODY = 0.02
"""That gap between other links and an obstacle [m]; the body sways by more than a command says."""
OWN = 0.006
"""That gap between an arm and the robot itself [m]."""
LEAN = 0.06
"""What the torso keeps of the angle to where it counts as tipped.

The feet give way by nearly half of it [rad].
"""
CLOSING = 0.2
"""Share of the gap that is left to these by which it may close in one step."""
ROUNDS = 4
"""Passes over all that is near: turning away from one thing may turn towards another."""


def slide(reach: Reach, angles: Array, move: Array, *, effort: Array, safe: float = SAFE) -> Array:
    """A motion of the joints that is slowed towards what is near and turned along it.

    Args:
        reach: Kinematics, the spheres placed.
        angles: Joint angles, (n_u,) [rad].
        move: What is wanted of them in one step, (n_u,) [rad].
        effort: How far each joint can move in one step, (n_u,) [rad]; those that can do more give
            way more.
        safe: Gap to keep between last links and obstacles [m].
    """
    near = [(found.closing, allowed(found, safe)) for found in reach.approaches(angles)]
    torso = reach.leaning()
    near.append((torso.closing, CLOSING * (torso.gap - LEAN)))
    move = move.copy()
    for _ in range(ROUNDS):
        for row, limit in near:
            excess = row @ move - limit
            if excess > 0:
                give = effort**2 * row
                move -= excess * give / max(row @ give, 1e-9)
    return move


def allowed(found: Approach, safe: float) -> float:
    """By how much a gap may close in one step [m]; negative where it has to open."""
    return CLOSING * (found.gap - (OWN if not found.solid else safe if found.tip else BODY))


def gap_at(distance: float) -> float:
    """Gap to keep between last links and obstacles [m] with the palm that is furthest from its goal
    at this distance [m].
    """
    return max(CLOSE, SAFE * min(1.0, distance / ON_THE_WAY))


def farthest(palms: Array, goals: Array) -> float:
    """Distance of the palm that is furthest from its goal, of points (k, 3) [m]."""
    return float(np.sqrt(np.square(palms - goals).sum(axis=1).max()))


def turned(reach: Reach, angles: Array, action: Array, *, step: Array, safe: float = SAFE) -> Array:
    """An action whose motion slides past what is near, no entry beyond ±1, (n_u,).

    Args:
        reach: Kinematics, the spheres placed.
        angles: Joint angles, (n_u,) [rad].
        action: What is wanted, (n_u,).
        step: How far action 1 moves each joint in one step, (n_u,) [rad]; 0 for one that is locked,
            which then gives no way either.
        safe: Gap to keep between last links and obstacles [m].
    """
    found = slide(reach, angles, action * step, effort=step, safe=safe) / np.where(
        step > 0, step, 1.0
    )
    return np.asarray(found / max(1.0, np.abs(found).max()))
