"""Samples made fit to be fitted: what is counted, what is refused, and what is measured."""

from datetime import datetime, timedelta

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from coordlog.errors import CoordlogError, SpecError
from coordlog.smooth import Limits, Unobstructed, smooth
from coordlog.smooth.knots import clean
from coordlog.smooth.times import seconds, spacing


def log(n=200, seed=0):
    time = np.arange(n) * 0.01
    q = np.stack([np.sin(3 * time), np.cos(2 * time)], axis=1)
    return time, q + np.random.default_rng(seed).normal(0.0, 0.01, (n, 2))


def two_publishers(n=200):
    time, q = log(n)
    q[::2, 0] = q[1::2, 1] = np.nan
    return time, q


def farthest(result, time, q):
    """Distance to every finite sample, by scipy and not by the code under test."""
    path = result.spline
    return np.nanmax(abs(CubicHermiteSpline(path.time, path.position, path.velocity)(time) - q))


def test_good_samples_pass_unchanged():
    time, q = np.array([0.0, 0.1, 0.3]), np.arange(6.0).reshape(3, 2)
    knots = clean(time, q)
    np.testing.assert_array_equal(knots.time, time)
    np.testing.assert_array_equal(knots.position, q)
    np.testing.assert_array_equal(knots.weight, [np.inf, 1.0, np.inf])
    assert (knots.notes, knots.sound) == ((), True)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.0, 0.7), st.integers(0, 2))
def test_every_finite_sample_is_as_near_as_is_said(seed, missing, repeated):
    rng = np.random.default_rng(seed)
    time, q = log(60, seed)
    time = np.sort(
        np.append(time + rng.uniform(0.0, 0.004, 60), time[rng.integers(0, 60, repeated)])
    )
    q = np.concatenate([q, q[:repeated]])
    q[rng.uniform(size=q.shape) < missing] = np.nan
    try:
        result = smooth(time, q, Unobstructed(2), max_deviation=0.05)
    except CoordlogError:
        return  # refused in a sentence
    away = farthest(result, time, q)
    assert away <= result.after.max_deviation + 1e-9
    assert result.deviation.max() == pytest.approx(result.after.max_deviation)
    assert away <= 0.05 + 1e-9 or result.status not in ("smoothed", "partly")
    if np.isnan(q).any():
        assert "has samples at" in result.reason


def test_two_publishers_each_keep_their_own_samples():
    time, q = two_publishers()
    result = smooth(time, q, Unobstructed(2), max_deviation=0.05)
    assert (result.status, result.certified) == ("partly", True)  # each is held for one row
    assert "joint 0 has samples at 100 of 200 times" in result.reason
    assert farthest(result, time, q) <= 0.05
    assert result.after.jerk < 0.1 * result.before.jerk


def test_a_joint_between_its_samples_is_the_cubic_through_them():
    time, q = two_publishers()
    q[[0, -1]] = log()[1][[0, -1]]
    knots = clean(time, q)
    for joint in range(2):
        own = np.isfinite(q[:, joint])
        through = CubicSpline(time[own], q[own, joint], bc_type="natural")
        np.testing.assert_allclose(knots.position[:, joint], through(time), atol=1e-9)


def test_who_publishes_which_joint_does_not_matter():
    time, q = two_publishers()
    one = smooth(time, q, Unobstructed(2), cutoff=3.0)
    other = smooth(time, q[:, ::-1], Unobstructed(2), cutoff=3.0)
    np.testing.assert_array_equal(one.spline.position, other.spline.position[:, ::-1])


@pytest.mark.parametrize("scale", [1e-3, 1.0, 60.0])
def test_a_unit_of_time_changes_nothing_but_the_unit(scale):
    time, q = two_publishers()
    one = smooth(time, q, Unobstructed(2), cutoff=3.0)
    other = smooth(scale * time, q, Unobstructed(2), cutoff=3.0 / scale)
    np.testing.assert_allclose(one.spline.position, other.spline.position, atol=1e-7)


def test_publishers_taking_turns_are_cut_off_where_it_was_asked():
    once = np.arange(0.0, 10.0, 0.01)
    time = np.sort(np.r_[once, once + 2e-4])
    tone = np.sin(2 * np.pi * 3.0 * time)[:, None]
    result = smooth(time, tone, Unobstructed(1), cutoff=3.0)
    assert result.knots.unit == pytest.approx(0.005, rel=0.01)
    middle = np.linspace(4.0, 6.0, 2001)
    passed = (2.0 * result.spline(middle)[:, 0] * np.sin(2 * np.pi * 3.0 * middle)).mean()
    assert passed == pytest.approx(0.5, abs=0.02)  # half the amplitude at the cut-off
    assert result.checks < 4 * len(time)


@pytest.mark.parametrize("gap", [3600.0, 86400.0, 1.75e9])
def test_a_gap_is_named_and_costs_nothing(gap):
    time, q = log()
    time[100:] += gap
    with pytest.raises(SpecError, match="between samples 99 and 100, where the usual spacing is 0"):
        smooth(time, q, Unobstructed(2))


def test_a_short_gap_is_interpolated_and_named():
    time, q = log()
    time[100:] += 0.4
    result = smooth(time, q, Unobstructed(2), max_deviation=0.05)
    assert (result.status, result.certified) == ("partly", True)
    assert "a gap of 0.41 s between samples 99 and 100" in result.reason


def test_a_joint_without_samples_is_refused_by_name():
    time, q = log()
    lost = np.c_[q, np.full(200, np.nan)]
    lost[[0, -1], 2] = 0.0
    with pytest.raises(SpecError, match="wrist has samples at 2 of 200 times, and none for"):
        smooth(time, lost, Unobstructed(3), joints=("hip", "elbow", "wrist"))


def test_samples_at_the_same_time_become_their_mean():
    time = np.array([0.0, 1.0, 1.0, 2.0, 3.0])
    knots = clean(time, np.array([[0.0], [1.0], [2.0], [4.0], [5.0]]))
    np.testing.assert_allclose(knots.time, [0.0, 1.0, 2.0, 3.0])
    np.testing.assert_allclose(knots.position[:, 0], [0.0, 1.5, 4.0, 5.0])
    np.testing.assert_array_equal(knots.weight, [np.inf, 2.0, 1.0, np.inf])
    assert knots.notes == ("2 of 5 samples share 1 times and were averaged there",)
    result = smooth(time, [[0.0], [1.0], [2.0], [4.0], [5.0]], Unobstructed(1), cutoff=1e3)
    assert result.after.max_deviation >= 0.5 - 1e-9


def test_merging_leaves_the_ends_alone():
    time = np.array([0.0, 1e-9, 1.0, 2.0, 3.0])
    knots = clean(time, np.array([[0.0], [9.0], [1.0], [2.0], [3.0]]))
    np.testing.assert_array_equal(knots.time, [0.0, 1.0, 2.0, 3.0])
    np.testing.assert_array_equal(knots.position[:, 0], [0.0, 1.0, 2.0, 3.0])


def test_many_samples_of_one_time_are_refused_with_counts():
    time, q = log()
    with pytest.raises(SpecError, match="200 of 200 samples share 20 times, and"):
        clean(np.round(time - 0.045, 1) + 0.1, q)
    repeated = clean(np.repeat(time, 3), np.repeat(q, 3, axis=0))  # the same, said three times
    assert repeated.notes == ("600 of 600 samples share 200 times and were averaged there",)
    np.testing.assert_allclose(repeated.position, q)


def test_float32_stamps_are_refused_however_they_come():
    time, q = log(1000)
    coarse = (50.0 * time + 1.75e9).astype(np.float32)
    for stamps in (coarse, coarse.astype(float)):
        with pytest.raises(SpecError, match="995 of 1000 samples share a time with another"):
            clean(stamps, q)
    fine = clean(time.astype(np.float32), q)
    assert len(fine.time) == 1000
    with pytest.raises(SpecError, match="float16 numbers, which lie"):
        clean((np.arange(200) * 0.1).astype(np.float16), log(200)[1])
    halves = clean(np.arange(200) * 0.5, log(200)[1])  # few digits, and nothing rounded
    assert len(halves.time) == 200


def test_microseconds_from_zero_on_are_no_seconds():
    time, q = log(200)
    with pytest.raises(SpecError, match="cannot be seconds"):
        clean(time * 1e6, q)


def test_times_are_what_they_are():
    time, _ = log(50)
    span = np.round(time * 1e9).astype("timedelta64[ns]")
    epoch = datetime(2026, 1, 2, 3, 4, 5)
    for given_as in (
        span,
        np.datetime64("2026-01-02T03:04:05") + span,
        [epoch + timedelta(seconds=each) for each in time.tolist()],
        [timedelta(seconds=each) for each in time.tolist()],
        np.ma.masked_invalid(time),
    ):
        np.testing.assert_allclose(seconds(given_as), time, atol=1e-12)


def test_masked_entries_are_missing():
    time, q = log()
    masked = np.ma.array(q.copy(), mask=np.zeros_like(q, bool))
    masked[50:53, 0] = 99.0
    masked.mask[50:53, 0] = True
    knots = clean(time, masked)
    assert abs(knots.position[50:53, 0] - q[50:53, 0]).max() < 0.1
    assert knots.notes == (
        "joint 0 has samples at 197 of 200 times; it is interpolated at the others",
    )


def test_a_joint_that_wraps_is_refused_or_unwrapped():
    time, _ = log()
    turns = np.stack([4.0 * time, np.sin(time)], axis=1)
    wrapped = (turns + np.pi) % (2.0 * np.pi) - np.pi
    with pytest.raises(SpecError, match=r"hip steps by 6.24 rad, .* from sample 78 to 79"):
        smooth(time, wrapped, Unobstructed(2), joints=("hip", "knee"))
    result = smooth(time, wrapped, Unobstructed(2), continuous=[0], cutoff=3.0)
    np.testing.assert_allclose(result.spline.position[:, 0] - turns[:, 0], 0.0, atol=0.2)
    assert abs(result.spline(time, 1)[:, 0]).max() < 8.0


def test_way_points_far_apart_are_no_wrap():
    for q in ([[-3.0], [3.0]], [[-3.0], [3.0], [-3.0]], [[-2.0], [2.0], [0.5], [-1.0]]):
        assert len(clean(np.arange(float(len(q))), q).time) == len(q)


def test_a_range_of_a_tenth_of_a_millimetre_is_kept():
    time, _ = log()
    q = 5e-5 + 6e-5 * np.sin(3.0 * time)[:, None]
    limits = Limits(lower=0.0, upper=1e-4)
    result = smooth(time, np.clip(q, 0.0, 1e-4), Unobstructed(1), limits=limits, cutoff=3.0)
    fine = result.spline(np.linspace(0.0, 1.99, 4001))
    assert fine.max() <= 1.01e-4 + 1e-12
    assert fine.min() >= -1e-6 - 1e-12


def test_the_deviation_of_each_joint_is_in_its_own_unit():
    time, q = log()
    result = smooth(time, q * [1.0, 1e-3], Unobstructed(2), max_deviation=[0.05, 2e-5])
    assert result.status == "smoothed"
    assert (result.deviation <= [0.05, 2e-5]).all()
    assert result.deviation[1] > 0.0


def test_the_spacing_is_a_mean_without_the_gaps():
    assert spacing(np.array([0.0, 2.0])) == 2.0
    assert spacing(np.r_[np.arange(10.0), 1e6 + np.arange(10.0)]) == 1.0
    assert spacing(np.cumsum(np.tile([0.1, 9.9], 50))) == pytest.approx(5.0, rel=0.02)


@pytest.mark.parametrize(
    ("time", "q", "message"),
    [
        ([0.0], [[1.0]], "at least two samples, got 1"),
        ([], np.zeros((0, 1)), "at least two samples, got 0"),
        ([0.0, 1.0], [1.0, 2.0], r"expected shape \(n, n_j\)"),
        ([0.0, 1.0, 2.0], [[1.0], [2.0]], r"expected shape \(n, n_j\)"),
        ([0.0, 1.0], np.zeros((2, 0)), r"expected shape \(n, n_j\)"),
        ([0.0, np.nan, 2.0], np.zeros((3, 1)), "expected finite numbers, but 1 of 3"),
        ([0.0, 1.0, 2.0], [[0.0], [np.inf], [0.0]], "only NaN in q is read as a missing sample"),
        ([0.0, 2.0, 1.0], np.zeros((3, 1)), "sample 2 is before the one ahead"),
        ([0, 1, 2], np.zeros((3, 1)), "integers have no unit; pass seconds as floats"),
        (np.arange(3) * 10**7 + 1.7e18, np.zeros((3, 1)), "which cannot be seconds"),
        (np.arange(3) * 10.0 + 1.7e12, np.zeros((3, 1)), "which cannot be seconds"),
        (np.arange(3) * 1e4 + 1.7e15, np.zeros((3, 1)), "which cannot be seconds"),
        (np.arange(3) * 1e-310, np.zeros((3, 1)), "which cannot be seconds"),
        (np.array(["2026", "NaT"], "M8[s]"), np.zeros((2, 1)), "1 times are NaT"),
        (["a", "b"], np.zeros((2, 1)), "expected seconds as floats"),
        ([0.0, 1.0], [["a"], ["b"]], "q: expected numbers"),
        (np.ma.array([0.0, 1.0], mask=[0, 1]), np.zeros((2, 1)), "1 of 2 times are masked"),
        ([0.0, 1.0], [[np.nan], [0.0]], "at least two samples, got 1"),
        ([0.0, 1.0], [[0.0, 0.0], [0.0, np.nan]], "joint 1 has 1 samples, expected at least two"),
        ([1.0, 1.0, 1.0], np.zeros((3, 1)), "all are the same"),
    ],
)
def test_bad_samples_are_refused_in_a_sentence(time, q, message):
    with pytest.raises(SpecError, match=message):
        clean(time, q)
