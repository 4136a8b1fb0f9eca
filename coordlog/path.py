"""A path of joints as a function of time: piecewise cubic, callable, with derivatives.

What smoothing returns, what an episode's spline becomes, and what is drawn of it are all this.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coordlog.errors import SpecError

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Path:
    """A piecewise cubic path, given by positions and velocities at its break points.

    Between two break points it is the cubic Hermite polynomial; `path(t)` is the position at any
    time of [time[0], time[-1]], `path(t, nu)` its nu-th derivative.

    Example:
        >>> path = Path(np.array([0.0, 1.0]), np.array([[0.0], [2.0]]), np.zeros((2, 1)))
        >>> path(0.5), path(0.5, nu=1)
        (array([1.]), array([3.]))
    """

    time: Floats  # (B,) s, increasing
    position: Floats  # (B, n_j) rad, m for slides
    velocity: Floats  # (B, n_j) per second

    @cached_property
    def ppoly(self) -> PPoly:
        """The same curve as scipy's: coefficients (4, B - 1, n_j) over break points (B,)."""
        from scipy.interpolate import PPoly

        return PPoly(self.coefficients, self.time)

    @cached_property
    def coefficients(self) -> Floats:
        """Power-basis coefficients of each interval, highest power first, (4, B - 1, n_j)."""
        h = np.diff(self.time)[:, None]
        slope = np.diff(self.position, axis=0) / h
        left, right = self.velocity[:-1], self.velocity[1:]
        bend = (left + right - 2.0 * slope) / h
        return np.stack([bend / h, (slope - left) / h - bend, left, self.position[:-1]])

    def __call__(self, t: ArrayLike, nu: int = 0) -> Floats:
        """Evaluate the path or a derivative of it.

        Args:
            t: Times [s], any shape.
            nu: Order of the derivative, ≥ 0.

        Returns:
            Array of shape (*t.shape, n_j), in the unit of each joint per s^nu.

        Raises:
            SpecError: if a time lies outside the path.
        """
        when = np.asarray(t, dtype=float)
        first, last = self.time[0], self.time[-1]
        slack = 1e-9 * (last - first)
        if when.size and not (first - slack <= when.min() and when.max() <= last + slack):
            raise SpecError(
                f"t: the path is defined from {first:g} s to {last:g} s, "
                f"got {when.min():g} … {when.max():g} s"
            )
        when = np.clip(when, first, last)
        piece = np.clip(np.searchsorted(self.time, when, side="right") - 1, 0, len(self.time) - 2)
        x = (when - self.time[piece])[..., None]
        value = np.zeros((*when.shape, self.position.shape[1]))
        for power, coefficient in zip((3, 2, 1, 0), self.coefficients, strict=True):
            if power >= nu:
                factor = np.prod(np.arange(power, power - nu, -1), dtype=float)
                value = value * x + factor * coefficient[piece]
        return value
