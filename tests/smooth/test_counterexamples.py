"""Three small problems on which the paper's assumption, that less smoothing is always safer, is
false."""

import numpy as np
import pytest

from coordlog.smooth import Limits, Verdict, fit, smooth
from coordlog.smooth.cutoff import lam_from_p
from coordlog.smooth.metrics import jerk


class Slacks:
    """A checker of knots from a function (time, q) → slacks (n, P).

    No distances between samples.
    """

    def __init__(self, slack):
        self.slack_of = slack

    def check(self, time, q, clearance):
        return Verdict.from_slack(self.slack_of(time, q) - clearance)

    def describe(self, what):
        return f"rule {what}"


# One: a bump whose way to its chord leads through a forbidden band. Free is p in [0, 1.5e-5] and in
# [2.4e-4, 1].
TIME = np.arange(41.0)
BUMP = np.sin(np.pi * TIME / 40)[:, None]


def band(time, q):
    inside = (time >= 15) & (time <= 25)
    return np.where(inside[:, None], np.maximum(0.3 - q, q - 0.8), 1.0)


def free(p):
    spline = fit(TIME, BUMP, lam=lam_from_p(p, 1.0))
    return bool((band(TIME, spline(TIME)) >= 0.0).all())


def test_the_feasible_p_are_not_an_interval():
    assert [free(p) for p in (1e-9, 1.4e-5, 3e-5, 1e-4, 2.2e-4, 2.5e-4, 0.01, 1.0)] == [
        True,
        True,
        False,
        False,
        False,
        True,
        True,
        True,
    ]


def test_bisection_on_p_misses_the_line_and_local_does_not():
    knots_only = {"dense": 1, "certify": False, "ends": "natural"}
    paper = smooth(TIME, BUMP, Slacks(band), method="paper", **knots_only)
    assert paper.status == "smoothed"
    assert paper.p[0] == pytest.approx(2.46e-4, rel=0.02)
    local = smooth(TIME, BUMP, Slacks(band), cutoff=0.001, **knots_only)
    assert local.status == "smoothed"
    assert abs(local.spline(TIME)).max() < 0.3
    assert local.after.acceleration < 0.5 * paper.after.acceleration


# Two: a step whose knots all keep a limit that the curve through them does not.
STEP_TIME = np.arange(12.0)
STEP = np.repeat([0.0, 1.0], 6)[:, None]
LIMITS = Limits(upper=1.05, tolerance=0.0)


def overshoot(p):
    spline = fit(STEP_TIME, STEP, lam=lam_from_p(p, 1.0))
    return spline(np.linspace(0.0, 11.0, 2001)).max()


def test_the_interpolant_breaks_a_limit_that_every_knot_keeps():
    assert overshoot(1.0) == pytest.approx(1.108, abs=1e-3)
    assert overshoot(0.99) > 1.05
    assert overshoot(0.9) < 1.05


@pytest.mark.parametrize("method", ["local", "shared", "paper"])
def test_limits_hold_between_knots(method):
    result = smooth(
        STEP_TIME,
        STEP,
        Slacks(lambda time, q: np.ones_like(q)),
        limits=LIMITS,
        method=method,
        certify=False,
    )
    assert result.status == "smoothed"
    assert result.spline(np.linspace(0.0, 11.0, 5001)).max() <= 1.05


def test_a_cut_off_too_high_leaves_the_overshoot_of_the_log():
    result = smooth(
        STEP_TIME,
        STEP,
        Slacks(lambda time, q: np.ones_like(q)),
        limits=LIMITS,
        certify=False,
        cutoff=0.45,
        ends="natural",
    )
    assert result.status == "smoothed"  # the samples are moved inside where the path overshoots
    assert result.spline(np.linspace(0.0, 11.0, 5001)).max() <= 1.05


# Three: two joints that must cancel.
PAIR_TIME = np.linspace(0.0, 3.0, 151)
PAIR = np.sin(4.0 * PAIR_TIME)[:, None] * [1.0, -1.0] + 0.03 * np.random.default_rng(0).normal(
    size=(151, 1)
) * [1.0, -1.0]


def cancel(time, q):
    return 1e-3 - abs(q.sum(axis=1, keepdims=True))


def test_smoothing_one_joint_alone_breaks_their_bond():
    alone = PAIR.copy()
    alone[:, 0] = fit(PAIR_TIME, PAIR[:, :1], lam=1e3).position[:, 0]
    assert abs(alone.sum(axis=1)).max() > 1.0
    together = fit(PAIR_TIME, PAIR, lam=1e3).position
    assert abs(together.sum(axis=1)).max() < 1e-12


def test_joint_by_joint_stalls_and_one_cut_off_does_not():
    results = {
        method: smooth(PAIR_TIME, PAIR, Slacks(cancel), method=method, certify=False)
        for method in ("paper", "shared", "local")
    }
    dt = PAIR_TIME[1]
    for method in ("shared", "local"):
        assert results[method].status == "smoothed"
        assert abs(results[method].spline(PAIR_TIME).sum(axis=1)).max() < 1e-12
        assert results[method].after.jerk < 0.01 * results["paper"].after.jerk
    assert jerk(results["paper"].spline(PAIR_TIME), dt) > 0.5 * jerk(PAIR, dt)
