"""What is returned as proven is free, checked by code that shares nothing with the search or its
checker."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coordlog.smooth import Limits, fit, smooth
from tests.smooth.planar import noisy_log

GENERATED = {"max_examples": 12, "deadline": None, "derandomize": True}


def gaps(arm, time, q):
    """Smallest distance to a disc and between links of each configuration, in complex numbers."""
    base = arm.sway * np.sin(5.0 * time)[:, None] + 0j
    joints = np.hstack(
        [base, base + np.cumsum(arm.lengths * np.exp(1j * np.cumsum(q, axis=1)), axis=1)]
    )
    links = [(joints[:, i], joints[:, i + 1]) for i in range(q.shape[1])]
    discs = [
        point_gap(complex(x, y), a, b) - r - arm.radius for x, y, r in arm.discs for a, b in links
    ]
    pairs = [
        link_gap(*links[i], *links[k]) - 2 * arm.radius
        for i in range(len(links))
        for k in range(i + 2, len(links))
    ]
    return np.min(discs + pairs, axis=0)


def point_gap(point, a, b):
    z = (point - a) / (b - a)
    return abs(z - np.minimum(np.maximum(z.real, 0.0), 1.0)) * abs(b - a)


def link_gap(a, b, c, d):
    one, other = (c - a) / (b - a), (d - a) / (b - a)  # c and d as seen from a link laid on [0, 1]
    ends = np.min(
        [point_gap(a, c, d), point_gap(b, c, d), point_gap(c, a, b), point_gap(d, a, b)], axis=0
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        cross = one.real + (other - one).real * one.imag / (one.imag - other.imag)
    return np.where((one.imag * other.imag < 0) & (cross >= 0.0) & (cross <= 1.0), 0.0, ends)


def interpolant(time, q, method):
    """The raw path, as the search sees it."""
    return fit(time, q, lam=0.0, velocity=None if method == "paper" else np.zeros((2, q.shape[1])))


def bending(spline):
    c, h = spline.coefficients, np.diff(spline.time)[:, None]
    start, stop = 2 * c[1], 6 * c[0] * h + 2 * c[1]
    return float((h * (start**2 + start * stop + stop**2) / 3).sum())


def sixteen_per_knot(time, seed):
    """Times that no grid of the search contains."""
    return np.sort(np.random.default_rng(seed).uniform(time[0], time[-1], 16 * len(time)))


@pytest.mark.parametrize("method", ["local", "shared", "paper"])
@settings(**GENERATED)
@given(
    seed=st.integers(0, 2**31),
    noise=st.floats(0.0, 0.04),
    margin=st.floats(0.001, 0.02),
    sway=st.sampled_from([0.0, 0.002]),
)
def test_returned_paths_are_as_safe_as_their_status_says(method, seed, noise, margin, sway):
    time, q, arm = noisy_log(
        np.random.default_rng(seed), n=50, links=5, noise=noise, margin=margin, sway=sway
    )
    result = smooth(time, q, arm, method=method)
    when = sixteen_per_knot(time, seed)
    smallest = gaps(arm, when, result.spline(when)).min()
    if result.status in ("smoothed", "partly"):
        assert result.certified
        assert smallest > 0.0
    elif result.status == "kept_raw":
        np.testing.assert_array_equal(result.spline.position, q)
        assert smallest > -1e-6
    else:  # never worse than the log
        assert smallest >= gaps(arm, when, interpolant(time, q, method)(when)).min() - 5e-4
    assert result.after.end_error < 1e-12
    if method != "paper":  # the bending energy of a fit is never above the interpolant's
        assert bending(result.spline) <= bending(interpolant(time, q, method)) * (1.0 + 1e-9)


@settings(**GENERATED)
@given(seed=st.integers(0, 2**31), clearance=st.floats(0.0, 0.02))
def test_clearance_asked_is_clearance_kept_or_said(seed, clearance):
    time, q, arm = noisy_log(np.random.default_rng(seed), n=50, links=5, margin=0.01)
    result = smooth(time, q, arm, clearance=clearance)
    when = sixteen_per_knot(time, seed)
    smallest = gaps(arm, when, result.spline(when)).min()
    if result.status == "smoothed":
        assert smallest > clearance
    elif result.status == "partly":
        assert smallest > 0.0
        assert (result.violation.kind, result.certified) == ("contact", True)
        fine = np.linspace(time[0], time[-1], 20_000)
        raw = gaps(arm, fine, interpolant(time, q, "local")(fine)).min()
        assert raw < clearance
        assert smallest > raw - 5e-4


@settings(**GENERATED)
@given(seed=st.integers(0, 2**31), deviation=st.floats(0.01, 0.3))
def test_deviation_and_limits_hold_between_samples(seed, deviation):
    time, q, arm = noisy_log(np.random.default_rng(seed), n=60, links=4, discs=2)
    limits = Limits(
        lower=q.min(axis=0) - 1e-3,
        upper=q.max(axis=0),
        speed=1.2 * abs(np.diff(q, axis=0)).max() / time[1],
        tolerance=0.0,
    )
    result = smooth(time, q, arm, limits=limits, max_deviation=deviation)
    fine = np.linspace(time[0], time[-1], 5000)
    if result.status == "smoothed":
        assert abs(result.spline(time) - q).max() <= deviation + 1e-12
        assert (result.spline(fine) <= limits.upper + 1e-9).all()
        assert (result.spline(fine) >= limits.lower - 1e-9).all()
        assert abs(result.spline(fine, 1)).max() <= limits.speed
        assert result.after.jerk < result.before.jerk
