"""What a path must keep to: the contract of a checker, and what it says.

A checker knows one scene and one robot. `check` is asked about thousands of configurations per path
and decides what is allowed; `slack`, `reach` and `drift` let the certificate prove the stretches
between samples. Nothing here knows physics: MuJoCo, another engine or ten lines of NumPy serve
alike.

    class Corridor:                                   # two joints within 1 rad of zero
        reach = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])

        def slack(self, time, q, clearance):
            a, b = np.abs(q).T
            return np.stack([1.0 - a, 1.0 - b, 1.5 - a - b], axis=1) - clearance

        def check(self, time, q, clearance):
            return Verdict.from_slack(self.slack(time, q, clearance))

        def drift(self, start, stop):
            return np.zeros((len(start), 1))

        def describe(self, what):
            return ("first joint", "second joint", "both joints")[what]
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np

from coordlog.contracts import Checker, Verdict
from coordlog.path import Floats

__all__ = ["Checker", "DistanceChecker", "MovingChecker", "Unobstructed", "Verdict"]


@runtime_checkable
class DistanceChecker(Checker, Protocol):
    """A checker that also knows how far each of P pairs is from trouble; the certificate needs it.

    A pair is anything with a distance to lose: two bodies, or the centre of mass and the edge of
    its support polygon. For any two configurations at one time, the slack of pair i may differ by
    at most Σ_j reach[i, j] |Δq_j|.
    """

    @property
    def reach(self) -> Floats:
        """Metres by which a radian of joint j can change the distance of pair i, at most, in any
        posture; shape (P, n_j).
        """
        ...

    def slack(self, time: Floats, q: Floats, clearance: float) -> Floats:
        """Distance left to each pair [m], shape (n, P): distance less clearance, or margin of
        balance.

        `check` calls a configuration free exactly where no slack is negative. A lower bound will do
        for pairs that are far apart, so an engine may cap what it measures.
        """
        ...

    def drift(self, start: Floats, stop: Floats) -> Floats:
        """Speed [m/s] at which any slack may change within [start, stop] while no joint moves, at
        most.

        It covers what depends on time alone: the base the log recorded, obstacles that move. Times
        [s] have shape (m,), the bound (m, P) or (m, 1). A speed and not a distance: within any part
        of the stretch it must hold too.
        """
        ...


@runtime_checkable
class MovingChecker(Checker, Protocol):
    """A checker that also has a rule about motion, such as the zero-moment point staying over the
    feet.

    It is asked once about each path that everything else lets pass, at the knots: a cubic spline
    accelerates most at one of them.
    """

    def moving(self, time: Floats, q: Floats, velocity: Floats, acceleration: Floats) -> Verdict:
        """Validator a block of states, (n, n_j) each in rad, rad/s and rad/s².

        Depths [m] are comparable among themselves.
        """
        ...


class Unobstructed:
    """A checker for paths with nothing to hit: only the limits hold."""

    def __init__(self, n_j: int) -> None:
        """Make one for paths of n_j joints."""
        self.reach = np.zeros((0, n_j))

    def check(self, time: Floats, q: Floats, clearance: float) -> Verdict:
        """All free."""
        return Verdict.from_slack(self.slack(time, q, clearance))

    def slack(self, time: Floats, q: Floats, clearance: float) -> Floats:
        """No pairs."""
        return np.zeros((len(q), 0))

    def drift(self, start: Floats, stop: Floats) -> Floats:
        """Nothing moves."""
        return np.zeros((len(start), 0))

    def describe(self, what: int) -> str:
        """Never asked: everything is free."""
        return "nothing"
