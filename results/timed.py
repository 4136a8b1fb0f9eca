"""How fast a path is gone: the minimum-jerk law under the joints' speed limits."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coordlog.episode import Array

PEAK = 1.875
"""Greatest speed of the minimum-jerk law over its mean."""


def least(moved: Array, speeds: Array, *, peak: float = PEAK) -> float:
    """Shortest time in which joints move by these angles (n_u,) [rad] at speeds (n_u,) [rad/s], the greatest `peak` times the mean: [s]."""
    return peak * float((np.abs(moved) / speeds).max())


class Timed(NamedTuple):
    """A path along which joints move no faster than they may: straight between its points, under one minimum-jerk law."""

    points: Array
    along: Array
    """Time at which each point would be passed at full speed [s], from 0."""
    duration: float

    @classmethod
    def of(cls, points: Array, speeds: Array) -> Timed:
        """Time a path for joint speeds (n_u,) [rad/s]."""
        moved = np.abs(np.diff(points, axis=0)) / speeds
        points = points[np.append(True, moved.max(axis=1) > 1e-9)]
        along = np.append(0.0, np.cumsum((np.abs(np.diff(points, axis=0)) / speeds).max(axis=1)))
        return cls(points, along, PEAK * float(along[-1]))

    def __call__(self, t: float | Array) -> Array:
        """Joint angles at times [s], (…, n_u)."""
        x = np.clip(np.asarray(t) / self.duration, 0.0, 1.0)
        at = x**3 * (10.0 - 15.0 * x + 6.0 * x**2) * self.along[-1]
        return np.stack([np.interp(at, self.along, column) for column in self.points.T], axis=-1)
