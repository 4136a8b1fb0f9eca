"""Blended ends: a path that starts and stops without a jump in its acceleration.

A cubic at rest at its ends still starts with an acceleration out of nothing, which is most of the
jerk of a path that is smooth otherwise. So the fit runs over a time s that is slow at both ends,
ds/dt = √(u (2 - u)) with u the share of the blend that has passed, and runs with the clock in
between. At an end the fit goes as s², and s as t^(3/2): the path goes as t³. The samples stay as
they are.
"""

from __future__ import annotations

import numpy as np

from coordlog.path import Floats, Path
from coordlog.smooth.config import Config
from coordlog.smooth.spline import Grid
from coordlog.smooth.times import spacing

BLEND = 15
"""Knots over which an end is blended while a path is searched for.

Half the path if that is shorter.
"""
LONGER_BLENDS = (60, 40, 25)
"""Longer blends tried for the path that was found, if it stays proven: less jerk, for more speed in
the middle."""


def grid_for(time: Floats, config: Config, *, blend: int = BLEND) -> Grid:
    """The grid that fits over these knots (n,) [s], with the ends that the options ask for, blended
    over so many knots.
    """
    return (
        BlendedGrid(time, blend=blend)
        if config.ends == "soft"
        else Grid(time, clamped=config.clamped)
    )


class BlendedGrid(Grid):
    """Fits at rest at both ends, with no acceleration there.

    Λ is that of the stretch between the blended ends.
    """

    def __init__(self, time: Floats, *, blend: int = BLEND) -> None:
        """Prepare fits over `time` [s], shape (n,), n ≥ 2, strictly increasing, with ends blended
        over so many knots.
        """
        span, left = float(time[-1] - time[0]), time - time[0]
        width = min(span / 2.0, blend * spacing(time))
        u = np.clip(np.minimum(left, span - left) / width, 0.0, 1.0)
        # The integral of √(v (2 - v)) from 0 to u, π/4 at u = 1; beyond it the two times run alike.
        passed = width * (
            0.5 * (u - 1.0) * np.sqrt(u * (2.0 - u)) + 0.5 * np.arcsin(u - 1.0) + np.pi / 4.0
        )
        whole = width * np.pi / 2.0 + span - 2.0 * width
        middle = width * np.pi / 4.0 + left - width
        slow = np.where(left < width, passed, np.where(span - left < width, whole - passed, middle))
        super().__init__(slow, clamped=True)
        self._clock, self._rate = time, np.sqrt(u * (2.0 - u))[:, None]

    def fit(
        self, value: Floats, *, lam: float, weight: Floats, velocity: Floats | None = None
    ) -> Path:
        """As `Grid.fit`; slopes given for the ends must be zero."""
        found = super().fit(value, lam=lam, weight=weight, velocity=velocity)
        return Path(self._clock, found.position, found.velocity * self._rate)

    def fit_each(
        self, value: Floats, *, lam: Floats, weight: Floats, velocity: Floats | None = None
    ) -> Path:
        """As `Grid.fit_each`."""
        found = super().fit_each(value, lam=lam, weight=weight, velocity=velocity)
        return Path(self._clock, found.position, found.velocity)
