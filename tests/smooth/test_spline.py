"""The spline kernel against csaps, scipy, fifty digits, and what must be true of any smoothing
spline."""

import mpmath
import numpy as np
import pytest
from csaps import csaps
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline, PPoly, make_smoothing_spline

from coordlog.errors import SpecError
from coordlog.smooth import fit

DT = 0.02


def samples(n, *, joints=3, jitter=0.0, seed=0):
    rng = np.random.default_rng(seed)
    time = 0.3 + np.cumsum(DT * (1.0 + jitter * rng.uniform(-0.9, 0.9, n)))
    return time, np.sin(time)[:, None] + 0.05 * np.cumsum(rng.normal(size=(n, joints)), axis=0)


def exact_ends(n):
    weight = np.ones(n)
    weight[[0, -1]] = np.inf
    return weight


def fifty_digits(time, value, lam, weight, velocity):
    """The same minimum by another road: cubic Hermite elements, λ in s³, dense elimination in 50
    digits."""
    mpmath.mp.dps = 50
    n, t = len(time), [mpmath.mpf(float(x)) for x in time]
    stiff, load = mpmath.zeros(2 * n), mpmath.zeros(2 * n, 1)
    for i in range(n - 1):
        h = t[i + 1] - t[i]
        element = [[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2]]
        element += [[-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]]
        for a in range(4):
            for b in range(4):
                stiff[2 * i + a, 2 * i + b] += mpmath.mpf(lam) * element[a][b] / h**3
    fixed = {}
    for i in range(n):
        if np.isinf(weight[i]):
            fixed[2 * i] = mpmath.mpf(float(value[i]))
        else:
            stiff[2 * i, 2 * i] += mpmath.mpf(float(weight[i]))
            load[2 * i] += mpmath.mpf(float(weight[i])) * mpmath.mpf(float(value[i]))
    if velocity is not None:
        fixed |= {1: mpmath.mpf(float(velocity[0])), 2 * n - 1: mpmath.mpf(float(velocity[1]))}
    for row, known in fixed.items():
        for other in range(2 * n):
            load[other] -= stiff[other, row] * known
            stiff[other, row] = stiff[row, other] = 0
        stiff[row, row] = 1
    for row, known in fixed.items():
        load[row] = known
    solution = mpmath.lu_solve(stiff, load)
    return np.array([float(x) for x in solution[::2]]), np.array([float(x) for x in solution[1::2]])


@pytest.mark.parametrize("n", [3, 4, 7, 24])
@pytest.mark.parametrize("lam", [1e-9, 1e-5, 1e-2, 10.0])
@pytest.mark.parametrize("velocity", [None, (0.7, -0.4)])
def test_fifty_digits_agree(n, lam, velocity):
    time, value = samples(n, joints=1, jitter=1.0, seed=n)
    weight = np.random.default_rng(n).uniform(0.1, 10.0, n)
    weight[[0, -1]] = np.inf
    ends = None if velocity is None else np.reshape(velocity, (2, 1))
    spline = fit(time, value, lam=lam, weight=weight, velocity=ends)
    position, slope = fifty_digits(time, value[:, 0], lam, weight, velocity)
    np.testing.assert_allclose(spline.position[:, 0], position, rtol=0, atol=1e-11)
    np.testing.assert_allclose(spline.velocity[:, 0], slope, rtol=0, atol=1e-10 / DT)


@pytest.mark.parametrize("p", [1e-9, 1e-6, 1e-3, 0.5, 0.99, 0.999999])
@pytest.mark.parametrize("jitter", [0.0, 1.0])
@pytest.mark.parametrize("ends", ["free", "exact"])
def test_csaps_agrees_for_all_p(p, jitter, ends):
    time, value = samples(150, jitter=jitter)
    weight = exact_ends(150) if ends == "exact" else np.random.default_rng(1).uniform(0.5, 2.0, 150)
    fine = np.linspace(time[0], time[-1], 1000)
    spline = fit(time, value, lam=(1.0 - p) / p, weight=weight)
    np.testing.assert_allclose(
        spline(fine), csaps(time, value.T, fine, smooth=p, weights=weight).T, rtol=0, atol=2e-8
    )


@pytest.mark.parametrize("lam", [1e-8, 1e-4, 1.0])
def test_scipy_agrees_where_it_is_accurate(lam):
    time, value = samples(150, jitter=0.5)
    fine = np.linspace(time[0], time[-1], 1000)
    theirs = make_smoothing_spline(time, value, w=exact_ends(150), lam=lam)
    spline = fit(time, value, lam=lam)
    np.testing.assert_allclose(spline(fine), theirs(fine), rtol=0, atol=1e-8)
    np.testing.assert_allclose(spline(fine, 1), theirs(fine, 1), rtol=0, atol=1e-6)


def test_without_smoothing_it_is_the_natural_or_clamped_interpolant():
    time, value = samples(60, jitter=1.0)
    fine, velocity = (
        np.linspace(time[0], time[-1], 500),
        np.array([[0.1, -0.2, 0.3], [0.0, 0.5, -0.5]]),
    )
    natural = CubicSpline(time, value, bc_type="natural")
    np.testing.assert_allclose(fit(time, value, lam=0.0)(fine), natural(fine), rtol=0, atol=1e-12)
    clamped = CubicSpline(time, value, bc_type=((1, velocity[0]), (1, velocity[1])))
    for nu, scale in enumerate((1e-12, 1e-10, 1e-8, 1e-5)):
        np.testing.assert_allclose(
            fit(time, value, lam=0.0, velocity=velocity)(fine, nu),
            clamped(fine, nu),
            rtol=0,
            atol=scale,
        )


def test_at_infinite_smoothing_it_is_the_weighted_line():
    time, value = samples(80, jitter=1.0)
    weight = np.random.default_rng(2).uniform(0.1, 5.0, 80)
    line = np.polynomial.Polynomial.fit
    spline = fit(time, value, lam=np.inf, weight=weight)
    for joint in range(3):
        expected = line(time, value[:, joint], 1, w=np.sqrt(weight))(time)
        np.testing.assert_allclose(spline.position[:, joint], expected, rtol=0, atol=1e-10)


def test_at_infinite_smoothing_between_clamped_ends_it_is_the_hermite_cubic():
    time, value = samples(150)
    velocity = np.array([[0.1, -0.2, 0.3], [0.0, 0.5, -0.5]])
    two = fit(time[[0, -1]], value[[0, -1]], lam=0.0, velocity=velocity)
    for lam, close in ((np.inf, 1e-8), (1e6, 1e-4)):
        np.testing.assert_allclose(
            fit(time, value, lam=lam, velocity=velocity).position, two(time), rtol=0, atol=close
        )
    assert abs(two(np.linspace(time[0], time[-1], 9), 3) - two(time[:1], 3)).max() < 1e-9


@pytest.mark.parametrize("velocity", [None, np.zeros((2, 3))])
def test_small_paths(velocity):
    for n in (2, 3, 4):
        time, value = samples(n)
        for lam in (0.0, 1e-6, 1.0, np.inf):
            spline = fit(time, value, lam=lam, velocity=velocity)
            assert np.array_equal(spline.position[[0, -1]], value[[0, -1]])
    assert velocity is not None or np.allclose(spline(time, 2), 0.0, atol=1e-9)


@pytest.mark.parametrize("lam", [0.0, 1e-5, 1.0, 1e4])
@pytest.mark.parametrize("clamped", [False, True])
def test_ends_are_exact_and_derivatives_continuous(lam, clamped):
    time, value = samples(150, jitter=0.8)
    velocity = np.array([[0.1, 0.0, 0.3], [0.0, 0.5, -0.5]]) if clamped else None
    spline = fit(time, value, lam=lam, velocity=velocity)
    assert np.array_equal(spline.position[[0, -1]], value[[0, -1]])
    if clamped:
        np.testing.assert_allclose(spline.velocity[[0, -1]], velocity, rtol=0, atol=1e-12)
    else:
        assert abs(spline(time[[0, -1]], 2)).max() < 1e-8 * (1.0 + abs(spline(time, 2)).max())
    before, after = spline.ppoly.c[:, :-1], spline.ppoly.c[:, 1:]
    h = np.diff(time)[:-1, None]
    assert (
        abs(((before[0] * h + before[1]) * h + before[2]) * h + before[3] - after[3]).max() < 1e-13
    )
    assert abs((3 * before[0] * h + 2 * before[1]) * h + before[2] - after[2]).max() < 1e-10
    assert abs(6 * before[0] * h + 2 * before[1] - 2 * after[1]).max() < 1e-9 / DT**2


def test_infinite_weight_inside_is_met_exactly():
    time, value = samples(50)
    weight = exact_ends(50)
    weight[[20, 33]] = np.inf
    spline = fit(time, value, lam=1e-3, weight=weight, velocity=np.zeros((2, 3)))
    assert np.array_equal(spline.position[[20, 33]], value[[20, 33]])
    assert abs(spline.position[21] - value[21]).max() > 1e-3


def test_constant_joints_stay_bit_for_bit():
    time, value = samples(90)
    value[:, 1] = 0.1
    for lam in (0.0, 1e-4, 10.0):
        assert (fit(time, value, lam=lam, velocity=np.zeros((2, 3))).position[:, 1] == 0.1).all()


@settings(max_examples=30, deadline=None)
@given(st.floats(-8.0, 2.0), st.booleans(), st.integers(0, 10_000))
def test_invariances(log_lam, clamped, seed):
    time, value = samples(40, jitter=1.0, seed=seed)
    lam, velocity = (
        10.0**log_lam,
        np.random.default_rng(seed).normal(size=(2, 3)) if clamped else None,
    )
    mix = np.random.default_rng(seed + 1).normal(size=(3, 3))
    path = fit(time, value, lam=lam, velocity=velocity).position
    v = (lambda change: None) if velocity is None else (lambda change: change(velocity))

    shifted = fit(time + 100.0, value + 3.0, lam=lam, velocity=velocity).position - 3.0
    slower = fit(2.0 * time, value, lam=8.0 * lam, velocity=v(lambda x: x / 2.0)).position
    backward = fit(-time[::-1], value[::-1], lam=lam, velocity=v(lambda x: -x[::-1])).position[::-1]
    mixed = fit(time, value @ mix, lam=lam, velocity=v(lambda x: x @ mix)).position
    heavier = fit(
        time, value, lam=5.0 * lam, weight=5.0 * exact_ends(40), velocity=velocity
    ).position
    for other, expected in (
        (shifted, path),
        (slower, path),
        (backward, path),
        (mixed, path @ mix),
        (heavier, path),
    ):
        np.testing.assert_allclose(other, expected, rtol=0, atol=1e-9)


def test_each_joint_may_have_its_own_lam():
    time, value = samples(70)
    lam = np.array([0.0, 1e-4, 1.0])
    together = fit(time, value, lam=lam)
    for joint in range(3):
        alone = fit(time, value[:, [joint]], lam=lam[joint])
        np.testing.assert_array_equal(together.position[:, [joint]], alone.position)
        np.testing.assert_array_equal(together.velocity[:, [joint]], alone.velocity)


def test_long_paths_stay_accurate():
    time, value = samples(15_000, joints=1)
    spline = fit(time, value, lam=1e6, velocity=np.zeros((2, 1)))
    assert np.isfinite(spline.position).all()
    assert (
        abs(np.diff(spline.ppoly.c[1, :, 0])).max() < 1e-2
    )  # no noise where the curve is all but straight


def test_evaluation_is_scipys():
    time, value = samples(20)
    spline = fit(time, value, lam=1e-5)
    assert isinstance(spline.ppoly, PPoly)
    at = np.linspace(time[0], time[-1], 12).reshape(3, 4)
    assert spline(at).shape == (3, 4, 3)
    np.testing.assert_allclose(spline(at, 2), spline.ppoly(at, 2), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(spline(time, 1), spline.velocity, atol=1e-12)
    with pytest.raises(SpecError, match=r"the path is defined from 0\.3"):
        spline(time[-1] + 0.01)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"time": [0.0]}, "time: expected at least two"),
        ({"time": [0.0, 1.0, 1.0]}, "strictly increasing"),
        ({"time": [0.0, np.nan, 1.0]}, "finite"),
        ({"value": np.zeros((2, 1))}, r"value: expected finite samples of shape \(3, n_j\)"),
        ({"value": np.full((3, 1), np.nan)}, "value: expected finite"),
        ({"value": np.zeros(3)}, "value: expected"),
        ({"lam": -1.0}, "lam: expected λ ≥ 0"),
        ({"lam": [1.0, 1.0]}, "lam: expected λ ≥ 0, one or 1"),
        ({"weight": [1.0, 0.0, 1.0]}, "weight: expected positive"),
        ({"weight": [1.0, 1.0]}, "weight"),
        ({"velocity": np.zeros((2, 2))}, "velocity: expected finite slopes"),
        ({"velocity": np.zeros((2, 1)), "weight": np.ones(3)}, "infinite weights at both ends"),
    ],
)
def test_bad_input_is_said(change, message):
    good = {"time": [0.0, 1.0, 2.0], "value": np.zeros((3, 1)), "lam": 1.0}
    arguments = good | change
    with pytest.raises(SpecError, match=message):
        fit(arguments.pop("time"), arguments.pop("value"), **arguments)
