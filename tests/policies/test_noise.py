"""What every policy promises, and the statistics of the noise."""

import numpy as np
import pytest

from coordlog.policies.expert import Expert
from coordlog.policies.noise import ActionNoise, Noisy, Random, RandomConfig, Still
from coordlog.sim.env import BatchEnv
from coordlog.tasks.scene import SCENES
from tests.contracts import PolicyContract

N = 4


@pytest.fixture(scope="module")
def env():
    env = BatchEnv(SCENES["free"], n=N, threads=1)
    env.reset(np.arange(N), [env.problem(seed=0, split="train", index=index) for index in range(N)])
    return env


class TestStill(PolicyContract):
    def make(self, env):
        return Still(13)

    def test_does_nothing(self, env):
        assert not self.make(env).act(np.arange(N), env.state).any()


class TestRandom(PolicyContract):
    def make(self, env):
        return Random(N, 13)


class TestNoisyStill(PolicyContract):
    def make(self, env):
        return Noisy(Still(13), N, 13, sigma=0.3)


class TestExpert(PolicyContract):
    def make(self, env):
        return Expert(env.task, env.draw.reach, N)


class TestNoisyExpert(PolicyContract):
    def make(self, env):
        return Noisy(Expert(env.task, env.draw.reach, N), N, 13, sigma=0.1, correlation=0.5)


def run(noise, *, steps, seed=0, n=N):
    noise.begin(np.arange(n), [np.random.default_rng([seed, i]) for i in range(n)])
    return np.stack([noise.draw(np.arange(n)) for _ in range(steps)])


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.9])
def test_noise_has_the_standard_deviation_and_correlation_asked_for(correlation):
    drawn = run(ActionNoise(N, 50, sigma=0.3, correlation=correlation), steps=1500)
    assert drawn.mean() == pytest.approx(0.0, abs=0.01)
    assert drawn.std() == pytest.approx(0.3, rel=0.03)
    assert drawn[0].std() == pytest.approx(0.3, rel=0.2)  # from the first step on
    for lag in (1, 3):
        measured = (drawn[lag:] * drawn[:-lag]).mean() / (drawn * drawn).mean()
        assert measured == pytest.approx(correlation**lag, abs=0.03)


def test_noise_of_different_actions_and_slots_is_independent():
    drawn = run(ActionNoise(N, 5, sigma=1.0, correlation=0.0), steps=3000).reshape(3000, -1)
    off = np.corrcoef(drawn.T) - np.eye(drawn.shape[1])
    assert np.abs(off).max() < 0.08


def test_a_slots_noise_depends_on_its_own_generator_alone():
    alone = ActionNoise(N, 5, sigma=1.0, correlation=0.5)
    alone.begin(np.array([2]), [np.random.default_rng(7)])
    wanted = np.stack([alone.draw(np.array([2]))[0] for _ in range(20)])
    crowd = ActionNoise(N, 5, sigma=1.0, correlation=0.5)
    crowd.begin(np.arange(N), [np.random.default_rng(seed) for seed in (1, 2, 7, 3)])
    got = np.stack([crowd.draw(np.arange(N))[2] for _ in range(20)])
    assert got.tobytes() == wanted.tobytes()


def test_an_episodes_noise_does_not_depend_on_the_slot_or_the_one_before_it():
    noise = ActionNoise(N, 5, sigma=1.0, correlation=0.9)
    noise.begin(np.array([0]), [np.random.default_rng(1)])
    first = np.stack([noise.draw(np.array([0]))[0] for _ in range(5)])
    noise.begin(np.array([3]), [np.random.default_rng(99)])
    noise.draw(np.array([3]))
    noise.begin(np.array([3]), [np.random.default_rng(1)])
    assert np.stack([noise.draw(np.array([3]))[0] for _ in range(5)]).tobytes() == first.tobytes()


def test_random_actions_are_correlated_in_time_and_clipped():
    policy = Random(N, 20, RandomConfig(sigma=1.5))
    policy.begin(np.arange(N), np.zeros((N, 1)), [np.random.default_rng(i) for i in range(N)])
    acted = np.stack([policy.act(np.arange(N), np.zeros((N, 1))) for _ in range(600)]).astype(
        np.float64
    )
    assert np.abs(acted).max() == 1.0
    inner = (acted[1:] * acted[:-1]).mean() / (acted * acted).mean()
    assert inner == pytest.approx(RandomConfig().correlation, abs=0.05)


def test_noise_around_a_policy_and_the_policy_have_generators_of_their_own():
    class Greedy(Still):
        def __init__(self, n_u, draws):
            super().__init__(n_u)
            self.draws = draws

        def begin(self, ids, state, rngs):
            self.drawn = [rng.standard_normal(self.draws).tolist() for rng in rngs]

    acted, drawn = [], []
    for draws, sigma in ((1, 0.1), (7, 0.1), (7, 0.2)):
        greedy = Greedy(5, draws)
        policy = Noisy(greedy, N, 5, sigma=sigma)
        policy.begin(np.arange(N), np.zeros((N, 1)), [np.random.default_rng(i) for i in range(N)])
        acted.append(policy.act(np.arange(N), np.zeros((N, 1))))
        drawn.append([values[0] for values in greedy.drawn])
    assert acted[0].tobytes() == acted[1].tobytes()  # the noise does not care what the policy draws
    assert acted[2] == pytest.approx(2 * acted[1], rel=1e-6)
    assert drawn[0] == drawn[1] == drawn[2]  # nor the other way round
    assert not np.isclose(acted[0][:, 0] / 0.1, drawn[0]).any()
