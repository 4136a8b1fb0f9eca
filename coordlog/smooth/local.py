"""The default method: as smooth as can be everywhere, and closer to the samples only where a rule
fails.

One cut-off and one set of weights serve all joints, so whatever linear coordination the log has,
the path keeps. A failed look raises the weights of the knots it names by as much as halves their
distance to the samples; where the path fails, and nowhere else, it turns step by step into the log
itself.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from coordlog.path import Floats, Ints, Path
from coordlog.smooth.breach import Breaches, Kind
from coordlog.smooth.metrics import jerk_of
from coordlog.smooth.problem import Candidate, Problem

_ROUNDS = (
    100  # each halves the distance to the samples somewhere; 30 take a radian below a nanoradian
)
_PATIENCE = 12  # rounds for which a breach that the raw path commits too is fought, or one only the certificate sees
_SPREAD = 6  # times a knot is named before the knots next to it are drawn on too
_STIFF = 1e-24  # rad per unit of force: weights grow no further
_WORTH = 0.95  # of the jerk: what a longer ease must come down to, being another path to prove
_INSIDE = 1.5  # of an overshoot: how far inside its range a joint's samples are moved there


def local(problem: Problem) -> Iterator[Candidate]:
    """Yield at most one candidate: the smoothest found that every rule lets pass."""
    found = _search(problem, lenient=False)
    if found is not None:
        yield found


def _search(problem: Problem, *, lenient: bool) -> Candidate | None:
    judge, lam = problem.judge, problem.lam_max
    weight, target = problem.knots.weight, problem.knots.position
    hot, named, unproven = np.zeros(0, np.intp), np.zeros(len(weight), int), 0
    for turn in range(_ROUNDS if len(weight) > 2 else 1):
        spline = problem.fit(lam, weight=weight, target=target)
        softer = (
            _softer(problem, spline, weight, target, lenient=lenient) if turn == 0 else None
        )  # most logs need no more
        if softer is not None:
            return softer
        proof = judge.early(spline, hot=hot, lenient=lenient)
        if not len(proof.found):
            softer = _softer(problem, spline, weight, target, lenient=lenient) if turn > 0 else None
            return softer or problem.candidate(spline, lam, proof, weight)
        if not lenient and turn >= _PATIENCE and judge.raw.excuses(proof.found, lenient=True).any():
            return _search(problem, lenient=True)
        unproven += int((proof.found.kind == Kind.UNPROVEN).any())
        if unproven > _PATIENCE:  # the log itself grazes something there
            return None
        hot = np.union1d(hot, judge.samples.nearest(proof.found.time))
        target = _moved_inside(problem, target, proof.found)
        weight = _raised(problem, weight, lam, _spread(named, _around(problem, proof.found.time)))
    return None


def _softer(
    problem: Problem, spline: Path, weight: Floats, target: Floats, *, lenient: bool
) -> Candidate | None:
    """The same fit with its ends eased over more knots, if it is worth it: the longest ease that is
    proven, or none.

    An ease moves speed from the ends to the middle, so the pace that the joints can keep decides as
    well.
    """
    worth = _WORTH * jerk_of(spline, problem.knots)
    for eased in problem.eased():
        softer = eased.fit(problem.lam_max, weight=weight, target=target)
        if jerk_of(softer, problem.knots) < worth and not problem.judge.outpaces(softer):
            proof = problem.judge.early(softer, lenient=lenient)
            if not len(proof.found):
                return eased.candidate(softer, problem.lam_max, proof, weight)
    return None


def _around(problem: Problem, time: Floats) -> Ints:
    """Inner knots at these times, or on both sides of them, shape (2, m)."""
    last = len(problem.knots.time) - 1
    place = np.interp(time, problem.knots.time, np.arange(last + 1))
    sides: Ints = np.stack([np.floor(place + 1e-6), np.ceil(place - 1e-6)]).astype(np.intp)
    return sides.clip(1, last - 1)


def _spread(named: Ints, knots: Ints) -> Ints:
    """Knots to draw on: those named, and the wider around them the more often they were (counted in
    `named`).

    Holding the two knots beside a breach does not hold the path between them: its slopes there
    belong to their neighbours.
    """
    knots = np.unique(knots)
    named[knots] += 1
    reach = named[knots] // _SPREAD
    edge = np.zeros(len(named) + 1, np.intp)
    np.add.at(edge, np.maximum(knots - reach, 1), 1)
    np.add.at(edge, np.minimum(knots + reach, len(named) - 2) + 1, -1)
    return np.flatnonzero(np.cumsum(edge[:-1]) > 0)


def _raised(problem: Problem, weight: Floats, lam: float, at: Ints) -> Floats:
    """Weights that halve the path's distance to the samples at these knots, to first order.

    More weight δ at them moves the residual there from r to r / (1 + δ c), c being what a unit of
    force at all of them moves the path: the fit of the same force in place of the samples.
    """
    force = np.zeros((len(weight), 1))
    force[at, 0] = 1.0 / weight[at]
    ends = None if problem.velocity is None else np.zeros((2, 1))
    give = problem.grid.fit(force, lam=lam, weight=weight, velocity=ends).position[at, 0]
    raised = weight.copy()
    raised[at] += 1.0 / np.maximum(give, _STIFF)
    return raised


def _moved_inside(problem: Problem, target: Floats, found: Breaches) -> Floats:
    """Samples moved inward where the path leaves a joint's range.

    A log that rides a limit gives it nowhere to go.
    """
    found = found[found.kind == Kind.RANGE]
    if not len(found):
        return target
    shift = np.zeros_like(target)
    for knot in _around(problem, found.time):
        np.maximum.at(shift, (knot, found.what), _INSIDE * found.depth)
    lower, upper = problem.judge.widths[:2]
    return np.where(target > 0.5 * (lower + upper), target - shift, target + shift)
