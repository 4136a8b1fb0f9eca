"""What is said of a finished search: the status, the reason, and the path that goes with them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from coordlog.errors import SpecError
from coordlog.path import Path
from coordlog.smooth.problem import Candidate, Problem
from coordlog.smooth.result import FALLBACK, PARTLY, RAW_INFEASIBLE, SMOOTHED, Violation
from coordlog.smooth.violations import Kind, Violations


class Labels(NamedTuple):
    """Names and units of the joints, for messages."""

    names: Sequence[str]
    units: Sequence[str]

    @classmethod
    def of(cls, n_j: int, names: Sequence[str], units: Sequence[str]) -> Labels:
        """Those given, or "joint 0" … and rad.

        Raises:
            SpecError: if there are not as many as joints.
        """
        for what, given in (("joints: expected {} names", names), ("units: expected {}", units)):
            if len(given) not in (0, n_j):
                raise SpecError(f"{what.format(n_j)}, got {len(given)}")
        return cls(names or [f"joint {i}" for i in range(n_j)], units or ["rad"] * n_j)


def verdict(
    problem: Problem, best: Candidate | None, *, spent: bool, labels: Labels
) -> tuple[str, str, Violation | None, Candidate]:
    """Status, reason, violation and the path to return."""
    if best is None:
        return _fallback(problem, spent, labels)
    tolerated = best.proof.tolerated
    if len(tolerated):
        violation = _worst(problem, tolerated, labels)
        if _unsafe(problem, best.spline, tolerated):
            return (
                RAW_INFEASIBLE,
                f"the log itself breaks a rule, and so does the path: {violation}",
                violation,
                best,
            )
        return (
            PARTLY,
            f"not all that was asked for could be had, nor does the log have it: {violation}",
            violation,
            best,
        )
    left = [name for name, lam in zip(labels.names, best.lam, strict=True) if lam == 0.0]
    if left:
        return (
            PARTLY,
            f"left as in the log, for nothing smoother was free: {', '.join(left)}",
            None,
            best,
        )
    return SMOOTHED, "", None, best


def _fallback(
    problem: Problem, spent: bool, labels: Labels
) -> tuple[str, str, Violation | None, Candidate]:
    """The verdict where no candidate was proven: the reference, and whether that is free."""
    reference, n_j = problem.reference, problem.knots.position.shape[1]
    failed, proof = problem.validator.failed, problem.validator.report(problem.reference)
    kept = Candidate(reference, np.zeros(n_j), problem.knots.weight, proof, problem.blend)
    if len(proof.found) and _unsafe(problem, reference, proof.found):
        violation = _worst(problem, proof.found, labels)
        return (
            RAW_INFEASIBLE,
            f"the log itself breaks a rule, and no path was found that does not: {violation}",
            violation,
            kept,
        )
    if spent:
        return (
            FALLBACK,
            f"the checker was asked about {problem.config.budget} configurations without a proof",
            None,
            kept,
        )
    failure = _worst(problem, failed if len(failed) else proof.found, labels)
    return FALLBACK, f"no smoother path could be proven: {failure}", failure, kept


def _unsafe(problem: Problem, path: Path, found: Violations) -> bool:
    return bool((found.kind == Kind.RANGE).any()) or problem.validator.collides(path, found)


def _worst(problem: Problem, found: Violations, labels: Labels) -> Violation:
    """The deepest violation of the gravest kind."""
    i = int(np.lexsort((-found.depth, found.kind))[0])
    kind, what = Kind(int(found.kind[i])), int(found.what[i])
    of_pair = kind in (Kind.CONTACT, Kind.UNPROVEN, Kind.MOTION)
    text = problem.validator.queries.describe(what) if of_pair else labels.names[what]
    unit = "m" if of_pair else labels.units[what]
    return Violation(kind.name.lower(), float(found.time[i]), text, float(found.depth[i]), unit)
