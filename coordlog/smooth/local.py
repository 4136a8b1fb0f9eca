"""Methods with one cut-off for all joints.

`local`, the default: as smooth as can be everywhere, and closer to the samples only where a rule
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
from coordlog.smooth.cutoff import cutoff_from_lam, lam_from_cutoff
from coordlog.smooth.metrics import jerk_of
from coordlog.smooth.problem import Candidate, Problem
from coordlog.smooth.violations import Kind, Violations

_ROUNDS = (
    100  # each halves the distance to the samples somewhere; 30 take a radian below a nanoradian
)
# Rounds against a violation that the reference has too, or one only the certificate sees.
_PATIENCE = 12
_SPREAD = 6  # times a knot is named before the knots next to it are drawn on too
_STIFF = 1e-24  # rad per unit of force: weights grow no further
_WORTH = 0.95  # of the jerk: what a longer blend must come down to, being another path to prove
_STEPS = 9  # of bisection: from half a period in 150 knots to Nyquist, to within 1 %
_INSIDE = 1.5  # of an overshoot: how far inside its range a joint's samples are moved there


def local(problem: Problem) -> Iterator[Candidate]:
    """Yield at most one candidate: the smoothest found that every rule lets pass."""
    found = _search(problem, relaxed=False)
    if found is not None:
        yield found


def _search(problem: Problem, *, relaxed: bool) -> Candidate | None:
    validator, lam = problem.validator, problem.lam_max
    weight, target = problem.knots.weight, problem.knots.position
    hints, named, unproven = np.zeros(0, np.intp), np.zeros(len(weight), int), 0
    for turn in range(_ROUNDS if len(weight) > 2 else 1):
        spline = problem.fit(lam, weight=weight, target=target)
        softer = (
            _softer(problem, spline, weight, target, relaxed=relaxed) if turn == 0 else None
        )  # most logs need no more
        if softer is not None:
            return softer
        proof = validator.early(spline, hints=hints, relaxed=relaxed)
        if not len(proof.found):
            softer = _softer(problem, spline, weight, target, relaxed=relaxed) if turn > 0 else None
            return softer or problem.candidate(spline, lam, proof, weight)
        if (
            not relaxed
            and turn >= _PATIENCE
            and validator.reference.allows(proof.found, relaxed=True).any()
        ):
            return _search(problem, relaxed=True)
        unproven += int((proof.found.kind == Kind.UNPROVEN).any())
        if unproven > _PATIENCE:  # the log itself grazes something there
            return None
        hints = np.union1d(hints, validator.samples.nearest(proof.found.time))
        target = _moved_inside(problem, target, proof.found)
        weight = _raised(problem, weight, lam, _spread(named, _around(problem, proof.found.time)))
    return None


def _softer(
    problem: Problem, spline: Path, weight: Floats, target: Floats, *, relaxed: bool
) -> Candidate | None:
    """The same fit with the longest blend of its ends that is worth it and proven, or none.

    A longer blend moves speed from the ends to the middle, so the nominal speed limits it as well.
    """
    worth = _WORTH * jerk_of(spline, problem.knots)
    for blended in problem.blended():
        softer = blended.fit(problem.lam_max, weight=weight, target=target)
        if jerk_of(softer, problem.knots) < worth and not problem.validator.exceeds_nominal_speed(
            softer
        ):
            proof = problem.validator.early(softer, relaxed=relaxed)
            if not len(proof.found):
                return blended.candidate(softer, problem.lam_max, proof, weight)
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

    Holding the two knots beside a violation does not hold the path between them: its slopes there
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


def _moved_inside(problem: Problem, target: Floats, found: Violations) -> Floats:
    """Samples moved inward where the path leaves a joint's range.

    A log that rides a limit gives it nowhere to go.
    """
    found = found[found.kind == Kind.RANGE]
    if not len(found):
        return target
    shift = np.zeros_like(target)
    for knot in _around(problem, found.time):
        np.maximum.at(shift, (knot, found.what), _INSIDE * found.depth)
    lower, upper = problem.validator.bounds[:2]
    return np.where(target > 0.5 * (lower + upper), target - shift, target + shift)


def shared(problem: Problem) -> Iterator[Candidate]:
    """Yield proven candidates of one cut-off and no weights, each smoother than the one before.

    Bisection in log frequency. Feasibility is not monotone in the cut-off, so it finds one edge of
    it, not the lowest of all.
    """
    unit = problem.grid.unit
    low, high = float(cutoff_from_lam(problem.lam_max, unit)), 0.5 / unit
    lowest = _proven(problem, low)
    if lowest is not None:
        yield lowest
        return
    highest = _proven(problem, high)
    if highest is None:
        return
    yield highest
    for _ in range(_STEPS):
        middle = float(np.sqrt(low * high))
        candidate = _proven(problem, middle)
        if candidate is None:
            low = middle
        else:
            high = middle
            yield candidate


def _proven(problem: Problem, cutoff: float) -> Candidate | None:
    lam = float(lam_from_cutoff(cutoff, problem.grid.unit))
    spline = problem.fit(lam)
    proof = problem.validator.validate(spline, relaxed=True)
    return None if len(proof.found) else problem.candidate(spline, lam, proof)
