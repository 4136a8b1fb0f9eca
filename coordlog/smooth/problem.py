"""One path to smooth: the input of all three methods, and their result."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from coordlog.path import Floats, Path
from coordlog.smooth.blending import BLEND, LONGER_BLENDS, grid_for
from coordlog.smooth.config import Config
from coordlog.smooth.cutoff import lam_from_cutoff
from coordlog.smooth.knots import Knots
from coordlog.smooth.spline import Grid
from coordlog.smooth.validator import Proof, Validator

_LAM_MAX = (
    1e12  # knots³, a period of 6 000 knots; beyond it double precision leaves noise in the jerk
)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A path that may be returned, and how it came about."""

    spline: Path
    lam: Floats  # (n_j,) s³
    weight: Floats  # (K,)
    proof: Proof
    blend: int
    """Knots over which soft ends are blended."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Knots, rules and options of one path."""

    knots: Knots
    reference: Path
    """The interpolant of the knots, with the same ends: what a candidate is compared with, and
    replaced by."""
    grid: Grid
    velocity: Floats | None
    """Slopes at the ends, (2, n_j) rad/s; None: natural ends."""
    validator: Validator
    config: Config
    blend: int = BLEND
    """Knots over which the grid blends soft ends."""

    def blended(self) -> Iterator[Problem]:
        """The same with soft ends blended over more knots, as far as the path is long enough to
        tell, the longest first.
        """
        for shorter, blend in zip((*LONGER_BLENDS[1:], BLEND), LONGER_BLENDS, strict=False):
            if self.config.ends == "soft" and 2 * shorter < len(self.knots.time):
                yield replace(
                    self, grid=grid_for(self.knots.time, self.config, blend=blend), blend=blend
                )

    def fit(
        self, lam: float, *, weight: Floats | None = None, target: Floats | None = None
    ) -> Path:
        """The smoothing spline of all joints for one λ [s³].

        Weights and samples default to those of the knots.
        """
        return self.grid.fit(
            self.knots.position if target is None else target,
            lam=lam,
            weight=self.knots.weight if weight is None else weight,
            velocity=self.velocity,
        )

    @property
    def lam_max(self) -> float:
        """λ [s³] of the lowest cut-off asked for; "max" is half a period in the whole path."""
        lowest = (
            0.5 / (self.knots.time[-1] - self.knots.time[0])
            if self.config.cutoff == "max"
            else float(self.config.cutoff)
        )
        unit = self.knots.unit
        return min(float(lam_from_cutoff(lowest, unit)), _LAM_MAX * unit**3)

    def candidate(
        self, spline: Path, lam: float | Floats, proof: Proof, weight: Floats | None = None
    ) -> Candidate:
        """Wrap up a path that was proven."""
        each = np.broadcast_to(np.asarray(lam, dtype=float), self.knots.position.shape[1:])
        return Candidate(
            spline, each, self.knots.weight if weight is None else weight, proof, self.blend
        )
