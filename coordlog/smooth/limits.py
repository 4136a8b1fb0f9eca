"""Range, speed and acceleration of each joint, held against a spline exactly: extrema of its
cubics, not samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from coordlog.errors import SpecError
from coordlog.path import Floats, Path
from coordlog.smooth.violations import NONE, Kind, Violations, violations

_TOLERANCE = 1e-3  # rad or m
_SHARE = 1e-2  # of the range


@dataclass(frozen=True, eq=False)
class Limits:
    """What each joint may do; None is no limit.

    Arrays of shape (n_j,), or one number for all joints.
    """

    lower: ArrayLike | None = None
    """Smallest angle [rad]."""
    upper: ArrayLike | None = None
    """Largest angle [rad]."""
    speed: ArrayLike | None = None
    """Largest |q'| [rad/s]."""
    acceleration: ArrayLike | None = None
    """Largest |q''| [rad/s²]."""
    nominal_speed: ArrayLike | None = None
    """Largest |q'| [rad/s] that longer soft ends may ask for; None: as far as `speed` goes."""
    tolerance: ArrayLike | None = None
    """Overshoot of the range that is let pass: joint stops of a simulator are soft, and logs ride
    them. None: a hundredth of each joint's range, at most 1e-3 (rad, m)."""

    def bounds(self, n_j: int) -> tuple[Floats, Floats, Floats, Floats]:
        """Lower, upper (tolerance included), speed and acceleration as arrays of shape (n_j,),
        infinite where unlimited.

        Raises:
            SpecError: if a limit has another shape, is NaN, or leaves a joint no room.
        """
        lower, upper = (
            _each("lower", self.lower, -np.inf, n_j),
            _each("upper", self.upper, np.inf, n_j),
        )
        speed, acceleration = (
            _each("speed", self.speed, np.inf, n_j),
            _each("acceleration", self.acceleration, np.inf, n_j),
        )
        if (lower > upper).any() or (speed <= 0.0).any() or (acceleration <= 0.0).any():
            raise SpecError("limits: expected lower ≤ upper, and speed and acceleration above zero")
        if self.tolerance is None:
            tolerance = np.minimum(_TOLERANCE, _SHARE * (upper - lower))
        else:
            tolerance = _each("tolerance", self.tolerance, 0.0, n_j)
        return lower - tolerance, upper + tolerance, speed, acceleration

    def nominal_speeds(self, n_j: int) -> Floats:
        """The nominal speed as an array of shape (n_j,).

        Raises:
            SpecError: if it has another shape or is NaN.
        """
        return _each(
            "nominal_speed",
            self.speed if self.nominal_speed is None else self.nominal_speed,
            np.inf,
            n_j,
        )


def _each(name: str, value: ArrayLike | None, otherwise: float, n_j: int) -> Floats:
    array = np.asarray(otherwise if value is None else value, dtype=float)
    if array.shape not in ((), (n_j,)) or np.isnan(array).any():
        raise SpecError(
            f"limits.{name}: expected one number or {n_j}, none of them NaN, got {value!r}"
        )
    return np.broadcast_to(array, (n_j,))


def limit_violations(spline: Path, bounds: tuple[Floats, Floats, Floats, Floats]) -> Violations:
    """Every stretch and joint of a spline that leaves its limits, at the extremum.

    Args:
        spline: The path.
        bounds: As from `Limits.bounds`.
    """
    lower, upper, speed, acceleration = bounds
    h = np.diff(spline.time)[:, None]
    a, b, u, v = (
        spline.position[:-1],
        spline.position[1:],
        spline.velocity[:-1],
        spline.velocity[1:],
    )
    middle = (
        3.0 * (b - a) / h - u - v
    )  # Bernstein coefficients of the speed are u, middle, v: its hull
    found = _range_violations(spline, h, lower, upper)
    if (
        np.isfinite(speed).any()
        and (np.maximum(np.maximum(abs(u), abs(v)), abs(middle)) > speed).any()
    ):
        found = found + _over(
            Kind.SPEED,
            spline,
            *_extremum(spline.coefficients[:3] * [[[3.0]], [[2.0]], [[1.0]]], h),
            speed,
        )
    if np.isfinite(acceleration).any():
        start, stop = 2.0 * (middle - u) / h, 2.0 * (v - middle) / h
        late = abs(stop) > abs(start)
        found = found + _over(
            Kind.ACCELERATION,
            spline,
            np.where(late, h, 0.0),
            np.where(late, abs(stop), abs(start)),
            acceleration,
        )
    return found


def _range_violations(spline: Path, h: Floats, lower: Floats, upper: Floats) -> Violations:
    """Stretches outside the range, from the roots of the derivative, asked only where the control
    polygon leaves it.
    """
    ends, third = (spline.position[:-1], spline.position[1:]), h / 3.0
    hull = np.stack(
        [*ends, ends[0] + third * spline.velocity[:-1], ends[1] - third * spline.velocity[1:]]
    )
    piece, joint = np.nonzero((hull.max(axis=0) > upper) | (hull.min(axis=0) < lower))
    if not len(piece):
        return NONE
    c3, c2, c1, c0 = spline.coefficients[:, piece, joint]
    width = h[piece, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        q = -(c2 + np.copysign(np.sqrt(c2 * c2 - 3.0 * c3 * c1), c2))
        x = np.stack([np.zeros_like(width), width, q / (3.0 * c3), c1 / q])
    x = np.where((x >= 0.0) & (x <= width), x, 0.0)  # NaN, where there is no root, compares false
    value = c0 + x * (c1 + x * (c2 + x * c3))
    over = np.maximum(value - upper[joint], lower[joint] - value)
    worst, every = over.argmax(axis=0), np.arange(len(piece))
    depth, x = over[worst, every], x[worst, every]
    out = depth > 0.0
    return violations(Kind.RANGE, (spline.time[piece] + x)[out], depth[out], joint[out])


def _extremum(quadratic: Floats, h: Floats) -> tuple[Floats, Floats]:
    """Where in [0, h] a quadratic (3, n - 1, n_j), highest power first, is largest in magnitude,
    and how large.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        vertex = -0.5 * quadratic[1] / quadratic[0]
    x = np.stack(
        [
            np.zeros_like(vertex),
            np.broadcast_to(h, vertex.shape),
            np.where((vertex > 0.0) & (vertex < h), vertex, 0.0),
        ]
    )
    size = abs((quadratic[0] * x + quadratic[1]) * x + quadratic[2])
    worst = size.argmax(axis=0)[None]
    return np.take_along_axis(x, worst, 0)[0], np.take_along_axis(size, worst, 0)[0]


def _over(kind: Kind, spline: Path, x: Floats, size: Floats, limit: Floats) -> Violations:
    """Violations where `size` (n - 1, n_j), reached x seconds into the stretch, is too large."""
    piece, joint = np.nonzero(size > limit * (1.0 + 1e-9))
    return violations(
        kind, spline.time[piece] + x[piece, joint], size[piece, joint] - limit[joint], joint
    )
