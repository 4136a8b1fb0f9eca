"""The paper's reward, term by term, against a scalar transcription of its equation."""

from itertools import product

import numpy as np
import pytest

from coordlog.errors import ConfigError
from coordlog.tasks.config import EnvConfig, RewardConfig
from coordlog.tasks.reach.reward import Flags, distances, ended, proximity, rewards

CONFIG = RewardConfig(alpha=2.0, n1=0.5, n2=7.0, m1=0.11, m2=0.31, kappa=40.0)


def paper(distance, boundary, goal, collision, instability, config):
    """Reward of both arms as the paper prints it: r_i = -α dist_i, each flag that holds adds its
    term, κ overrides both."""
    if all(goal) and not collision and not instability:
        return [config.kappa] * len(distance)
    found = []
    for i in range(len(distance)):
        r = -config.alpha * distance[i]
        if collision:
            r -= config.n1
        if instability:
            r -= config.n2
        if boundary[i]:
            r += config.m1
        if goal[i]:
            r += config.m2
        found.append(r)
    return found


def flags(boundary=(False, False), goal=(False, False), collision=False, instability=False):
    return Flags(np.array(boundary), np.array(goal), np.array(collision), np.array(instability))


def test_every_combination_of_flags_agrees_with_the_paper():
    distance = np.array([0.21, 0.04])
    for b1, b2, g1, g2, collision, instability in product((False, True), repeat=6):
        wanted = paper(distance, (b1, b2), (g1, g2), collision, instability, CONFIG)
        assert rewards(
            distance, flags((b1, b2), (g1, g2), collision, instability), CONFIG
        ) == pytest.approx(wanted, abs=1e-12)


@pytest.mark.parametrize(
    ("raised", "change"),
    [
        ({"collision": True}, [-0.5, -0.5]),
        ({"instability": True}, [-7.0, -7.0]),
        ({"boundary": (True, False)}, [0.11, 0.0]),
        ({"boundary": (False, True)}, [0.0, 0.11]),
        ({"goal": (True, False)}, [0.31, 0.0]),
        ({"goal": (False, True)}, [0.0, 0.31]),
    ],
)
def test_each_term_alone(raised, change):
    distance = np.array([0.3, 0.2])
    assert rewards(distance, flags(**raised), CONFIG) - rewards(
        distance, flags(), CONFIG
    ) == pytest.approx(change)


def test_distance_costs_its_own_arm_alone():
    near, far = (
        rewards(np.array([0.3, 0.2]), flags(), CONFIG),
        rewards(np.array([0.3, 0.7]), flags(), CONFIG),
    )
    assert far[0] == near[0]
    assert far[1] - near[1] == pytest.approx(-2.0 * 0.5)


def test_kappa_replaces_everything_when_every_goal_holds():
    both = {"boundary": (True, True), "goal": (True, True)}
    assert rewards(np.array([0.02, 0.01]), flags(**both), CONFIG).tolist() == [40.0, 40.0]


@pytest.mark.parametrize("spoiled", ["collision", "instability"])
def test_kappa_is_not_paid_for_a_collision_or_a_fall(spoiled):
    both = {"boundary": (True, True), "goal": (True, True), spoiled: True}
    assert (rewards(np.array([0.02, 0.01]), flags(**both), CONFIG) < 1.0).all()


def test_three_arms_finish_together_or_not_at_all():
    distance = np.full(3, 0.02)
    most = Flags(np.ones(3, bool), np.array([True, True, False]), np.array(False), np.array(False))
    every = most._replace(goal=np.ones(3, bool))
    assert (rewards(distance, most, CONFIG) < 1.0).all()
    assert rewards(distance, every, CONFIG).tolist() == [40.0] * 3


def test_an_episode_ends_on_instability_or_on_all_goals_and_on_nothing_else():
    for b1, b2, g1, g2, collision, instability in product((False, True), repeat=6):
        said = flags((b1, b2), (g1, g2), collision, instability)
        over = ended(said.goal, said.instability)
        assert bool(over) == (instability or (g1 and g2))


def test_radii_are_strict():
    config = EnvConfig(goal_radius=0.03, boundary_radius=0.10)
    boundary, goal = proximity(
        np.array([0.03, np.nextafter(0.03, 0), 0.10, np.nextafter(0.10, 0)]), config
    )
    assert goal.tolist() == [False, True, False, False]
    assert boundary.tolist() == [True, True, False, True]


def test_distances_are_euclidean():
    rng = np.random.default_rng(0)
    palms, goals = rng.normal(size=(5, 7, 2, 3)), rng.normal(size=(5, 7, 2, 3))
    assert distances(palms, goals) == pytest.approx(
        np.linalg.norm(goals - palms, axis=-1), rel=1e-15
    )


def test_a_batch_an_episode_and_a_single_step_give_the_same_bits():
    rng = np.random.default_rng(1)
    palms, goals = rng.normal(size=(64, 2, 3)) * 0.1, rng.normal(size=(64, 2, 3)) * 0.1
    collision, instability = rng.random(64) < 0.3, rng.random(64) < 0.2
    config = EnvConfig(goal_radius=0.12, boundary_radius=0.2)
    distance = distances(palms, goals)
    batch = rewards(distance, Flags(*proximity(distance, config), collision, instability), CONFIG)
    for i in range(64):
        one = distances(palms[i], goals[i])
        assert one.tobytes() == distance[i].tobytes()
        alone = rewards(one, Flags(*proximity(one, config), collision[i], instability[i]), CONFIG)
        assert alone.tobytes() == batch[i].tobytes()
    assert len(np.unique(batch)) > 60


def test_doubts_name_the_constant_that_breaks_an_inequality():
    assert RewardConfig(kappa=30, n2=60).doubts() == []
    (loiter,) = RewardConfig(kappa=10, n2=60).doubts()
    assert "kappa = 10" in loiter
    assert "loitering" in loiter
    (fall,) = RewardConfig(kappa=30, n2=10).doubts()
    assert "n2 = 10" in fall
    assert "falling may pay" in fall


def test_the_bounds_in_the_doubts_are_discounted_sums():
    gamma, steps, farthest = 0.9, 20, 0.5
    horizon = sum(gamma**t for t in range(steps))
    config = RewardConfig()
    enough = RewardConfig(
        kappa=(config.m1 + config.m2) * horizon + 1e-9, n2=config.alpha * farthest * horizon + 1e-9
    )
    assert enough.doubts(gamma=gamma, steps=steps, farthest=farthest) == []
    short = RewardConfig(kappa=enough.kappa - 1e-6, n2=enough.n2 - 1e-6)
    assert len(short.doubts(gamma=gamma, steps=steps, farthest=farthest)) == 2
    assert RewardConfig(kappa=0.4 * 20 + 1e-9, n2=1000).doubts(gamma=1.0, steps=20) == []
    assert len(RewardConfig(kappa=0.4 * 20 - 1e-6, n2=1000).doubts(gamma=1.0, steps=20)) == 1


def test_a_negative_constant_is_refused():
    for name in ("alpha", "n1", "n2", "m1", "m2", "kappa"):
        with pytest.raises(ConfigError, match=f"reward {name}: expected a number ≥ 0, got -1"):
            RewardConfig(**{name: -1})
        with pytest.raises(ConfigError, match="got nan"):
            RewardConfig(**{name: float("nan")})
