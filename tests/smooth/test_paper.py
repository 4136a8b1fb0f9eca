"""The paper's search, fast, against the paper's search written plainly."""

import numpy as np
import pytest
from csaps import csaps

from coordlog.smooth import Limits, Unobstructed, smooth
from coordlog.smooth.cutoff import p_from_lam
from coordlog.smooth.paper import _Knots, search
from coordlog.smooth.smoother import Config, _problem, clean
from tests.smooth.planar import PlanarArm, noisy_log


def plainly(time, q, checker, *, precision=1e-6):
    """Algorithms 2 to 4: refit one joint with csaps, check every knot, halve.

    P of each joint, or None.
    """
    index, weight = np.arange(len(time)), np.ones(len(time))
    weight[[0, -1]] = np.inf
    path, p = q.copy(), []

    def evaluate(joint, value):
        candidate = path.copy()
        candidate[:, joint] = csaps(index, q[:, joint], index, smooth=value, weights=weight)
        return candidate, checker.check(time, candidate, 0.0).free.all()

    if not evaluate(0, 1.0)[1]:
        return None
    for joint in range(q.shape[1]):
        lower, upper = 0.0, 1.0
        while upper - lower >= precision:
            middle = (lower + upper) / 2
            if evaluate(joint, middle)[1]:
                upper = middle
            else:
                lower = middle
        p.append(upper)
        path = evaluate(joint, upper)[0]
    return np.array(p)


def problem(time, q, checker, limits=None, **options):
    config, knots = Config.of(method="paper", **options), clean(time, q)
    return _problem(knots, checker, limits or Limits(), config)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_same_p_as_the_plain_search(seed):
    time, q, arm = noisy_log(np.random.default_rng(seed), n=60, links=5)
    expected = plainly(time, q, arm)
    arm.asked = 0
    fast = problem(time, q, arm)
    np.testing.assert_allclose(p_from_lam(search(fast), time[1]), expected, rtol=0, atol=1e-6)
    assert fast.validator.queries.checks + fast.validator.queries.slacks < 0.15 * 5 * 20 * 60


class Sum(Unobstructed):
    """|q0 + q1| below a height: each joint turned by a radian costs exactly one, so the bound on
    motion is tight."""

    def __init__(self, height):
        self.height, self.reach = height, np.ones((2, 2))

    def slack(self, time, q, clearance):
        total = q.sum(axis=1)
        return np.stack([self.height - total, self.height + total], axis=1) - clearance


def wobbly(height):
    time = np.linspace(0.0, 3.0, 100)
    wobble = 0.02 * np.random.default_rng(0).normal(size=(100, 2))
    return (
        time,
        np.stack([0.5 * np.sin(5 * time), 0.45 * np.sin(5 * time + 0.2)], axis=1) + wobble,
        Sum(height),
    )


@pytest.mark.parametrize("height", [0.9, 1.02, 1.05, 1.2])
def test_same_p_where_the_bound_is_tight(height):
    time, q, checker = wobbly(height)
    expected, found = plainly(time, q, checker), search(problem(time, q, checker))
    if expected is None:
        assert found is None
    else:
        np.testing.assert_allclose(p_from_lam(found, time[1]), expected, rtol=0, atol=1e-6)


def test_a_knot_is_asked_about_as_soon_as_it_moves_beyond_its_slack():
    time, q, checker = wobbly(1.2)
    knots = _Knots(problem(time, q, checker))
    assert knots.start()
    for joint in (0, 1):
        knots.turn_to(joint)
        for knot in (20, 50, 80):
            room = 1.2 - knots.path[knot].sum()
            for turned, free in ((room - 1e-9, True), (room + 1e-9, False)):
                values = knots.path[:, joint].copy()
                values[knot] += turned
                assert knots.free(values) == free
        knots.accept(knots.path[:, joint] + 0.05)
    asked = knots._queries.checks
    assert knots.free(knots.path[:, 1] + 1e-6)  # nothing to ask
    assert knots._queries.checks == asked


def test_without_distances_the_p_is_the_same_too():
    time, q, arm = noisy_log(np.random.default_rng(4), n=50, links=4)

    class Plain:
        check, describe = staticmethod(arm.check), staticmethod(arm.describe)

    with_slack = search(problem(time, q, arm))
    without = problem(time, q, Plain(), certify=False)
    np.testing.assert_array_equal(search(without), with_slack)
    assert without.validator.queries.slacks == 0


def test_nothing_in_the_way_smooths_to_the_precision():
    time, q, arm = noisy_log(np.random.default_rng(5), n=50, links=4, discs=0)
    arm.selfs, arm.reach = [], arm.reach[-1:]
    result = smooth(time, q, arm, method="paper")
    assert result.status == "smoothed"
    assert (result.p < 1e-6).all()
    assert result.lam.shape == result.cutoff.shape == (4,)


def test_samples_that_collide_at_a_knot_have_no_p():
    time, q, arm = noisy_log(np.random.default_rng(6), n=50, links=4)
    tip = arm.points(time[25:26], q[25:26])[0, -1]
    blocked = PlanarArm(arm.lengths, [[*tip, 0.02]])
    assert plainly(time, q, blocked) is None
    assert search(problem(time, q, blocked)) is None
    result = smooth(time, q, blocked, method="paper")
    assert (result.status, result.certified) == ("raw_infeasible", False)
    assert "disc 0" in result.reason


def test_lowest_p_and_deviation_bound_the_search():
    time, q, arm = noisy_log(np.random.default_rng(7), n=50, links=4, discs=0)
    arm.selfs, arm.reach = [], arm.reach[-1:]
    result = smooth(time, q, arm, method="paper", cutoff=2.0)
    np.testing.assert_allclose(result.cutoff, 2.0, rtol=0.02)
    near = smooth(time, q, arm, method="paper", max_deviation=0.02)
    assert near.after.max_deviation <= 0.02
    assert near.after.max_deviation > 0.01


def test_a_path_that_collides_between_knots_is_not_returned():
    rng, kept = np.random.default_rng(8), 0
    for _ in range(3):
        time, q, arm = noisy_log(rng, n=60, links=5, margin=0.002)
        result = smooth(time, q, arm, method="paper")
        fine = np.linspace(time[0], time[-1], 64 * 60)
        if result.status == "kept_raw":
            kept += 1
            np.testing.assert_array_equal(result.spline(result.knots.time[:-1]), q[:-1])
            assert result.violation.kind in ("contact", "unproven")
            assert (result.lam == 0.0).all()
        if result.status != "raw_infeasible":
            assert arm.check(fine, result.spline(fine), 0.0).free.all()
    assert kept > 0


def test_joints_left_as_they_were_are_named():
    time = np.linspace(0.0, 1.0, 60)
    q = np.stack(
        [np.sin(5 * time) + 0.02 * np.random.default_rng(0).normal(size=60), np.cos(3 * time)],
        axis=1,
    )

    class Frozen:  # the second joint must keep its samples exactly
        def check(self, when, angles, clearance):
            from coordlog.smooth import Verdict

            expected = np.interp(when, time, q[:, 1])
            exact = np.isin(when, time)
            return Verdict.from_slack(
                np.where(exact, 1e-12 - abs(angles[:, 1] - expected), 1.0)[:, None]
            )

        def describe(self, what):
            return "the second joint"

    result = smooth(time, q, Frozen(), method="paper", certify=False, joints=("elbow", "wrist"))
    assert result.status == "partly"
    assert result.reason.endswith("wrist")
    assert result.lam[0] > 0.0
    assert result.lam[1] == 0.0
