"""The certificate is sound: what it lets pass is free everywhere."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coordlog.smooth import Path, Unobstructed, Verdict, fit
from coordlog.smooth.certificate import certify
from coordlog.smooth.violations import Kind
from tests.smooth.planar import PlanarArm


class Bump:
    """One joint; a forbidden hump of given height, centre and width over time, so thin that samples
    miss it."""

    reach = np.array([[1.0]])

    def __init__(self, height, centre, width):
        self.height, self.centre, self.width = height, centre, width

    def slack(self, time, q, clearance):
        return (
            q[:, 0]
            - self.height * np.maximum(0.0, 1.0 - abs(time - self.centre) / self.width)
            - clearance
        )[:, None]

    def check(self, time, q, clearance):
        return Verdict.from_slack(self.slack(time, q, clearance))

    def drift(self, start, stop):
        near = (stop > self.centre - self.width) & (start < self.centre + self.width)
        return (near * self.height / self.width)[:, None]

    def describe(self, what):
        return "bump"


def flat(value):
    return Path(np.arange(0.0, 11.0), np.full((11, 1), value), np.zeros((11, 1)))


def test_what_no_sample_sees_is_found():
    thin = Bump(height=0.5, centre=3.3337, width=1e-3)
    assert thin.check(np.arange(0, 10, 0.05), flat(0.4)(np.arange(0, 10, 0.05)), 0.0).free.all()
    found = certify(flat(0.4), thin, 0.0)
    assert len(found)
    assert abs(found.time - 3.3337).max() < 0.01
    assert not len(certify(flat(0.6), thin, 0.0))


class Ceiling(Bump):
    def __init__(self, height):
        self.height = height

    def slack(self, time, q, clearance):
        return self.height - q - clearance

    def drift(self, start, stop):
        return np.zeros((len(start), 1))


@pytest.mark.parametrize(
    "spline",
    [
        Path(
            np.array([0.0, 1.0]), np.array([[0.0], [1.0]]), np.zeros((2, 1))
        ),  # at rest at both ends, fast between
        Path(np.array([0.0, 1.0]), np.zeros((2, 1)), np.array([[4.0], [-4.0]])),  # a hump
        Path(
            np.array([0.0, 0.5, 1.0]),
            np.array([[0.0], [0.2], [1.0]]),
            np.array([[0.0], [0.9], [0.0]]),
        ),
    ],
)
def test_the_bound_leaves_no_gap_and_little_room(spline):
    """Each path reaches exactly 1."""
    assert len(certify(spline, Ceiling(0.9999), 0.0))
    assert len(certify(spline, Ceiling(0.99), 0.0))
    assert not len(certify(spline, Ceiling(1.002), 0.0))


def test_the_least_depth_is_a_breach():
    found = certify(flat(0.5), Ceiling(0.5 - 1e-9), 0.0)
    assert set(found.kind) == {Kind.CONTACT}
    assert found.depth[0] == pytest.approx(1e-9)


def test_clearance_is_proven_too():
    wide = Bump(height=0.5, centre=3.0, width=2.0)
    assert not len(certify(flat(0.6), wide, 0.09))
    assert (certify(flat(0.6), wide, 0.11).kind == Kind.CONTACT).all()


def test_touching_is_not_proven():
    found = certify(flat(0.5), Bump(height=0.5, centre=3.3337, width=1.0), 0.0)
    assert len(found)
    assert set(found.kind) <= {Kind.CONTACT, Kind.UNPROVEN}
    assert abs(found.time - 3.3337).max() < 1e-3


def test_not_a_number_is_not_free():
    class Broken(Bump):
        def slack(self, time, q, clearance):
            return np.full((len(time), 1), np.nan)

    assert len(certify(flat(0.0), Broken(0.0, 0.0, 1.0), 0.0))


def test_nothing_to_hit_is_proven_at_once():
    assert not len(certify(flat(0.0), Unobstructed(1), 0.0))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 100_000), st.sampled_from([0.0, 0.01]))
def test_certified_paths_are_free_at_sixty_four_samples_per_knot(seed, sway):
    rng = np.random.default_rng(seed)
    discs = np.column_stack([rng.uniform(-0.6, 0.6, (3, 2)), rng.uniform(0.01, 0.08, 3)])
    arm = PlanarArm(rng.uniform(0.08, 0.16, 4), discs, sway=sway)
    time = np.cumsum(rng.uniform(0.01, 0.04, 30))
    spline = fit(
        time,
        np.cumsum(0.05 * rng.normal(size=(30, 4)), axis=0) + rng.normal(size=4),
        lam=10.0 ** rng.uniform(-8, -3),
    )
    fine = np.linspace(time[0], time[-1], 64 * 30)
    free = arm.check(fine, spline(fine), 0.0).free
    found = certify(spline, arm, 0.0)
    if not len(found):
        assert free.all()
    elif (found.kind == Kind.CONTACT).all():
        assert not arm.check(found.time, spline(found.time), 0.0).free.any()
    else:  # unproven: it must be close indeed
        assert arm.slack(found.time, spline(found.time), 0.0).min(axis=1).max() < 1e-3


def test_far_from_everything_it_costs_a_fraction_of_the_knots():
    asked = []

    class Far(Unobstructed):
        def __init__(self):
            self.reach = np.array([[1.0]])

        def slack(self, time, q, clearance):
            asked.append(len(q))
            return np.full((len(q), 1), 10.0)

        def drift(self, start, stop):
            return np.zeros((len(start), 1))

    time = np.linspace(0.0, 3.0, 151)
    assert not len(certify(fit(time, np.sin(time)[:, None], lam=0.0), Far(), 0.0))
    assert sum(asked) == 19
