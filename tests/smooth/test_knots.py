"""Samples made fit to be fitted."""

import numpy as np
import pytest

from coordlog.errors import SpecError
from coordlog.smooth.knots import clean


def test_good_samples_pass_unchanged():
    time, q = np.array([0.0, 0.1, 0.3]), np.arange(6.0).reshape(3, 2)
    knots = clean(time, q)
    np.testing.assert_array_equal(knots.time, time)
    np.testing.assert_array_equal(knots.position, q)
    np.testing.assert_array_equal(knots.weight, [np.inf, 1.0, np.inf])


def test_samples_at_the_same_time_become_their_mean():
    time = np.array([0.0, 1.0, 1.0, 1.0 + 1e-6, 2.0, 3.0])
    knots = clean(time, np.array([[0.0], [1.0], [2.0], [6.0], [4.0], [5.0]]))
    np.testing.assert_allclose(knots.time, [0.0, 1.0 + 1e-6 / 3, 2.0, 3.0])
    np.testing.assert_allclose(knots.position[:, 0], [0.0, 3.0, 4.0, 5.0])
    np.testing.assert_array_equal(knots.weight, [np.inf, 3.0, 1.0, np.inf])


def test_merging_leaves_the_ends_alone():
    time = np.array([0.0, 1e-9, 1.0, 2.0, 3.0 - 1e-9, 3.0])
    knots = clean(time, np.array([[0.0], [9.0], [1.0], [2.0], [9.0], [3.0]]))
    np.testing.assert_array_equal(knots.time, [0.0, 1.0, 2.0, 3.0])
    np.testing.assert_array_equal(knots.position[:, 0], [0.0, 1.0, 2.0, 3.0])


def test_samples_a_hundredth_apart_stay_two():
    assert len(clean([0.0, 1.0, 1.011, 2.0, 3.0], np.zeros((5, 1))).time) == 5
    assert len(clean([0.0, 1.0, 1.009, 2.0, 3.0], np.zeros((5, 1))).time) == 4


def test_an_incomplete_configuration_is_missing():
    q = np.arange(8.0).reshape(4, 2)
    q[1, 0] = np.nan
    knots = clean([0.0, 1.0, 2.0, 3.0], q)
    np.testing.assert_array_equal(knots.time, [0.0, 2.0, 3.0])
    np.testing.assert_array_equal(knots.position, q[[0, 2, 3]])


@pytest.mark.parametrize(
    ("time", "q", "message"),
    [
        ([0.0], [[1.0]], "at least two samples, got 1"),
        ([], np.zeros((0, 1)), "at least two samples, got 0"),
        ([0.0, 1.0], [1.0, 2.0], r"expected shape \(n, n_j\)"),
        ([0.0, 1.0, 2.0], [[1.0], [2.0]], r"expected shape \(n, n_j\)"),
        ([0.0, 1.0], np.zeros((2, 0)), r"expected shape \(n, n_j\)"),
        ([0.0, np.nan, 2.0], np.zeros((3, 1)), "expected finite numbers"),
        ([0.0, 1.0, 2.0], [[0.0], [np.inf], [0.0]], "only NaN in q is read as a missing sample"),
        ([0.0, 2.0, 1.0], np.zeros((3, 1)), "sample 2 is before the one ahead"),
        ([0.0, 1.0], [[np.nan], [0.0]], "first configuration must be complete, joint 0 is NaN"),
        (
            [0.0, 1.0],
            [[0.0, 0.0], [0.0, np.nan]],
            "last configuration must be complete, joint 1 is NaN",
        ),
        ([1.0, 1.0, 1.0], np.zeros((3, 1)), "all are the same"),
    ],
)
def test_bad_samples_are_refused_in_a_sentence(time, q, message):
    with pytest.raises(SpecError, match=message):
        clean(time, q)
