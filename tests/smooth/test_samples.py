"""Where candidates are looked at."""

import numpy as np
import pytest

from coordlog.smooth import fit
from coordlog.smooth.samples import Samples
from coordlog.smooth.times import spacing


def times(n=37, seed=0):
    time = np.cumsum(np.random.default_rng(seed).uniform(0.01, 0.03, n))
    time[20:] += 0.1  # samples were missing here
    return time


@pytest.mark.parametrize("dense", [1, 2, 3, 4, 5])
def test_every_sample_but_the_ends_is_in_one_level(dense):
    time = times()
    samples = Samples(time, dense)
    together = np.concatenate(samples.levels)
    assert sorted(together) == list(range(1, len(samples.time)))
    knots = samples.time[np.sort(np.concatenate(samples.levels[:4]))]
    np.testing.assert_array_equal(knots, time[1:-1])
    assert np.isin(samples.time[samples.levels[0]], time[8:-1:8]).all()


def test_a_gap_is_sampled_as_densely_as_the_rest():
    time = times()
    samples = Samples(time, 4)
    assert np.diff(samples.time).max() <= spacing(time) / 4 * (1 + 1e-6)
    assert len(Samples(np.arange(10.0), 4).time) == 36


def test_evaluation_is_the_splines():
    time = times()
    spline = fit(time, np.random.default_rng(1).normal(size=(37, 3)), lam=1e-6)
    samples = Samples(time, 4)
    index = np.random.default_rng(2).permutation(len(samples.time))[:50]
    np.testing.assert_allclose(
        samples(spline, index), spline(samples.time[index]), rtol=0, atol=1e-13
    )


def test_nearest():
    samples = Samples(times(), 4)
    at = np.array([samples.time[30] + 1e-5, samples.time[90]])
    assert samples.nearest(at).tolist() == [30, 90]
    assert samples.nearest(np.array([-1.0, 99.0])).tolist() == [0, len(samples.time) - 1]
