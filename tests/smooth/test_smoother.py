"""What `smooth` promises: statuses and reasons, ends, limits, bad input, and what it records about
itself."""

import subprocess
import sys

import numpy as np
import pytest

import coordlog.smooth
from coordlog import episode
from coordlog.errors import ConfigError, SpecError
from coordlog.smooth import Limits, Unobstructed, Verdict, smooth
from coordlog.smooth.config import Config
from coordlog.smooth.cutoff import lam_from_cutoff
from coordlog.smooth.knots import clean
from coordlog.smooth.validator import Validator
from tests.smooth.planar import PlanarArm, noisy_log

FREE = Unobstructed(2)


def wave(n=100, *, noise=0.02, seed=0):
    time = np.linspace(0.0, 2.0, n)
    return time, np.stack(
        [np.sin(2 * time), np.cos(3 * time)], axis=1
    ) + noise * np.random.default_rng(seed).normal(size=(n, 2))


class Ceiling:
    """The first joint stays below a height that may differ over time; metres are radians here."""

    reach = np.array([[1.0, 0.0]])

    def __init__(self, height):
        self.height = height

    def slack(self, time, q, clearance):
        return (self.height - q[:, :1]) - clearance

    def check(self, time, q, clearance):
        return Verdict.from_slack(self.slack(time, q, clearance))

    def drift(self, start, stop):
        return np.zeros((len(start), 1))

    def describe(self, what):
        return "elbow and ceiling"


@pytest.mark.parametrize("method", ["local", "shared", "paper"])
@pytest.mark.parametrize("ends", ["auto", "rest", "natural"])
@pytest.mark.parametrize("n", [2, 3, 4, 5])
def test_a_few_knots_are_enough(n, ends, method):
    time, q = wave(n)
    result = smooth(time, q, FREE, method=method, ends=ends)
    assert (result.status, result.reason, result.violation) == ("smoothed", "", None)
    np.testing.assert_array_equal(result.spline.position[[0, -1]], q[[0, -1]])
    if n == 2 and not result.config.clamped:
        np.testing.assert_allclose(result.spline(1.0)[0], q[:, 0].mean(), atol=1e-12)


def test_one_sample_is_refused():
    with pytest.raises(SpecError, match="at least two samples, got 1"):
        smooth([0.0], [[1.0, 2.0]], FREE)


def test_slopes_at_the_ends():
    time, q = wave()
    np.testing.assert_array_equal(smooth(time, q, FREE).spline.velocity[[0, -1]], np.zeros((2, 2)))
    for free in (smooth(time, q, FREE, ends="natural"), smooth(time, q, FREE, method="paper")):
        np.testing.assert_allclose(free.spline(time[[0, -1]], 2), 0.0, atol=1e-6)


def test_three_names_of_the_parameter_are_recorded():
    time, q = wave()
    result = smooth(time, q, FREE, cutoff=3.0)
    dt = time[1] - time[0]
    np.testing.assert_allclose(result.cutoff, 3.0)
    np.testing.assert_allclose(result.lam, lam_from_cutoff(3.0, dt))
    np.testing.assert_allclose(result.p, 1.0 / (1.0 + result.lam / dt**3))
    assert result.lam.shape == (2,)
    half = smooth(time, q, FREE)
    np.testing.assert_allclose(half.cutoff, 0.25)


def test_missing_and_repeated_samples():
    time, q = wave(60)
    q[[10, 11, 40], [0, 1, 0]] = np.nan
    time = np.insert(time, 30, time[30] - 1e-9)
    q = np.insert(q, 30, q[30] + 0.02, axis=0)
    result = smooth(time, q, FREE, cutoff=20.0)
    assert len(result.knots.time) == 60
    assert np.sort(result.weight[np.isfinite(result.weight)])[-1] == 2.0
    assert (result.status, result.certified) == ("smoothed", True)
    assert "joint 0 has samples at 58 of 60 times" in result.reason
    assert "2 of 61 samples share 1 times" in result.reason


def test_constant_joints_do_not_move():
    time, q = wave()
    q[:, 1] = 0.7
    for method in ("local", "shared", "paper"):
        result = smooth(time, q, Ceiling(1.05), method=method)
        assert (result.spline.position[:, 1] == 0.7).all()
        assert (result.spline.velocity[:, 1] == 0.0).all()


def test_times_need_not_be_uniform():
    rng = np.random.default_rng(5)
    time = np.cumsum(rng.uniform(0.002, 0.04, 120))
    q = np.stack([np.sin(2 * time), np.cos(3 * time)], axis=1) + 0.01 * rng.normal(size=(120, 2))
    result = smooth(time, q, Ceiling(1.03))
    assert result.status == "smoothed"
    assert result.spline(np.linspace(time[0], time[-1], 5000))[:, 0].max() < 1.03
    assert result.after.jerk < 0.1 * result.before.jerk


def test_a_log_that_rides_a_limit_is_smoothed_inside_it():
    time, q = wave()
    q[:, 0] = np.minimum(q[:, 0], 0.8)
    q[:, 1] = np.maximum(q[:, 1], -0.5)
    limits = Limits(lower=[-2.0, -0.5], upper=[0.8, 2.0])
    result = smooth(time, q, FREE, limits=limits, cutoff=3.0)
    fine = result.spline(np.linspace(0.0, 2.0, 5000))
    assert result.status == "smoothed"
    assert fine[:, 0].max() <= 0.801
    assert fine[:, 1].min() >= -0.501
    assert fine[:, 0].max() > 0.75
    assert result.after.jerk < 0.1 * result.before.jerk


def test_a_log_that_collides_is_never_called_safe():
    time, q = wave(noise=0.005)
    result = smooth(time, q, Ceiling(0.9), cutoff=5.0, joints=("elbow", "wrist"))
    assert (result.status, result.certified) == ("raw_infeasible", False)
    assert "elbow and ceiling at 0.7" in result.reason
    assert (result.violation.kind, result.violation.what) == ("contact", "elbow and ceiling")
    assert q[:, 0].max() - 0.9 == pytest.approx(result.violation.depth, abs=0.01)
    fine = np.linspace(0.0, 2.0, 2000)
    assert result.spline(fine)[:, 0].max() <= q[:, 0].max() + 1e-3  # no deeper than it was


def test_a_log_that_collides_by_its_noise_alone_is_mended():
    time, q = wave(noise=0.0)
    q[35, 0] += 0.2
    result = smooth(time, q, Ceiling(1.1), cutoff=1.0)
    assert (result.status, result.certified) == ("smoothed", True)


class Walls(Ceiling):
    """Each joint stays below its own height."""

    reach = np.eye(2)

    def slack(self, time, q, clearance):
        return self.height - q - clearance

    def describe(self, what):
        return ("left wall", "right wall", "lid")[what]


def rise(noise=0.003):
    """The first joint ends as high as it gets.

    The second would swing out at the end if it might, and does not.
    """
    time = np.linspace(0.0, 2.0, 101)
    wobble = (
        noise
        * np.random.default_rng(0).normal(size=(101, 2))
        * np.minimum(1.0, 2.0 - time)[:, None]
    )
    return time, np.stack(
        [1.0 - 0.5 * (time - 2.0) ** 2, -0.5 * time * (2.0 - time)], axis=1
    ) + wobble


def test_clearance_that_the_end_point_lacks_costs_little_smoothness():
    time, q = rise()
    result = smooth(time, q, Walls([1.01, 9.0]), clearance=0.05)
    assert (result.status, result.certified) == ("partly", True)
    assert (result.violation.kind, result.violation.what) == ("contact", "left wall")
    assert result.violation.depth == pytest.approx(0.04, abs=1e-3)
    assert result.spline(np.linspace(0.0, 2.0, 3000))[:, 0].max() < 1.0 + 1e-3
    assert result.after.jerk < 0.05 * result.before.jerk


@pytest.mark.parametrize("certify", [True, False])
def test_a_pair_excused_hides_no_other(certify):
    time = np.linspace(0.0, 2.0, 101)
    q = np.stack([np.full(101, 1.0), -0.5 * time * (2.0 - time)], axis=1)

    class Both(
        Walls
    ):  # the first joint is 4 cm short of the left wall all along; the right one comes out in mid-path
        def slack(self, when, angles, clearance):
            out = -0.28 + 5.0 * np.maximum(0.0, abs(when - 1.0) - 0.3)
            return np.stack([1.01 - angles[:, 0], out - angles[:, 1]], axis=1) - clearance

        def drift(self, start, stop):
            return np.full((len(start), 2), 5.0)

    knots, config = clean(time, q), Config(clearance=0.05, certify=certify)
    validator = Validator(
        Both(None), knots, coordlog.smooth.fit(time, q, lam=0.0), limits=Limits(), config=config
    )
    proof = validator.validate(
        coordlog.smooth.fit(time, q * [1.0, 0.67], lam=0.0)
    )  # 25 mm short of the right wall
    assert set(proof.found.what) == {1}
    assert 0.0 < proof.found.depth.max() < 0.03
    result = smooth(time, q, Both(None), clearance=0.05, certify=certify, cutoff=0.01)
    samples = np.linspace(0.7, 1.3, 31)
    assert (result.status, result.certified) == ("partly", certify)
    assert result.violation.what == "left wall"
    assert result.spline(samples)[:, 1].max() <= -0.28 - 0.05


def test_other_pairs_keep_their_clearance_between_samples():
    time = np.linspace(0.0, 2.0, 101)
    q = np.stack([np.full(101, 1.0), -0.5 * time * (2.0 - time)], axis=1)

    class Spike(
        Walls
    ):  # the left wall is too close throughout; the right one comes 4 cm nearer for 4 ms
        def slack(self, when, angles, clearance):
            spike = 0.04 * np.maximum(0.0, 1.0 - abs(when - 1.005) / 0.002)
            return np.stack([1.01 - angles[:, 0], 0.08 - spike - angles[:, 1]], axis=1) - clearance

        def drift(self, start, stop):
            return np.where((stop > 1.003) & (start < 1.007), 20.0, 0.0)[:, None] * [1.0, 1.0]

    result = smooth(time, q, Spike(None), clearance=0.05, cutoff=0.01)
    assert (result.status, result.certified) == ("partly", True)
    assert result.spline(1.005)[1] <= 0.08 - 0.04 - 0.05


def test_pairs_that_are_merely_close_do_not_hide_a_collision_of_the_log():
    time = np.linspace(0.0, 2.0, 101)
    q = np.ones((101, 2)) + 0.001 * np.random.default_rng(0).normal(size=(101, 2))
    q[[0, -1]] = 1.0

    class Three(
        Walls
    ):  # two are 3 and 2 cm away throughout; the third comes out to touch for 4 ms between two samples
        reach = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])

        def slack(self, when, angles, clearance):
            spike = 0.1 * np.maximum(0.0, 1.0 - abs(when - 1.005) / 0.002)
            return (
                np.stack(
                    [1.02 - angles[:, 0], 1.03 - angles[:, 0], 1.08 - spike - angles[:, 1]], axis=1
                )
                - clearance
            )

        def drift(self, start, stop):
            return np.where((stop > 1.003) & (start < 1.007), 50.0, 0.0)[:, None] * np.ones(3)

    result = smooth(time, q, Three(None), clearance=0.05)
    assert (result.status, result.certified) == ("raw_infeasible", False)
    assert result.violation.what == "lid"


def test_an_end_point_alone_may_lack_clearance():
    time, q = rise()
    result = smooth(time, q, Walls([1.05 - 1e-6, 9.0]), clearance=0.05)
    assert (result.status, result.certified) == ("partly", True)
    assert result.violation.time == 2.0
    assert result.violation.depth == pytest.approx(1e-6)


def test_an_end_that_collides_excuses_nothing_in_mid_path():
    time = np.linspace(0.0, 2.0, 101)
    q = np.stack(
        [1.0 - time * (2.0 - time), np.zeros(101)], axis=1
    )  # from 1 down to 0 and up again
    result = smooth(time, q, Walls([0.95, 9.0]))
    assert (result.status, result.certified) == ("raw_infeasible", False)
    assert result.spline(np.linspace(0.3, 1.7, 500))[:, 0].max() <= 0.95


def test_speed_kept_by_the_log_is_kept_by_the_path():
    time = np.linspace(0.0, 2.0, 101)
    q = np.stack(
        [0.6 * time, np.zeros(101)], axis=1
    )  # constant speed; from rest to rest it would have to hurry
    q[:5, 0], q[-5:, 0] = q[4, 0], q[-5, 0]
    limit = 0.7
    assert abs(smooth(time, q, FREE).spline(time, 1)).max() > limit
    result = smooth(time, q, FREE, limits=Limits(speed=limit), ends="natural")
    assert result.status == "smoothed"
    assert abs(result.spline(np.linspace(0.0, 2.0, 4000), 1)).max() <= limit


@pytest.mark.parametrize(
    ("limits", "kind"),
    [(Limits(speed=[0.3, 9.0]), "speed"), (Limits(acceleration=0.05), "acceleration")],
)
def test_speed_that_the_log_exceeds_too_is_said(limits, kind):
    time, q = wave()
    result = smooth(time, q, FREE, limits=limits, joints=("elbow", "wrist"))
    assert (result.status, result.certified) == ("partly", True)
    assert result.violation.kind == kind
    assert result.violation.what in ("elbow", "wrist")
    assert result.after.acceleration < result.before.acceleration


def test_speed_that_the_log_exceeds_is_not_exceeded_further():
    time = np.linspace(0.0, 2.0, 101)
    q = 0.6 * time[:, None] * [1.0, 0.0]
    result = smooth(time, q, FREE, limits=Limits(speed=0.59), ends="rest")
    raw = abs(
        coordlog.smooth.fit(time, q, lam=0.0, velocity=np.zeros((2, 2)))(
            np.linspace(0.0, 2.0, 5000), 1
        )
    ).max()
    assert (result.status, result.violation.kind) == ("partly", "speed")
    assert 0.01 < result.violation.depth <= raw - 0.59 + 1e-9


def test_an_end_out_of_range_cannot_be_mended():
    time, q = wave()
    limits = Limits(lower=-5.0, upper=[q[-1, 0] - 0.1 + 2.0, q[-1, 1] - 0.1])
    result = smooth(time, q, FREE, limits=limits)
    assert (result.status, result.violation.kind, result.violation.what) == (
        "raw_infeasible",
        "range",
        "joint 1",
    )


def test_a_log_that_collides_between_its_samples_is_smoothed_elsewhere():
    rng = np.random.default_rng(1)
    time, q, arm = [noisy_log(rng) for _ in range(7)][6]
    assert arm.check(time, q, 0.0).free.all()
    result = smooth(time, q, arm)
    assert (result.status, result.certified) == ("raw_infeasible", False)
    assert result.violation.depth < 5e-4
    assert result.after.acceleration < 0.6 * result.before.acceleration


def test_grazing_throughout_is_given_up_soon():
    class Grazing(Ceiling):
        def drift(self, start, stop):
            return np.full((len(start), 1), 0.1)

    time, q = wave()
    q[:, 0] = 0.8
    result = smooth(time, q, Grazing(0.8))
    assert (result.status, result.certified, result.violation.kind) == (
        "kept_raw",
        False,
        "unproven",
    )
    assert "too close to be proven free" in result.reason
    assert result.checks < 20 * 4 * 100


def test_a_very_long_path_is_smoothed_no_further_than_doubles_allow():
    n = 15_000
    time = 0.02 * np.arange(n)
    q = np.sin(0.5 * time)[:, None] + 0.02 * np.random.default_rng(0).normal(size=(n, 1))
    result = smooth(time, q, Unobstructed(1))
    assert result.lam[0] <= 1e12 * 0.02**3 * (1 + 1e-9)
    assert result.after.jerk < 1e-4 * result.before.jerk


def test_a_budget_too_small_keeps_the_raw_path():
    time, q, arm = noisy_log(np.random.default_rng(1), n=80, links=5)
    result = smooth(time, q, arm, budget=50)
    assert result.status in ("kept_raw", "raw_infeasible")
    assert "50 configurations" in result.reason
    np.testing.assert_array_equal(result.spline.position, q)
    np.testing.assert_array_equal(result.lam, np.zeros(5))
    assert np.isinf(result.cutoff).all()
    plenty = smooth(time, q, arm, budget=1_000_000)
    assert plenty.status == "smoothed"


def test_what_a_budget_allows_is_returned():
    time, q, arm = noisy_log(np.random.default_rng(3), n=80, links=5)
    full = smooth(time, q, arm, method="shared")
    some = smooth(time, q, arm, method="shared", budget=int(0.7 * (full.checks + full.slacks)))
    assert some.status == "smoothed"
    assert full.cutoff[0] < some.cutoff[0] < np.inf


def test_every_question_is_counted():
    time, q, arm = noisy_log(np.random.default_rng(3), n=80, links=5)
    for method in ("local", "shared", "paper"):
        arm.asked = arm.measured = 0
        result = smooth(time, q, arm, method=method)
        assert (result.checks, result.slacks) == (arm.asked, arm.measured)


def test_local_asks_little():
    time, q, arm = noisy_log(np.random.default_rng(1))
    result = smooth(time, q, arm)
    assert result.status == "smoothed"
    assert (
        result.checks + result.slacks < 150 * 20
    )  # the paper's search asks 150 x 20 for one joint of eight
    assert result.after.jerk < 0.05 * result.before.jerk


def test_a_moving_base_is_proven_too():
    time, q, arm = noisy_log(np.random.default_rng(4), n=80, links=5, sway=0.02)
    result = smooth(time, q, arm)
    fine = np.linspace(time[0], time[-1], 8000)
    assert result.certified
    assert arm.check(fine, result.spline(fine), 0.0).free.all()
    still = PlanarArm(arm.lengths, arm.discs)
    apart = [checker.slack(fine, result.spline(fine), 0.0)[:, :-1] for checker in (arm, still)]
    assert abs(apart[0] - apart[1]).max() > 0.01


def test_balance_is_a_pair_like_any_other():
    rng = np.random.default_rng(1)
    time, q, arm = noisy_log(rng, n=80, links=5, discs=0)
    p = arm.points(time, q)
    com = abs(
        (0.5 * (p[:, :-1] + p[:, 1:]) * (arm.lengths / arm.lengths.sum())[:, None]).sum(axis=1)[
            :, 0
        ]
    ).max()
    tight = PlanarArm(arm.lengths, [], balance=com + 0.002)
    fine = np.linspace(time[0], time[-1], 5000)
    tipping = smooth(time, q, arm).spline(fine)
    assert not tight.check(fine, tipping, 0.0).free.all()  # without the rule the path would tip
    result = smooth(time, q, tight)
    assert (result.status, result.certified) == ("smoothed", True)
    assert tight.check(fine, result.spline(fine), 0.0).free.all()


def test_the_path_of_an_episode_is_the_spline():
    time, q, arm = noisy_log(np.random.default_rng(3), n=60, links=4)
    result = smooth(time, q, arm)
    path = result.path()
    assert isinstance(path, episode.Path)
    np.testing.assert_array_equal(path.knot_position, q)
    np.testing.assert_array_equal(path.knot_time, time)
    assert np.isinf(path.knot_weight[[0, -1]]).all()
    fine = np.linspace(time[0], time[-1], 200)
    hermite = coordlog.smooth.Path(path.time, path.position, path.velocity)
    np.testing.assert_array_equal(hermite(fine), result.spline(fine))


def test_the_result_is_frozen_and_says_what_it_cost():
    time, q = wave()
    result = smooth(time, q, FREE)
    with pytest.raises(AttributeError):
        result.status = "smoothed"
    assert result.cpu > 0.0
    assert result.before.max_deviation < 1e-12 < result.after.max_deviation


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"cutof": 3.0},
            "unknown option 'cutof'; choose one of: budget, certify, clearance, cutoff",
        ),
        ({"method": "global"}, "unknown method 'global'; choose one of: local, paper, shared"),
        ({"ends": "loose"}, "unknown ends 'loose'"),
        ({"cutoff": 0.0}, "cutoff: expected 'max' or a frequency above 0 Hz, got 0.0"),
        ({"cutoff": "3"}, "cutoff: expected"),
        ({"max_deviation": -1.0}, "max_deviation: expected distances above 0"),
        ({"clearance": float("nan")}, "clearance: expected a distance of at least 0 m"),
        ({"dense": 0}, "dense, budget: expected at least 1"),
        ({"ends": "keep"}, "unknown ends 'keep'"),
        ({"max_deviation": [0.1, 0.1, 0.1]}, "max_deviation: expected one number or 2, got 3"),
    ],
)
def test_bad_options_are_refused_in_a_sentence(options, message):
    time, q = wave(10)
    with pytest.raises(ConfigError, match=message):
        smooth(time, q, FREE, **options)


def test_bad_arrays_are_refused_in_a_sentence():
    time, q = wave(10)
    with pytest.raises(SpecError, match="joints: expected 2 names, got 1"):
        smooth(time, q, FREE, joints=("elbow",))
    with pytest.raises(
        SpecError, match=r"checker: expected slack of shape \(2, P\) and reach of shape \(P, 2\)"
    ):
        smooth(time, q, Unobstructed(3))


def test_a_checker_that_answers_in_the_wrong_shape_is_caught():
    class Wrong:
        def check(self, time, q, clearance):
            return Verdict(np.array(True), np.zeros(1), np.zeros(1, int))

        def describe(self, what):
            return ""

    time, q = wave(10)
    with pytest.raises(SpecError, match=r"checker.check: expected three arrays of shape \(2,\)"):
        smooth(time, q, Wrong(), certify=False)
    with pytest.raises(ConfigError, match="certify: the checker lacks slack, reach or drift"):
        smooth(time, q, Wrong())


def test_the_package_loads_scipy_only_when_used():
    script = "import sys, coordlog.smooth as s; assert 'scipy' not in sys.modules; s.smooth; assert 'scipy' in sys.modules"
    subprocess.run([sys.executable, "-c", script], check=True)
    for name in coordlog.smooth.__all__:
        assert getattr(coordlog.smooth, name).__name__ == name
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        coordlog.smooth.nothing  # noqa: B018
