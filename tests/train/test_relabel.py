from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from coordlog.errors import SpecError
from coordlog.tasks.config import RewardConfig
from coordlog.tasks.reach.reward import Flags, rewards
from coordlog.train.relabel import GoalView, draw_later, outcome, reorder, set_goals, value_bounds
from tests.train import toy_arms as toy

N = 200


def transitions(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    palms, following = rng.normal(size=(2, N, 2, 3))
    goals = rng.normal(size=(N, 2, 3))
    return (
        toy.observed(palms, goals),
        toy.observed(following, goals),
        rng.random(N) < 0.3,
        rng.random(N) < 0.2,
    )


def test_goals_differences_and_nothing_else_change(rng: np.random.Generator) -> None:
    state = transitions(rng)[0]
    before, view = state.copy(), toy.view()
    goals = rng.normal(size=(N, 2, 3))
    set_goals(view, state, goals)
    np.testing.assert_array_equal(state[:, view.palms], before[:, view.palms])
    np.testing.assert_allclose(view.points(state, view.goals), goals, atol=1e-6)
    np.testing.assert_allclose(
        view.points(state, view.difference), goals - view.points(before, view.palms), atol=1e-6
    )
    np.testing.assert_allclose(
        state, toy.observed(view.points(before, view.palms), goals), atol=1e-6
    )


def test_a_state_without_differences_has_only_its_goals_rewritten(rng: np.random.Generator) -> None:
    full = toy.view()
    view = GoalView(
        full.palms,
        full.goals,
        None,
        full.offset,
        full.scale,
        full.goal_radius,
        full.boundary_radius,
    )
    state = transitions(rng)[0]
    before = state.copy()
    set_goals(view, state, rng.normal(size=(N, 2, 3)))
    untouched = [*range(6), *range(12, 18)]
    np.testing.assert_array_equal(state[:, untouched], before[:, untouched])


def test_asking_for_what_the_action_reached_makes_the_goal_true_at_once(
    rng: np.random.Generator,
) -> None:
    _, following, collision, instability = transitions(rng)
    palms = toy.view().points(following, toy.view().palms)
    result = outcome(
        toy.view(),
        toy.reward,
        palms=palms,
        goals=palms,
        collision=collision,
        instability=instability,
    )
    assert result.goal.all()
    assert result.boundary.all()
    assert result.terminated.all()
    assert (result.distance == 0).all()
    sound = ~collision & ~instability
    assert (result.reward[sound] == toy.CONSTANTS.kappa).all()
    assert (result.reward[~sound] < toy.CONSTANTS.kappa).all()
    np.testing.assert_allclose(
        result.reward[instability & ~collision],
        toy.CONSTANTS.m1 + toy.CONSTANTS.m2 - toy.CONSTANTS.n2,
    )


def test_one_palm_at_its_goal_is_not_the_task(rng: np.random.Generator) -> None:
    _, following, _, _ = transitions(rng)
    palms = toy.view().points(following, toy.view().palms)
    goals = palms.copy()
    goals[:, 1] += 3
    nothing = np.zeros(N, bool)
    result = outcome(
        toy.view(), toy.reward, palms=palms, goals=goals, collision=nothing, instability=nothing
    )
    assert result.goal[:, 0].all()
    assert not result.goal[:, 1].any()
    assert not result.terminated.any()
    fallen = outcome(
        toy.view(), toy.reward, palms=palms, goals=goals, collision=nothing, instability=~nothing
    )
    assert fallen.terminated.all()


def test_the_logged_goal_gives_the_logged_outcome(rng: np.random.Generator) -> None:
    source = toy.ToySource(16)
    block = source.collect(
        40,
        lambda state: np.clip(toy.expert(state) + rng.normal(size=(16, toy.N_U)) / 2, -1, 1).astype(
            np.float32
        ),
    )
    flat = {name: array.reshape(-1, *array.shape[2:]) for name, array in block._asdict().items()}
    view = toy.view()
    palms, goals = (view.points(flat["next_state"], place) for place in (view.palms, view.goals))
    result = outcome(
        view,
        toy.reward,
        palms=palms,
        goals=goals,
        collision=flat["collision"],
        instability=flat["instability"],
    )
    assert flat["goal"].any()
    for name in ("goal", "boundary", "terminated"):
        np.testing.assert_array_equal(getattr(result, name), flat[name])
    np.testing.assert_allclose(result.distance, flat["distance"], atol=1e-5)


@given(st.integers(0, 2**32 - 1))
def test_later_is_uniform_between_now_and_the_last_step(seed: int) -> None:
    rng = np.random.default_rng(seed)
    now = rng.integers(0, 50, 300)
    last = now + rng.integers(0, 20, 300)
    later = draw_later(rng, now, last)
    assert ((now <= later) & (later <= last)).all()


def test_later_reaches_both_ends(rng: np.random.Generator) -> None:
    later = draw_later(rng, np.full(20_000, 3), np.full(20_000, 7))
    assert np.bincount(later)[3:] / 20_000 == pytest.approx(0.2, abs=0.02)


@pytest.mark.parametrize("k", [1, 2, 3])
@pytest.mark.parametrize(
    "constants",
    [RewardConfig(), RewardConfig(kappa=100, n2=500), RewardConfig(m1=3, m2=4, n2=0, n1=0)],
)
def test_no_return_leaves_the_bounds_and_some_reach_them(
    k: int, constants: RewardConfig, rng: np.random.Generator
) -> None:
    def reward(distance, boundary, goal, collision, instability):  # type: ignore[no-untyped-def]
        return rewards(distance, Flags(boundary, goal, collision, instability), constants)

    gamma, farthest, steps = 0.9, 0.8, 300
    low, high = value_bounds(reward, k=k, gamma=gamma, farthest=farthest)
    returns = []
    for trial in range(300):
        goal, boundary = rng.random((2, steps, k)) < rng.random()
        collision, instability = (
            rng.random(steps) < rng.random(),
            rng.random(steps) < rng.random() ** 8,
        )
        distance = rng.uniform(0, farthest, (steps, k))
        if trial < 2:  # loiter as well, and suffer as much, as one can
            distance[:], boundary[:], collision[:], instability[:] = (
                farthest * trial,
                trial == 0,
                trial == 1,
                False,
            )
            goal[:] = trial == 0 and k > 1
            goal[:, 0] = False
        earned = reward(distance, boundary, goal, collision, instability)
        ends = np.flatnonzero(instability | goal.all(axis=1))
        length = ends[0] + 1 if len(ends) else steps
        returns.append((gamma ** np.arange(length)) @ earned[:length])
    assert low - 1e-9 <= np.min(returns)
    assert np.max(returns) <= high + 1e-9
    reach = (
        np.min(returns),
        np.max(returns),
        *reward(np.zeros((1, k)), *np.ones((2, 1, k), bool), *np.zeros((2, 1), bool))[0],
    )
    fallen = reward(
        np.full((1, k), farthest), *np.zeros((2, 1, k), bool), np.ones(1, bool), np.ones(1, bool)
    )[0]
    assert min(*reach, *fallen) == pytest.approx(low, rel=1e-6)
    assert max(reach) == pytest.approx(high, rel=1e-6)


def test_a_view_of_uneven_places_is_an_error() -> None:
    with pytest.raises(SpecError, match=r"one width, 3 per arm; got widths \[3, 6\]"):
        GoalView(slice(0, 6), slice(6, 9), None, np.zeros(9), np.ones(9), 0.03, 0.1)
    with pytest.raises(SpecError, match=r"got widths \[4\]"):
        GoalView(slice(0, 4), slice(4, 8), None, np.zeros(8), np.ones(8), 0.03, 0.1)


def test_spheres_are_listed_in_an_order_of_chance_and_nothing_else_changes(
    rng: np.random.Generator,
) -> None:
    state, following = rng.normal(size=(2, 600, 24)).astype(np.float32)
    spheres, near = slice(5, 17), slice(18, 24)
    following[:, spheres], following[:, near] = state[:, spheres], state[:, near]
    before = state.copy()
    reorder(rng, 3, (spheres, near), state, following)
    for place in (spheres, near):
        np.testing.assert_array_equal(state[:, place], following[:, place])
    others = np.r_[spheres, near]
    np.testing.assert_array_equal(
        np.delete(state, others, axis=1), np.delete(before, others, axis=1)
    )
    old, new = (
        np.concatenate([rows[:, place].reshape(600, 3, -1) for place in (spheres, near)], axis=2)
        for rows in (before, state)
    )
    order = (new[:, :, None] == old[:, None]).all(axis=-1).argmax(axis=2)
    np.testing.assert_array_equal(np.take_along_axis(old, order[:, :, None], axis=1), new)
    assert len(np.unique(order, axis=0)) == 6
    assert np.bincount(order[:, 0]).min() > 150
