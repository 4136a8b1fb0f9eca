"""What every policy and every environment promises, as tests that a class of their own inherits."""

import numpy as np

from coordlog.episode import CONTACT
from coordlog.sim.rollout import policy_rng


class PolicyContract:
    """Override `make(env)`.

    The module offers a fixture `env` of four simulations that have been reset.
    """

    def begun(self, env, ids):
        policy = self.make(env)
        policy.begin(ids, env.state[ids], [policy_rng(0, "train", int(i)) for i in ids])
        return policy

    def test_actions_are_float32_in_range_one_row_per_slot(self, env):
        for ids in (np.arange(env.n), np.array([1, 3])):
            action = self.begun(env, ids).act(ids, env.state[ids])
            assert action.shape == (len(ids), len(env.task.servos))
            assert action.dtype == np.float32
            assert np.abs(action).max() <= 1.0

    def test_equal_generators_and_states_give_equal_actions(self, env):
        ids = np.arange(env.n)
        one, other = self.begun(env, ids), self.begun(env, ids)
        for _ in range(3):
            assert (
                one.act(ids, env.state[ids]).tobytes() == other.act(ids, env.state[ids]).tobytes()
            )

    def test_a_slot_acts_the_same_alone_and_in_company(self, env):
        everyone, alone = np.arange(env.n), np.array([2])
        crowd, single = self.begun(env, everyone), self.begun(env, alone)
        for _ in range(3):
            together = crowd.act(everyone, env.state)[2]
            assert single.act(alone, env.state[alone])[0].tobytes() == together.tobytes()

    def test_it_may_begin_again(self, env):
        ids = np.array([0])
        policy = self.begun(env, ids)
        first = policy.act(ids, env.state[ids])
        policy.begin(ids, env.state[ids], [policy_rng(0, "train", 0)])
        assert policy.act(ids, env.state[ids]).tobytes() == first.tobytes()


class EnvContract:
    """Override `make(n)`, an environment of n simulations, and set `k` arms, `n_u` actions and
    `n_x` state entries."""

    k: int
    n_u: int
    n_x: int

    def started(self, n):
        env = self.make(n)
        env.reset(
            np.arange(n), [env.problem(seed=0, split="train", index=index) for index in range(n)]
        )
        return env

    def actions(self, n, steps):
        return np.random.default_rng(0).uniform(-1, 1, (steps, n, self.n_u)).astype(np.float32)

    def test_knows_how_many_it_is_and_shows_a_state_for_each(self):
        env = self.started(3)
        assert env.n == 3
        assert env.state.shape == (3, self.n_x)
        assert env.state.dtype == np.float32

    def test_an_outcome_has_one_row_per_simulation_stepped(self):
        env = self.started(3)
        ids = np.array([0, 2])
        outcome = env.step(self.actions(2, 1)[0], ids)
        for name in ("reward", "distance", "boundary", "goal"):
            assert getattr(outcome, name).shape == (2, self.k), name
        for name in ("collision", "instability", "terminated", "truncated", "diverged"):
            column = getattr(outcome, name)
            assert column.shape == (2,), name
            assert column.dtype == bool, name
        assert len(outcome.contacts) == 2
        assert all(rows.dtype == CONTACT for rows in outcome.contacts)
        assert outcome.reward.dtype == outcome.distance.dtype == np.float64

    def test_only_the_simulations_named_move(self):
        env = self.started(3)
        before = env.state.copy()
        env.step(self.actions(1, 1)[0], np.array([1]))
        assert (env.state[[0, 2]] == before[[0, 2]]).all()
        assert (env.state[1] != before[1]).any()

    def test_terminated_and_truncated_exclude_one_another(self):
        env = self.started(2)
        running = np.arange(2)
        for action in self.actions(2, 200):
            outcome = env.step(action[running], running)
            assert not (outcome.terminated & outcome.truncated).any()
            running = running[~(outcome.terminated | outcome.truncated)]
            if not len(running):
                return
        raise AssertionError("no episode ended within 200 steps")

    def test_a_reset_forgets_the_episode_before(self):
        env = self.started(2)
        first = env.state.copy()
        for action in self.actions(2, 5):
            env.step(action, np.arange(2))
        env.reset(
            np.arange(2), [env.problem(seed=0, split="train", index=index) for index in range(2)]
        )
        assert env.state.tobytes() == first.tobytes()

    def test_equal_actions_give_equal_outcomes(self):
        traces = []
        for _ in range(2):
            env = self.started(2)
            trace = [env.step(action, np.arange(2)) for action in self.actions(2, 5)]
            traces.append(
                b"".join(outcome.reward.tobytes() + outcome.distance.tobytes() for outcome in trace)
                + env.state.tobytes()
            )
        assert traces[0] == traces[1]
