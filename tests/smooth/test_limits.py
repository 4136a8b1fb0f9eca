"""Limits held against splines exactly."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coordlog.errors import SpecError
from coordlog.smooth import Limits, Path
from coordlog.smooth.limits import limit_violations
from coordlog.smooth.violations import Kind


def path(seed, n=7, joints=2):
    rng = np.random.default_rng(seed)
    return Path(
        np.cumsum(rng.uniform(0.2, 1.0, n)),
        rng.normal(size=(n, joints)),
        2.0 * rng.normal(size=(n, joints)),
    )


def worst(found, kind, joint):
    return found.depth[(found.kind == kind) & (found.what == joint)].max(initial=0.0)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000))
def test_no_sample_exceeds_what_is_reported_and_every_report_is_real(seed):
    spline = path(seed)
    limits = Limits(
        lower=-0.8, upper=[0.5, 1.2], speed=[1.5, 3.0], acceleration=12.0, tolerance=0.0
    )
    found = limit_violations(spline, limits.bounds(2))
    fine = np.unique(
        np.concatenate([np.linspace(spline.time[0], spline.time[-1], 4001), spline.time])
    )
    q, v = spline(fine), spline(fine, 1)
    bends = np.concatenate(
        [
            spline(spline.time, 2),
            6 * spline.ppoly.c[0] * np.diff(spline.time)[:, None] + 2 * spline.ppoly.c[1],
        ]
    )
    for joint in range(2):
        over = np.maximum(q[:, joint] - [0.5, 1.2][joint], -0.8 - q[:, joint]).max()
        assert worst(found, Kind.RANGE, joint) == pytest.approx(max(over, 0.0), abs=1e-4)
        assert worst(found, Kind.SPEED, joint) == pytest.approx(
            max(abs(v[:, joint]).max() - [1.5, 3.0][joint], 0.0), abs=1e-3
        )
        assert worst(found, Kind.ACCELERATION, joint) == pytest.approx(
            max(abs(bends[:, joint]).max() - 12.0, 0.0), abs=1e-9
        )
    for i in range(len(found)):  # each is where it says and as deep
        time, joint = found.time[i], found.what[i]
        value = spline(time, found.kind[i] - Kind.RANGE)[joint]
        if found.kind[i] == Kind.RANGE:
            depth = max(value - [0.5, 1.2][joint], -0.8 - value)
        elif found.kind[i] == Kind.SPEED:
            depth = abs(value) - [1.5, 3.0][joint]
        else:
            continue  # the acceleration jumps at the knots of this path
        assert found.depth[i] == pytest.approx(depth, abs=1e-9)


def test_overshoot_between_knots_inside_the_range_is_found():
    spline = Path(
        np.array([0.0, 1.0]), np.zeros((2, 1)), np.array([[4.0], [-4.0]])
    )  # a hump of height 1
    found = limit_violations(spline, Limits(upper=0.9, tolerance=0.0).bounds(1))
    assert (len(found), found.time[0], found.what[0]) == (1, pytest.approx(0.5), 0)
    assert found.depth[0] == pytest.approx(0.1)
    assert not len(limit_violations(spline, Limits(upper=1.0, tolerance=0.0).bounds(1)))


def test_soft_joint_stops_are_tolerated_by_a_milliradian():
    spline = Path(np.array([0.0, 1.0]), np.array([[0.0], [1.0009]]), np.zeros((2, 1)))
    assert not len(limit_violations(spline, Limits(upper=1.0).bounds(1)))
    assert len(limit_violations(spline, Limits(upper=1.0, tolerance=0.0).bounds(1)))


def test_none_is_no_limit():
    assert not len(limit_violations(path(0), Limits().bounds(2)))


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        (Limits(lower=[0.0, 0.0, 0.0]), "limits.lower: expected one number or 2"),
        (Limits(speed=np.nan), "limits.speed"),
        (Limits(lower=1.0, upper=0.0), "lower ≤ upper"),
        (Limits(acceleration=0.0), "above zero"),
    ],
)
def test_bad_limits_are_refused(limits, message):
    with pytest.raises(SpecError, match=message):
        limits.bounds(2)
