"""What tasks share that have a goal for every palm: the robot read against its goals."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from coordlog.contracts import Kinematics, Reading, View
from coordlog.episode import Array
from coordlog.tasks.reach.observation import nearness
from coordlog.tasks.reach.reward import Flags, distances
from coordlog.tasks.scene import Box3

MIDDLE = 0.35
"""Goals that are a random posture's palms: the share of every joint's range, around its middle,
that the posture is drawn from. Over the whole range most postures are only reached by way of
others."""
DRAWS = 100
"""Postures that are drawn for one that touches nothing."""


def parts(reading: Reading, view: View) -> dict[str, Array]:
    """The parts of the policy state that the view names (tasks/reach/observation.py)."""
    palms, goals, spheres = reading.palms, reading.goals, reading.spheres
    n = len(palms)
    found = {
        "angles": reading.angles,
        "palms": palms.reshape(n, -1),
        "goals": goals.reshape(n, -1),
    }
    if "spheres" in view.places:
        found["spheres"] = spheres.reshape(n, -1)
    if "difference" in view.places:
        found["difference"] = (goals - palms).reshape(n, -1)
    if "com" in view.places and reading.com is not None:
        found["com"] = reading.com
    if "nearness" in view.places and reading.links is not None:
        found["nearness"] = nearness(reading.links, palms, spheres).reshape(n, -1)
    if "velocity" in view.places:
        found["velocity"] = reading.velocities
    return found


def measure(reading: Reading) -> dict[str, Array]:
    """Distances, and what only the physics knows."""
    assert reading.collision is not None, "a task is measured after a step"
    assert reading.instability is not None, "a task is measured after a step"
    return {
        "distance": distances(reading.palms, reading.goals),
        "collision": reading.collision,
        "instability": reading.instability,
    }


def flags_of(columns: Mapping[str, Array]) -> Flags:
    """The flags among a task's columns."""
    return Flags(*(columns[name] for name in Flags._fields))


def mishaps(columns: Mapping[str, Array]) -> Array:
    """Collision or instability, (n,) bool."""
    return np.asarray(columns["collision"] | columns["instability"])


def inside(rng: np.random.Generator, box: Box3) -> Array:
    """A point (3,) drawn uniformly from a box of (x, y, z) ranges [m]."""
    low, high = np.array(box).T
    return np.asarray(rng.uniform(low, high))


def anywhere(rng: np.random.Generator, kinematics: Kinematics) -> Array | None:
    """Where a random posture that is balanced and touches nothing puts the palms, (k, 3) [m]:
    reachable as drawn.

    None if there is no such posture among many.
    """
    middle, half = kinematics.limits.mean(axis=1), np.ptp(kinematics.limits, axis=1) / 2
    for _ in range(DRAWS):
        angles = rng.uniform(middle - MIDDLE * half, middle + MIDDLE * half)
        if kinematics.legal(angles):
            return kinematics.palms(angles)
    return None
