"""From a noisy joint path to one that is smoother and proven, or the same path and the reason why
not.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import process_time
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from coordlog.smooth.blending import grid_for
from coordlog.smooth.budget import BudgetSpentError
from coordlog.smooth.config import Config
from coordlog.smooth.feasibility import Checker
from coordlog.smooth.knots import Knots, clean
from coordlog.smooth.limits import Limits
from coordlog.smooth.local import local, shared
from coordlog.smooth.paper import paper
from coordlog.smooth.problem import Candidate, Problem
from coordlog.smooth.result import PARTLY, SMOOTHED, Result
from coordlog.smooth.validator import Validator
from coordlog.smooth.verdict import Labels, verdict

_METHODS = {"local": local, "shared": shared, "paper": paper}


def smooth(
    time: ArrayLike,
    q: ArrayLike,
    checker: Checker,
    *,
    limits: Limits | None = None,
    continuous: Sequence[int] = (),
    joints: Sequence[str] = (),
    units: Sequence[str] = (),
    **options: Any,
) -> Result:
    """Smooth a joint path under a checker and limits; nothing unproven is returned.

        result = smooth(time, q, checker, cutoff=3.0, clearance=0.005)
        if result.status == "smoothed":
            command = result.spline(t)          # also result.spline(t, 1), result.path()

    Args:
        time: Sample times, shape (n,): seconds as floats, datetime64 or timedelta64.
        q: Joint positions [rad, m for slides], shape (n, n_j), columns from the base to the tip;
            a NaN or masked entry is a missing sample of that joint.
        checker: Decides which configurations are allowed, see `coordlog.smooth.feasibility`.
        limits: Range, speed and acceleration of the joints.
        continuous: Columns of joints that turn without end; their angles are unwrapped first.
        joints: Names for the columns, for the reason.
        units: Unit of each column, for the reason: "rad" (all, if not given) or "m".
        **options: Fields of `coordlog.smooth.config.Config`.

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
    problem = _problem(knots, checker, limits or Limits(), config)
    best, spent = _search(problem)
    labels = Labels.of(knots.position.shape[1], joints, units)
    status, reason, violation, best = verdict(problem, best, spent=spent, labels=labels)
    return Result(
        status=PARTLY if status == SMOOTHED and not knots.sound else status,
        reason="; ".join([*([reason] if reason else []), *knots.notes]),
        violation=violation,
        certified=best.proof.certified,
        spline=best.spline,
        reference=problem.reference,
        knots=knots,
        weight=best.weight,
        lam=best.lam,
        blend=best.blend,
        checks=problem.validator.queries.checks,
        slacks=problem.validator.queries.slacks,
        config=config,
        cpu=process_time() - began,
    )


def _problem(knots: Knots, checker: Checker, limits: Limits, config: Config) -> Problem:
    grid = grid_for(knots.time, config)
    velocity = np.zeros((2, knots.position.shape[1])) if config.clamped else None
    reference = grid.fit(knots.position, lam=0.0, weight=knots.weight, velocity=velocity)
    return Problem(
        knots,
        reference,
        grid,
        velocity,
        Validator(checker, knots, reference, limits=limits, config=config),
        config,
    )


def _search(problem: Problem) -> tuple[Candidate | None, bool]:
    """The last candidate that a method proves, each being smoother than the one before.

    And whether the budget ran out.
    """
    best, queries = None, problem.validator.queries
    queries.budget = problem.config.budget
    try:
        for best in _METHODS[problem.config.method](problem):  # noqa: B007  the last one is wanted
            pass
        return best, False
    except BudgetSpentError:
        return best, True
    finally:
        queries.budget = None  # the verdict is owed in any case
