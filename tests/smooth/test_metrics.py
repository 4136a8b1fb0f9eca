"""Figures of smoothness on motions whose figures are known."""

import numpy as np
import pytest

from coordlog.smooth import fit, metrics
from coordlog.smooth.knots import clean

DT = 0.01


def min_jerk(n=101):
    x = np.linspace(0.0, 1.0, n)[:, None]
    return x**3 * (10 - 15 * x + 6 * x**2)


def test_jerk_and_acceleration_of_a_minimum_jerk_motion():
    # ∫ q'''² dt = 720 and ∫ q''² dt = 120 / 7 over one second; sums over steps converge to them.
    q = min_jerk(1001)
    assert metrics.jerk(q, 1e-3) == pytest.approx(np.sqrt(720.0), rel=0.01)
    assert metrics.acceleration(q, 1e-3) == pytest.approx(np.sqrt(120.0 / 7.0), rel=0.01)


def test_log_dimensionless_jerk_of_a_minimum_jerk_motion():
    assert metrics.log_dimensionless_jerk(min_jerk(1001), 1e-3) == pytest.approx(
        np.log(720.0 / 1.875**2), abs=0.01
    )
    assert metrics.log_dimensionless_jerk(np.ones((50, 2)), DT) == -np.inf


def test_jumps_at_the_ends_count():
    line = np.linspace(0.0, 1.0, 101)[:, None]
    assert np.abs(np.diff(line, 3, axis=0)).max() < 1e-12
    assert metrics.jerk(line, DT) > 10 * metrics.jerk(min_jerk(), DT)


def test_sparc_of_known_profiles():
    # A minimum-jerk speed profile of one second scores -1.41 (published range of smooth reaching: -1.4 to -1.6).
    speed = metrics.speed(min_jerk(), DT)
    assert metrics.sparc(speed, DT) == pytest.approx(-1.41, abs=0.02)
    assert metrics.sparc(3.0 * speed, DT) == pytest.approx(metrics.sparc(speed, DT))
    noisy = speed * (1.0 + 0.5 * np.sin(2 * np.pi * 6.0 * DT * np.arange(100)))
    assert metrics.sparc(noisy, DT) < metrics.sparc(speed, DT) - 0.2
    assert metrics.sparc(np.zeros(10), DT) == 0.0


def test_path_length_and_torque():
    corner = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 5.0]])
    assert metrics.path_length(corner) == 6.0
    torque = np.array([[0.0, 1.0], [3.0, -3.0]])
    assert metrics.torque_peak(torque) == 3.0
    assert metrics.torque_rate(torque, 0.1) == pytest.approx(50.0)


def test_measure_puts_them_together():
    time = np.linspace(0.0, 1.0, 101)
    knots = clean(time, np.hstack([min_jerk(), 0.1 * np.sin(40 * time)[:, None]]))
    raw, flat = fit(time, knots.position, lam=0.0), fit(time, knots.position, lam=1.0)
    before, after = metrics.measure(raw, knots), metrics.measure(flat, knots)
    assert before.max_deviation < 1e-12
    assert after.max_deviation == pytest.approx(abs(flat.position - knots.position).max())
    assert max(after.end_error, before.end_error) < 1e-15
    assert before.jerk == pytest.approx(metrics.jerk(knots.position, DT))
    assert after.path_length < before.path_length
