"""Tests for rules about motion, for longer soft ends, and for what a path asks of the servos: laws
that hold whatever the robot."""

from __future__ import annotations

import numpy as np
import pytest

from coordlog.errors import SpecError
from coordlog.kinematics.inverse_dynamics import Load
from coordlog.smooth import Limits, Unobstructed, Verdict, fit, metrics, smooth
from coordlog.smooth.blending import BLEND, LONGER_BLENDS
from coordlog.smooth.metrics import PathLoad


def wave(n=120, *, noise=0.02):
    time = np.arange(n) * 0.04
    return time, np.stack([np.sin(time), np.cos(2 * time)], axis=1) + noise * np.random.default_rng(
        0
    ).normal(size=(n, 2))


class Moving(Unobstructed):
    """Nothing to hit; a rule about motion, `short` (n,): by how many metres it is broken."""

    def __init__(self, short):
        super().__init__(2)
        self.short, self.asked = short, []

    def moving(self, time, q, velocity, acceleration):
        self.asked.append((time, q, velocity, acceleration))
        short = self.short(time, q, velocity, acceleration)
        return Verdict(short <= 0.0, np.maximum(short, 0.0), np.where(short > 0.0, 0, -1))

    def describe(self, what):
        return "the cup and its rim"


def test_a_rule_about_motion_is_asked_about_the_path_that_is_returned():
    time, q = wave()
    checker = Moving(lambda time, q, velocity, acceleration: np.full(len(time), -1.0))
    result = smooth(time, q, checker)
    assert result.status == "smoothed"
    ((t, position, velocity, acceleration),) = checker.asked
    assert (t == time).all()
    for nu, values in enumerate((position, velocity, acceleration)):
        assert values == pytest.approx(result.spline(time, nu), abs=1e-9)


def test_a_path_is_drawn_on_until_it_keeps_a_rule_about_motion():
    """The rule: at the ninth knot no further than 0.01 rad from where the log is, which the
    smoothest path breaks."""
    time, q = wave()
    free = smooth(time, q, Unobstructed(2))
    checker = Moving(
        lambda time, at, velocity, acceleration: np.where(
            time == time[8], abs(at - q).max(axis=1) - 0.01, -1.0
        )
    )
    result = smooth(time, q, checker)
    assert abs(free.spline.position - q)[8].max() > 0.02
    assert result.status == "smoothed"
    assert abs(result.spline.position - q)[8].max() <= 0.01


def test_a_rule_that_the_log_breaks_as_badly_makes_it_partly_and_is_named():
    time, q = wave()
    result = smooth(
        time,
        q,
        Moving(lambda time, q, velocity, acceleration: np.where(time == time[60], 0.003, -1.0)),
    )
    assert result.status == "partly"
    assert "the cup and its rim" in result.reason
    assert "0.003 m too close while moving" in result.reason
    assert result.violation.kind == "motion"
    assert result.after.jerk < 0.1 * result.before.jerk


def test_a_rule_that_only_the_log_keeps_leaves_the_log():
    time, q = wave()
    result = smooth(
        time,
        q,
        Moving(lambda time, at, velocity, acceleration: abs(at - q).max(axis=1) - 1e-12),
        method="shared",
    )
    assert result.status == "kept_raw"
    assert "the cup and its rim" in result.reason
    assert (result.spline.position == q).all()


def test_an_answer_of_the_wrong_shape_is_refused():
    time, q = wave()
    checker = Unobstructed(2)
    checker.moving = lambda time, q, velocity, acceleration: Verdict(
        np.ones(3, bool), np.zeros(3), np.full(3, -1)
    )
    with pytest.raises(SpecError, match=r"checker.moving: expected three arrays of shape \(120,\)"):
        smooth(time, q, checker)


def test_soft_ends_grow_longer_where_the_pace_allows():
    """A longer ease is smoother and faster in the middle.

    No joint may be faster than its pace for it.
    """
    time, q = wave()
    short = smooth(time, q, Unobstructed(2), ends="soft", limits=Limits(nominal_speed=1e-6))
    free = smooth(time, q, Unobstructed(2), ends="soft")
    assert (short.blend, free.blend) == (BLEND, LONGER_BLENDS[0])
    assert free.after.jerk < 0.95 * short.after.jerk
    fastest = {
        result.blend: abs(result.spline(np.linspace(0.0, time[-1], 999), 1)).max()
        for result in (short, free)
    }
    between = 0.5 * (fastest[BLEND] + fastest[LONGER_BLENDS[0]])
    paced = smooth(time, q, Unobstructed(2), ends="soft", limits=Limits(nominal_speed=between))
    assert BLEND < paced.blend < LONGER_BLENDS[0]
    assert abs(paced.spline(np.linspace(0.0, time[-1], 999), 1)).max() <= between
    assert smooth(time, q, Unobstructed(2), ends="rest").blend == BLEND
    with pytest.raises(SpecError, match=r"limits.nominal_speed: expected one number or 2"):
        smooth(time, q, Unobstructed(2), limits=Limits(nominal_speed=[1.0, 2.0, 3.0]))


def test_longer_soft_ends_keep_every_rule_too():
    """A window that the path with short ends passes and those with longer ends do not."""
    time, q = wave()
    limits = Limits(
        upper=smooth(
            time, q, Unobstructed(2), ends="soft", limits=Limits(nominal_speed=1e-6)
        ).spline.position.max(axis=0)
    )
    result = smooth(time, q, Unobstructed(2), ends="soft", limits=limits)
    assert (result.spline(np.linspace(0.0, time[-1], 999)) <= limits.upper + 1e-3).all()
    assert result.certified


def load_of(path, torque):
    """Figures where torques are any function of the motion, and the balance is what is left of 1
    m/s²."""

    def inverse(time, q, velocity, acceleration):
        return Load(torque(q, velocity, acceleration), 1.0 - abs(acceleration).max(axis=1))

    return PathLoad.of(path, inverse, 0.04)


def test_where_torque_is_acceleration_its_rate_is_the_jerk():
    time, q = wave()
    load = load_of(fit(time, q, lam=0.0), lambda q, velocity, acceleration: acceleration)
    assert load.rate == pytest.approx(metrics.jerk(q, 0.04) * np.sqrt(len(q) / (len(q) + 1)))
    assert load.peak == pytest.approx(
        abs(np.diff(np.pad(q, ((2, 2), (0, 0)), mode="edge"), 2, axis=0)).max() / 0.04**2
    )
    assert load.balance == pytest.approx(1.0 - load.peak)
    assert load.floor == 0.0


def test_no_path_between_the_same_ends_has_a_smaller_rate_than_the_floor():
    time, q = wave()
    paths = [fit(time, q, lam=lam) for lam in (0.0, 1e-3, 1.0)] + [
        smooth(time, q, Unobstructed(2), ends="soft").spline
    ]
    loads = [load_of(path, lambda q, velocity, acceleration: np.sin(q)) for path in paths]
    assert {round(load.floor, 9) for load in loads} == {round(loads[0].floor, 9)}
    assert 0.0 < loads[0].floor < min(load.rate for load in loads)
    steady = fit(time, np.linspace(0.0, 1.0, len(time))[:, None] * [1.0, -2.0], lam=0.0)
    straight = load_of(steady, lambda q, velocity, acceleration: q)
    assert straight.rate == pytest.approx(
        straight.floor, rel=0.02
    )  # reached, but for the rest ahead and behind
