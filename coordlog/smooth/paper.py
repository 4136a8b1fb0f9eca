"""The paper's method: joint by joint from the base, the smallest p by bisection, judged at the
knots alone.

Faithful to Algorithms 2 to 4, with four errors mended: the residual is squared, p = 1 is tried
first (it need not be free), the p returned is the last one that was found free, and the whole path
is proven afterwards like any other. p is in units of the step index. What makes it fast changes no
p: a knot is asked about only where its configuration has moved further than the slack it is known
to have, and knots that failed last are asked first.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from coordlog.path import Floats, Ints, Path
from coordlog.smooth.cutoff import lam_from_p, p_from_lam
from coordlog.smooth.problem import Candidate, Problem

_PRECISION = 1e-6  # of p, as in the paper
_BLOCK = 32  # knots asked about at once, before looking whether one has failed
_REFRESH = 3  # times a knot is asked about before it is worth measuring its slack anew,
_WORTH = 16  # and knots of which that is true before they are measured together


def paper(problem: Problem) -> Iterator[Candidate]:
    """Yield the path of the paper's search if it can be proven."""
    lam = search(problem)
    if lam is not None:
        spline = problem.grid.fit_each(
            problem.knots.position, lam=lam, weight=problem.knots.weight, velocity=problem.velocity
        )
        proof = problem.validator.validate(spline, relaxed=True)
        if not len(proof.found):
            yield problem.candidate(spline, lam, proof)


def search(problem: Problem) -> Floats | None:
    """Find λ [s³] of each joint (n_j,), Algorithms 2 to 4.

    None if the samples themselves break a rule at a knot.
    """
    knots, unit = _Knots(problem), problem.grid.unit
    if not knots.start():
        return None
    lowest = 0.0 if problem.config.cutoff == "max" else float(p_from_lam(problem.lam_max, unit))
    lam = np.zeros(knots.path.shape[1])
    for joint in range(len(lam)):
        knots.turn_to(joint)
        lower, upper = lowest, 1.0
        while upper - lower >= _PRECISION:
            middle = 0.5 * (lower + upper)
            if knots.free(_fit(problem, joint, middle).position[:, 0]):
                upper = middle
            else:
                lower = middle
        lam[joint] = lam_from_p(upper, unit)
        knots.accept(_fit(problem, joint, upper).position[:, 0])
    return lam


def _fit(problem: Problem, joint: int, p: float) -> Path:
    column = slice(joint, joint + 1)
    ends = None if problem.velocity is None else problem.velocity[:, column]
    lam = float(lam_from_p(p, problem.grid.unit))
    return problem.grid.fit(
        problem.knots.position[:, column], lam=lam, weight=problem.knots.weight, velocity=ends
    )


class _Knots:
    """The path at its knots, always free there, and what is known about how far each knot may move.

    A knot has at most one reference: a configuration whose slack is known. It is asked about only
    where the joint at hand has turned further from there than that slack allows.
    """

    def __init__(self, problem: Problem) -> None:
        self.path = problem.knots.position.copy()
        self._problem, self._queries = problem, problem.validator.queries
        self._time, self._clearance = problem.knots.time, problem.config.clearance
        self._failed = np.zeros(len(self.path), bool)  # those that failed last
        self._times = np.zeros(
            len(self.path), int
        )  # asked about each knot since its reference was made
        self._room = np.zeros(
            len(self.path)
        )  # rad that the joint at hand may turn from the reference

    def start(self) -> bool:
        """Whether the samples are free, p = 1 for every joint."""
        if not self._within(slice(None), self.path) or not self._ask(
            np.arange(len(self.path)), self.path
        ):
            return False
        self._reference = self.path.copy()
        if self._queries.measures:
            self._slack = self._queries.slack(self._time, self.path, self._clearance)
        return True

    def turn_to(self, joint: int) -> None:
        """Take the next joint."""
        self._joint = joint
        self._times[:] = 0
        self._bound(np.arange(len(self.path)))

    def free(self, values: Floats) -> bool:
        """Whether the path with these angles of the joint, (K,), keeps every rule at the knots."""
        joint = self._joint
        if not self._within(joint, values):
            return False
        turned = abs(values - self._reference[:, joint])
        ask = np.flatnonzero((values != self.path[:, joint]) & ~(turned < self._room))
        path = self.path.copy()
        path[:, joint] = values
        again = self._failed[ask]
        free = self._ask(ask[again], path) and self._ask(ask[~again], path)
        due = np.flatnonzero(self._times >= _REFRESH)
        if len(due) >= _WORTH:
            self._measure(due, path)
        return free

    def accept(self, values: Floats) -> None:
        """Make these angles of the joint part of the path."""
        self.path[:, self._joint] = values

    def _measure(self, index: Ints, path: Floats) -> None:
        """Make new references of a trial: the next ones will be near it."""
        if self._queries.measures:
            self._slack[index] = self._queries.slack(
                self._time[index], path[index], self._clearance
            )
            self._reference[index] = path[index]
            self._times[index] = 0
            self._bound(index)

    def _bound(self, index: Ints) -> None:
        """Turn slack into room for the joint at hand, the other joints standing where they are."""
        if not self._queries.measures or not self._queries.reach.size:
            return
        reach, joint = self._queries.reach, self._joint
        pairs = np.flatnonzero(
            reach[:, joint] > 0.0
        )  # the others do not notice, and are free as the path stands
        away = abs(self.path[index] - self._reference[index])
        away[:, joint] = 0.0
        left = self._slack[np.ix_(index, pairs)] - away @ reach[pairs].T
        self._room[index] = (left / reach[pairs, joint]).min(axis=1, initial=np.inf)

    def _ask(self, index: Ints, path: Floats) -> bool:
        for block in (index[i : i + _BLOCK] for i in range(0, len(index), _BLOCK)):
            self._times[block] += 1
            free = self._queries.check(self._time[block], path[block], self._clearance).free
            if not free.all():
                self._failed[:] = False
                self._failed[block[~free]] = True
                return False
        return True

    def _within(self, joint: int | slice, values: Floats) -> bool:
        lower, upper = self._problem.validator.bounds[:2]
        farthest = self._problem.config.farthest(len(lower))[joint]
        inside = bool(((values >= lower[joint]) & (values <= upper[joint])).all())
        away = abs(values - self._problem.knots.position[:, joint])
        return inside and bool((away <= farthest).all())
