"""Tests for soft ends: no slope and no acceleration there, and elsewhere the fit as it was."""

from __future__ import annotations

import numpy as np
import pytest

from coordlog.smooth import Unobstructed, smooth
from coordlog.smooth.blending import BLEND, BlendedGrid, grid_for
from coordlog.smooth.config import Config
from coordlog.smooth.spline import Grid


def walk(rng, n, joints=3):
    return np.arange(n) * 0.04, np.cumsum(0.05 * rng.normal(size=(n, joints)), axis=0)


def ends_exact(n):
    weight = np.ones(n)
    weight[[0, -1]] = np.inf
    return weight


@pytest.mark.parametrize("n", [2, 3, 4, 20, 150, 400])
def test_a_path_starts_and_stops_at_rest_and_without_acceleration(n):
    rng = np.random.default_rng(n)
    time, q = walk(rng, n)
    path = BlendedGrid(time).fit(q, lam=1e-3, weight=ends_exact(n), velocity=np.zeros((2, 3)))
    inside = abs(path(np.linspace(time[0], time[-1], 400), 2)).max()
    assert (path.velocity[[0, -1]] == 0).all()
    assert (path.position[[0, -1]] == q[[0, -1]]).all()
    if n > 10:
        rest = Grid(time, clamped=True).fit(
            q, lam=1e-3, weight=ends_exact(n), velocity=np.zeros((2, 3))
        )
        assert abs(path(time[[0, -1]], 2)).max() < 0.1 * inside
        assert abs(path(time[[0, -1]], 2)).max() < 0.2 * abs(rest(time[[0, -1]], 2)).max()


def test_without_a_penalty_every_sample_is_met():
    time, q = walk(np.random.default_rng(0), 90)
    path = BlendedGrid(time).fit(q, lam=0.0, weight=ends_exact(90), velocity=np.zeros((2, 3)))
    assert (path.position == q).all()


def test_far_from_the_ends_the_fit_is_the_usual_one():
    """λ means there what it means for a fit with other ends."""
    n = 300
    time, q = walk(np.random.default_rng(1), n)
    lam = 1e-4
    soft, rest = (
        grid.fit(q, lam=lam, weight=ends_exact(n), velocity=np.zeros((2, 3)))
        for grid in (BlendedGrid(time), Grid(time, clamped=True))
    )
    middle = slice(BLEND + 65, n - BLEND - 65)
    assert abs(soft.position - rest.position)[middle].max() < 1e-6
    assert abs(soft.velocity - rest.velocity)[middle].max() < 1e-5


def test_the_smoothest_soft_path_has_less_jerk_than_the_smoothest_at_rest():
    time, q = walk(np.random.default_rng(2), 100)
    jerk = {
        ends: smooth(time, q, Unobstructed(3), ends=ends).after.jerk for ends in ("rest", "soft")
    }
    assert jerk["soft"] < 0.7 * jerk["rest"]


def test_reversed_samples_give_the_reversed_path():
    time, q = walk(np.random.default_rng(3), 120)
    there = BlendedGrid(time).fit(q, lam=1e-3, weight=ends_exact(120), velocity=np.zeros((2, 3)))
    back = BlendedGrid(time).fit(
        q[::-1], lam=1e-3, weight=ends_exact(120), velocity=np.zeros((2, 3))
    )
    assert abs(there.position - back.position[::-1]).max() < 1e-9
    assert abs(there.velocity + back.velocity[::-1]).max() < 1e-7


def test_each_joint_may_have_its_own_smoothness():
    time, q = walk(np.random.default_rng(4), 60)
    weight, still = ends_exact(60), np.zeros((2, 3))
    grid = BlendedGrid(time)
    each = grid.fit_each(q, lam=np.array([1e-5, 1e-3, 1e-5]), weight=weight, velocity=still)
    for column, lam in enumerate((1e-5, 1e-3, 1e-5)):
        alone = grid.fit(q, lam=lam, weight=weight, velocity=still)
        assert (each.position[:, column] == alone.position[:, column]).all()
        assert (each.velocity[:, column] == alone.velocity[:, column]).all()
    assert (each.time == time).all()


def test_options_choose_the_grid():
    time = np.arange(10) * 0.04
    assert isinstance(grid_for(time, Config(ends="soft")), BlendedGrid)
    assert not isinstance(grid_for(time, Config(ends="rest")), BlendedGrid)
    assert grid_for(time, Config(ends="rest")).clamped
    assert not grid_for(time, Config(ends="natural")).clamped
