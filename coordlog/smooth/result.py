"""What smoothing hands back: the path, how far it can be trusted, and why."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from coordlog import episode
from coordlog.path import Floats, Path
from coordlog.smooth.config import Config
from coordlog.smooth.cutoff import cutoff_from_lam, p_from_lam
from coordlog.smooth.knots import Knots
from coordlog.smooth.metrics import Metrics, measure

SMOOTHED = "smoothed"
"""Proven by every rule asked for."""
PARTLY = "partly"
"""Proven free of collision, but not all that was asked for could be had: clearance, speed or
acceleration that the log lacks too, or a joint that had to stay as in the log. The reason names
it."""
FALLBACK = "kept_raw"
"""Nothing smoother could be proven: the path is the log's."""
RAW_INFEASIBLE = "raw_infeasible"
"""The log itself breaks a rule, and so does the path, smoothed or not: the same rule, about then,
and no more deeply (at the samples, to 0.1 mm). Not safe."""


class Violation(NamedTuple):
    """One rule that is broken, for people."""

    kind: str
    """contact, range, speed, acceleration, deviation, unproven or motion."""
    time: float
    """Within the path [s]."""
    what: str
    """The pair as the checker describes it, or the joint."""
    depth: float
    """By how much: m for contact and motion, otherwise the unit of the joint, per s, per s²."""
    unit: str = "rad"
    """rad or m."""

    def __str__(self) -> str:
        """As part of a sentence."""
        if self.kind == "unproven":
            return f"{self.what} at {self.time:.3f} s, too close to be proven free"
        words = {
            "contact": "m too close",
            "range": f"{self.unit} out of range",
            "speed": f"{self.unit}/s too fast",
            "acceleration": f"{self.unit}/s² too much acceleration",
            "deviation": f"{self.unit} too far from the log",
            "motion": "m too close while moving",
        }
        return f"{self.what} at {self.time:.3f} s, {self.depth:.2g} {words[self.kind]}"


@dataclass(frozen=True, eq=False)
class Result:
    """A smoothed path, or the log's own interpolant and the reason.

    Example:
        >>> result = smooth(time, q, checker)  # doctest: +SKIP
        >>> result.status, result.spline(0.5), result.deviation  # doctest: +SKIP
    """

    status: str
    """smoothed, partly, kept_raw or raw_infeasible."""
    reason: str
    """One sentence; "" when smoothed."""
    violation: Violation | None
    """The violation that the reason speaks of."""
    certified: bool
    """Proven free between samples too: at the clearance asked, or without touching for the pairs
    that fall short of it."""
    spline: Path
    reference: Path
    """The interpolant of the knots with the same ends, which the figures `before` are of."""
    knots: Knots
    weight: Floats  # (K,) fidelity weights of the fit; infinite at the ends
    lam: Floats  # (n_j,) s³, 0 for a joint left raw
    blend: int
    """Knots over which soft ends are blended."""
    checks: int
    """Configurations the checker decided on."""
    slacks: int
    """Configurations whose distances it measured."""
    cpu: float
    """Processor time [s]."""
    config: Config

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done to the samples before, with counts; empty if each was taken as it came."""
        return self.knots.notes

    @property
    def deviation(self) -> Floats:
        """Largest distance of each joint from its samples, in its own unit, (n_j,)."""
        return np.asarray(np.nanmax(self.knots.away(self.spline), axis=0))

    @cached_property
    def before(self) -> Metrics:
        """Figures of the reference: the log's own interpolant."""
        return measure(self.reference, self.knots)

    @cached_property
    def after(self) -> Metrics:
        """The same of the path."""
        return measure(self.spline, self.knots)

    @property
    def p(self) -> Floats:
        """The paper's smoothing parameter of each joint, in units of the step index, shape
        (n_j,).
        """
        return p_from_lam(self.lam, self.knots.unit)

    @property
    def cutoff(self) -> Floats:
        """Cut-off of each joint at unit weight [Hz], shape (n_j,).

        Infinite for a joint left raw.
        """
        return cutoff_from_lam(self.lam, self.knots.unit)

    def path(self) -> episode.Path:
        """Knots and spline as an episode carries them."""
        knots, spline = self.knots, self.spline
        return episode.Path(
            knots.time, knots.position, self.weight, spline.time, spline.position, spline.velocity
        )
