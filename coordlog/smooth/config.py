"""What may be chosen about smoothing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from coordlog.config import build
from coordlog.errors import ConfigError, unknown
from coordlog.path import Floats

METHODS = ("local", "paper", "shared")
ENDS = ("auto", "rest", "soft", "natural")


@dataclass(frozen=True)
class Config:
    """Options of `coordlog.smooth.smooth`."""

    method: str = "local"
    """local: one cut-off for all joints, the path drawn towards the samples where a rule fails.
    shared: the lowest single cut-off that is proven. paper: base to tip, one p for each joint by
    bisection, the knots alone deciding."""
    cutoff: str | float = "max"
    """Lowest cut-off [Hz] to smooth to.

    "max": half a period in the whole path, below which little is left to gain.
    """
    max_deviation: float | tuple[float, ...] | None = None
    """Largest distance of the path from any sample, in the unit of each joint: one number for all,
    or one for each. None: as the rules allow."""
    clearance: float = 0.0
    """Distance that bodies must keep [m]."""
    ends: str = "auto"
    """Slope at the ends: rest (zero), soft (zero, and no acceleration either), natural (free,
    without bending). auto: natural for the paper's method, rest for the others. The end points
    themselves are always exact."""
    dense: int | None = None
    """Samples per knot at which a path is checked; 1: the knots alone. None: 4 where they are all
    there is, 2 beside a certificate, which sees everything between them and only shares no code
    with them in the checker."""
    certify: bool = True
    """Prove the stretches between samples as well; needs a checker that knows distances."""
    budget: int | None = None
    """Configurations the search may ask the checker about; None: no limit.

    What is proven by then stands.
    """

    def __post_init__(self) -> None:
        """Check every value.

        Raises:
            ConfigError: if one is unknown or out of its range.
        """
        if self.method not in METHODS:
            raise unknown("method", self.method, METHODS)
        if self.ends not in ENDS:
            raise unknown("ends", self.ends, ENDS)
        if self.cutoff != "max" and (isinstance(self.cutoff, str) or not self.cutoff > 0.0):
            raise ConfigError(
                f"cutoff: expected 'max' or a frequency above 0 Hz, got {self.cutoff!r}"
            )
        if self.max_deviation is not None and not (np.asarray(self.max_deviation) > 0.0).all():
            raise ConfigError(
                "max_deviation: expected distances above 0 in the unit of each joint, "
                f"got {self.max_deviation!r}"
            )
        if not 0.0 <= self.clearance < float("inf"):
            raise ConfigError(
                f"clearance: expected a distance of at least 0 m, got {self.clearance!r}"
            )
        if any(number is not None and number < 1 for number in (self.dense, self.budget)):
            raise ConfigError(
                f"dense, budget: expected at least 1, got {self.dense!r}, {self.budget!r}"
            )

    @classmethod
    def of(cls, **options: Any) -> Config:
        """A config from keywords.

        Raises:
            ConfigError: if a name is not an option, or a value of another type or out of its range.
        """
        farthest = options.get("max_deviation")
        if isinstance(farthest, np.ndarray):
            options["max_deviation"] = farthest.tolist()
        return build(cls, options, what="option")

    def farthest(self, n_j: int) -> Floats:
        """`max_deviation` of each joint, (n_j,), infinite where there is none.

        Raises:
            ConfigError: if there is neither one nor n_j of them.
        """
        wanted = np.asarray(np.inf if self.max_deviation is None else self.max_deviation, float)
        if wanted.shape not in ((), (n_j,)):
            raise ConfigError(f"max_deviation: expected one number or {n_j}, got {np.size(wanted)}")
        return np.broadcast_to(wanted, (n_j,))

    @property
    def per_knot(self) -> int:
        """Samples per knot."""
        return self.dense or (2 if self.certify else 4)

    @property
    def clamped(self) -> bool:
        """Whether the slopes at the ends are fixed."""
        return self.ends in ("rest", "soft") or (self.ends == "auto" and self.method != "paper")
