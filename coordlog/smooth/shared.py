"""One cut-off for all joints: the lowest that bisection in log frequency can prove.

Feasibility is not monotone in the cut-off, so bisection finds one edge of it, not the lowest of
all; what it returns is proven all the same. The smoother is linear: with one cut-off, linear
coordination between joints survives.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from coordlog.smooth.cutoff import cutoff_from_lam, lam_from_cutoff
from coordlog.smooth.problem import Candidate, Problem

_STEPS = 9  # from half a period in a path of 150 knots to Nyquist are 7.2 octaves; nine halvings leave 1 %


def shared(problem: Problem) -> Iterator[Candidate]:
    """Yield proven candidates, each smoother than the one before."""
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
    proof = problem.judge.prove(spline, lenient=True)
    return None if len(proof.found) else problem.candidate(spline, lam, proof)
