"""From a noisy joint path to one that is smoother and proven, or the same path and the reason why
not.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import process_time
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from coordlog.errors import SpecError
from coordlog.path import Path
from coordlog.smooth.breach import Breaches, Kind
from coordlog.smooth.config import Config
from coordlog.smooth.counted import BudgetSpentError
from coordlog.smooth.ease import grid_for
from coordlog.smooth.feasibility import Checker
from coordlog.smooth.judge import Judge
from coordlog.smooth.knots import Knots, clean
from coordlog.smooth.limits import Limits
from coordlog.smooth.local import local
from coordlog.smooth.paper import paper
from coordlog.smooth.problem import Candidate, Problem
from coordlog.smooth.result import KEPT_RAW, PARTLY, RAW_INFEASIBLE, SMOOTHED, Result, Violation
from coordlog.smooth.shared import shared

_METHODS = {"local": local, "shared": shared, "paper": paper}


def smooth(
    time: ArrayLike,
    q: ArrayLike,
    checker: Checker,
    *,
    limits: Limits | None = None,
    continuous: Sequence[int] = (),
    joints: Sequence[str] = (),
    **options: Any,
) -> Result:
    """Smooth a joint path under a checker and limits; nothing unproven is returned.

        result = smooth(time, q, checker, cutoff=3.0, clearance=0.005)
        if result.status == "smoothed":
            command = result.spline(t)          # also result.spline(t, 1), result.spline.ppoly, result.path()

    Args:
        time: Sample times, shape (n,): seconds as floats, datetime64 or timedelta64.
        q: Joint positions [rad, m for slides], shape (n, n_j), columns from the base to the tip;
            a NaN or masked entry is a missing sample of that joint.
        checker: Decides which configurations are allowed, see `coordlog.smooth.feasibility`.
        limits: Range, speed and acceleration of the joints.
        continuous: Columns of joints that turn without end; their angles are unwrapped first.
        joints: Names for the columns, for the reason.
        **options: Fields of `coordlog.smooth.config.Config`: method, cutoff, max_deviation,
        clearance, ends, dense,
            certify, budget.

    Returns:
        The path with its status: smoothed, partly, kept_raw or raw_infeasible.

    Raises:
        SpecError: if samples, limits, velocities or the checker's answers have a wrong shape or
            value.
        ConfigError: if an option is unknown or out of range, or a certificate is wanted of a
            checker without distances.
    """
    began, config = process_time(), Config.of(**options)
    knots = clean(time, q, continuous=continuous, joints=joints)
    if len(joints) not in (0, knots.position.shape[1]):
        raise SpecError(f"joints: expected {knots.position.shape[1]} names, got {len(joints)}")
    problem = _problem(knots, checker, limits or Limits(), config)
    best, spent = _search(problem)
    names = joints or [f"joint {i}" for i in range(knots.position.shape[1])]
    status, reason, violation, best = _verdict(problem, best, spent, names)
    return Result(
        status=PARTLY if status == SMOOTHED and not knots.sound else status,
        reason="; ".join([*([reason] if reason else []), *knots.notes]),
        violation=violation,
        certified=best.proof.certified,
        spline=best.spline,
        raw=problem.raw,
        knots=knots,
        weight=best.weight,
        lam=best.lam,
        ease=best.ease,
        checks=problem.judge.asked.checks,
        slacks=problem.judge.asked.slacks,
        config=config,
        cpu=process_time() - began,
    )


def _problem(knots: Knots, checker: Checker, limits: Limits, config: Config) -> Problem:
    grid = grid_for(knots.time, config)
    velocity = np.zeros((2, knots.position.shape[1])) if config.clamped else None
    raw = grid.fit(knots.position, lam=0.0, weight=knots.weight, velocity=velocity)
    return Problem(
        knots, raw, grid, velocity, Judge(checker, knots, raw, limits=limits, config=config), config
    )


def _search(problem: Problem) -> tuple[Candidate | None, bool]:
    """The last candidate that a method proves, each being smoother than the one before.

    And whether the budget ran out.
    """
    best, asked = None, problem.judge.asked
    asked.budget = problem.config.budget
    try:
        for best in _METHODS[problem.config.method](problem):  # noqa: B007  the last one is wanted
            pass
        return best, False
    except BudgetSpentError:
        return best, True
    finally:
        asked.budget = None  # the verdict is owed in any case


def _verdict(
    problem: Problem, best: Candidate | None, spent: bool, names: Sequence[str]
) -> tuple[str, str, Violation | None, Candidate]:
    """Status, reason, violation and the path to return."""
    if best is None:
        return _kept(problem, spent, names)
    excused = best.proof.excused
    if len(excused):
        violation = _worst(problem, excused, names)
        if _unsafe(problem, best.spline, excused):
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
    raw = [name for name, lam in zip(names, best.lam, strict=True) if lam == 0.0]
    if raw:
        return (
            PARTLY,
            f"left as in the log, for nothing smoother was free: {', '.join(raw)}",
            None,
            best,
        )
    return SMOOTHED, "", None, best


def _kept(
    problem: Problem, spent: bool, names: Sequence[str]
) -> tuple[str, str, Violation | None, Candidate]:
    """The verdict where no candidate was proven: the raw path, and whether that is free."""
    raw, n_j = problem.raw, problem.knots.position.shape[1]
    failed, proof = problem.judge.failed, problem.judge.survey(problem.raw)
    kept = Candidate(raw, np.zeros(n_j), problem.knots.weight, proof, problem.ease)
    if len(proof.found) and _unsafe(problem, raw, proof.found):
        violation = _worst(problem, proof.found, names)
        return (
            RAW_INFEASIBLE,
            f"the log itself breaks a rule, and no path was found that does not: {violation}",
            violation,
            kept,
        )
    if spent:
        return (
            KEPT_RAW,
            f"the checker was asked about {problem.config.budget} configurations without a proof",
            None,
            kept,
        )
    failure = _worst(problem, failed if len(failed) else proof.found, names)
    return KEPT_RAW, f"no smoother path could be proven: {failure}", failure, kept


def _unsafe(problem: Problem, path: Path, found: Breaches) -> bool:
    return bool((found.kind == Kind.RANGE).any()) or problem.judge.collides(path, found)


def _worst(problem: Problem, found: Breaches, names: Sequence[str]) -> Violation:
    """The deepest breach of the gravest kind."""
    i = int(np.lexsort((-found.depth, found.kind))[0])
    kind, what = Kind(int(found.kind[i])), int(found.what[i])
    text = (
        problem.judge.asked.describe(what)
        if kind in (Kind.CONTACT, Kind.UNPROVEN, Kind.MOTION)
        else names[what]
    )
    return Violation(kind.name.lower(), float(found.time[i]), text, float(found.depth[i]))
