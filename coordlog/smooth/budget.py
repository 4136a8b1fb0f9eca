"""Query budget: configurations that a checker is asked about are counted, and limited."""

from __future__ import annotations

import numpy as np

from coordlog.errors import SpecError
from coordlog.path import Floats, Path
from coordlog.smooth.feasibility import Checker, DistanceChecker, MovingChecker, Verdict
from coordlog.smooth.violations import NONE, Kind, Violations, violations


class BudgetSpentError(Exception):
    """The query budget is used up."""


class CountedChecker:
    """A checker that counts the configurations it is asked about, and stops at a budget."""

    def __init__(self, checker: Checker) -> None:
        """Wrap a checker, without a limit."""
        self._checker = checker
        self._distances = checker if isinstance(checker, DistanceChecker) else None
        self._moving = checker if isinstance(checker, MovingChecker) else None
        self.checks, self.slacks = 0, 0
        self.budget: int | None = None
        self.describe = checker.describe

    @property
    def measures(self) -> bool:
        """Whether the checker knows distances too."""
        return self._distances is not None

    @property
    def reach(self) -> Floats:
        """As of the checker."""
        assert self._distances is not None
        return self._distances.reach

    def check(self, time: Floats, q: Floats, clearance: float) -> Verdict:
        """As `Checker.check`."""
        self.checks += len(q)
        self._stop()
        return self._checker.check(time, q, clearance)

    def slack(self, time: Floats, q: Floats, clearance: float) -> Floats:
        """As `DistanceChecker.slack`."""
        assert self._distances is not None
        self.slacks += len(q)
        self._stop()
        return self._distances.slack(time, q, clearance)

    def drift(self, start: Floats, stop: Floats) -> Floats:
        """As `DistanceChecker.drift`."""
        assert self._distances is not None
        return self._distances.drift(start, stop)

    def moving(self, path: Path) -> Violations:
        """Ask `MovingChecker.moving` at the knots of a path; nothing where the checker has no such
        rule.

        Raises:
            SpecError: if the answer has a wrong shape.
        """
        if self._moving is None:
            return NONE
        self.checks += len(path.time)
        self._stop()
        verdict = self._moving.moving(path.time, path.position, path.velocity, path(path.time, 2))
        _expect(verdict, len(path.time), "moving")
        free, depth, what = verdict
        return violations(Kind.MOTION, path.time[~free], depth[~free], what[~free])

    def worst(self, time: Floats, q: Floats, clearance: float) -> Violations:
        """Ask `check`; the worst pair of each configuration that is not free."""
        return _refused(time, self.check(time, q, clearance))

    def every(self, time: Floats, q: Floats, clearance: float) -> Violations:
        """Every pair that falls short, if the checker can tell.

        Otherwise the worst of each configuration.
        """
        return (
            _short(time, self.slack(time, q, clearance))
            if self.measures
            else self.worst(time, q, clearance)
        )

    def try_on(self, time: Floats, q: Floats, clearance: float) -> Violations:
        """Ask as `every`, and look at the shapes of all answers before they are relied on.

        Raises:
            SpecError: if one is wrong.
        """
        n, n_j = q.shape
        verdict = self.check(time, q, clearance)
        _expect(verdict, n, "check")
        if not self.measures:
            return _refused(time, verdict)
        slack = self.slack(time, q, clearance)
        got, reach = np.shape(slack), np.shape(self.reach)
        if len(reach) != 2 or reach[1] != n_j or got != (n, reach[0]):
            raise SpecError(
                f"checker: expected slack of shape ({n}, P) and reach of shape (P, {n_j}), got "
                f"{got} and {reach}"
            )
        return _short(time, slack)

    def _stop(self) -> None:
        if self.budget is not None and self.checks + self.slacks > self.budget:
            raise BudgetSpentError


def _expect(verdict: Verdict, n: int, name: str) -> None:
    if any(np.shape(part) != (n,) for part in verdict):
        raise SpecError(
            f"checker.{name}: expected three arrays of shape ({n},), got "
            f"{[np.shape(part) for part in verdict]}"
        )


def _refused(time: Floats, verdict: Verdict) -> Violations:
    free, depth, what = verdict
    return violations(Kind.CONTACT, time[~free], depth[~free], what[~free])


def _short(time: Floats, slack: Floats) -> Violations:
    row, pair = np.nonzero(~(slack >= 0.0))  # a NaN is short
    return violations(Kind.CONTACT, time[row], -slack[row, pair], pair)
