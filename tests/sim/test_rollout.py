"""The one loop: every episode once, each the same whatever runs beside it, and a recorder is an
environment like any other."""

from itertools import count, islice
from types import SimpleNamespace

import numpy as np
import pytest

from coordlog.contracts import Outcome
from coordlog.errors import SpecError
from coordlog.policies.noise import Random, RandomConfig, Still
from coordlog.record.recorder import Recorder
from coordlog.sim.env import BatchEnv
from coordlog.sim.rollout import policy_rng, rollout
from coordlog.sim.scoring import judged
from coordlog.tasks.config import EnvConfig
from coordlog.tasks.scene import SCENES
from tests.contracts import EnvContract


class Scripted:
    """An environment without physics: episode i lasts `lengths[i]` steps and ends in the way
    `ends[i]` names."""

    def __init__(self, n, lengths, ends=None):
        self.n, self.lengths, self.ends = n, lengths, ends or {}
        self.state = np.zeros((n, 2), dtype=np.float32)  # episode, step
        self.log = []

    def problem(self, *, seed, split, index):
        return SimpleNamespace(seed=seed, split=split, index=index)

    def reset(self, ids, problems):
        self.log.append(("reset", ids.tolist(), [problem.index for problem in problems]))
        for slot, problem in zip(ids, problems, strict=True):
            self.state[slot] = problem.index, 0

    def step(self, action, ids):
        self.log.append(("step", ids.tolist(), action.copy()))
        self.state[ids, 1] += 1
        over = np.array(
            [self.state[slot, 1] >= self.lengths[int(self.state[slot, 0])] for slot in ids]
        )
        kinds = [self.ends.get(int(self.state[slot, 0]), "terminated") for slot in ids]
        flags = {
            name: over & np.array([kind == name for kind in kinds])
            for name in ("terminated", "truncated", "diverged")
        }
        none = np.zeros((len(ids), 1))
        diverged = flags.pop("diverged")
        return Outcome({"reward": none, **flags}, diverged, contacts=[])


class Counting(Still):
    """Remembers what it is asked."""

    def __init__(self):
        super().__init__(1)
        self.begun, self.asked = [], []

    def begin(self, ids, state, rngs):
        self.begun += [
            (int(slot), int(row[0]), rng.standard_normal())
            for slot, row, rng in zip(ids, state, rngs, strict=True)
        ]

    def act(self, ids, state):
        self.asked.append((ids.tolist(), state.copy()))
        return super().act(ids, state)


def played(env, policy, episodes, **options):
    """All that the loop yields, and the indices of the episodes as they end."""
    order = []
    for ids, outcome in rollout(env, policy, episodes, seed=0, **options):
        over = outcome.terminated | outcome.truncated | outcome.diverged
        order += [int(env.state[slot, 0]) for slot in ids[over]]
    return order


@pytest.mark.parametrize("n", [1, 2, 3, 7, 20])
def test_every_episode_is_played_once(n):
    lengths = [3, 1, 4, 1, 5, 9, 2, 6, 5, 3]
    env = Scripted(n, lengths, {4: "truncated", 7: "diverged"})
    assert sorted(played(env, Counting(), range(10))) == list(range(10))
    started = [index for kind, _, indices in env.log if kind == "reset" for index in indices]
    assert started == list(range(10))  # in order
    steps = sum(len(ids) for kind, ids, _ in env.log if kind == "step")
    assert steps == sum(lengths)  # and not a step more


def test_a_free_simulation_starts_the_next_episode_at_once():
    env = Scripted(2, [5, 2, 2, 9])
    played(env, Counting(), range(4))
    resets = [(ids, indices) for kind, ids, indices in env.log if kind == "reset"]
    assert resets == [([0, 1], [0, 1]), ([1], [2]), ([1], [3])]
    assert [ids for kind, ids, _ in env.log if kind == "step"][:5] == [[0, 1]] * 5


def test_nothing_to_do_is_done_at_once():
    env = Scripted(3, [])
    assert list(rollout(env, Counting(), [], seed=0)) == []
    assert env.log == []


def test_any_indices_may_be_asked_for_and_they_may_never_end():
    env = Scripted(2, {7: 2, 3: 1, 100: 4})
    assert sorted(played(env, Counting(), iter([7, 3, 100]))) == [3, 7, 100]
    endless = rollout(Scripted(3, [2] * 10_000), Counting(), count(), seed=0)
    assert len(list(islice(endless, 50))) == 50


def test_simulations_in_the_middle_of_an_episode_go_on_with_it():
    env, policy = Scripted(3, [9, 9, 2, 5]), Counting()
    env.reset(np.arange(2), [env.problem(seed=0, split="train", index=index) for index in range(2)])
    order = played(env, policy, [2, 3], running=np.arange(2))
    assert order == [2, 3, 0, 1]
    assert [index for _, index, _ in policy.begun] == [2, 3]  # the others had begun before


def test_the_policy_begins_each_episode_once_with_its_own_generator():
    policy, env = Counting(), Scripted(2, [2, 3, 1, 2])
    played(env, policy, range(4), split="test")
    assert [index for _, index, _ in policy.begun] == [0, 1, 2, 3]
    wanted = [policy_rng(0, "test", index).standard_normal() for index in range(4)]
    assert [value for *_, value in policy.begun] == wanted


def test_the_policy_sees_the_state_of_the_running_simulations_only():
    policy, env = Counting(), Scripted(3, [1, 3, 2])
    played(env, policy, range(3))
    assert [ids for ids, _ in policy.asked] == [[0, 1, 2], [1, 2], [1]]
    assert [state[:, 1].tolist() for _, state in policy.asked] == [[0, 0, 0], [1, 1], [2]]


def test_actions_are_clipped_and_float32():
    class Loud(Still):
        def act(self, ids, state):
            return np.full((len(ids), 1), 5.0)

    env = Scripted(1, [1])
    played(env, Loud(1), range(1))
    (action,) = [what for kind, _, what in env.log if kind == "step"]
    assert action.dtype == np.float32
    assert action.tolist() == [[1.0]]


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_an_action_that_is_no_number_is_refused(value):
    class Broken(Still):
        def act(self, ids, state):
            return np.full((len(ids), 1), value)

    with pytest.raises(SpecError, match=r"action: expected numbers .* from policy Broken"):
        played(Scripted(1, [1]), Broken(1), range(1))


def test_generators_differ_by_seed_split_and_index():
    drawn = {
        policy_rng(seed, split, index).random()
        for seed in range(3)
        for split in ("train", "test")
        for index in range(20)
    }
    assert len(drawn) == 120


def test_an_episode_is_the_same_at_any_width():
    """Real physics, real noise: what an episode is depends on its seed, split and index alone."""
    traces = []
    for n in (1, 3, 8):
        env = BatchEnv(SCENES["spheres"], EnvConfig(max_steps=25), n=n, threads=1 + n % 2)
        playing, done = {}, {}
        for ids, outcome in rollout(env, Random(n, 13), range(7), seed=2):
            for row, slot in enumerate(ids):
                trace = playing.setdefault(int(slot), [])
                trace.append(
                    env.physics.rows[slot].tobytes()
                    + outcome.reward[row].tobytes()
                    + outcome.contacts[row].tobytes()
                )
                if outcome.terminated[row] or outcome.truncated[row]:
                    done[trace[0]] = playing.pop(int(slot))
        traces.append(done)
    assert len(traces[0]) == 7
    assert traces[0] == traces[1] == traces[2]


class TestARecorderIsAnEnvironment(EnvContract):
    k, n_u, n_x = 3, 8, 35

    @pytest.fixture(autouse=True)
    def _folder(self, tmp_path):
        self.folder, self.open = tmp_path, []
        yield
        for recorder in self.open:
            recorder.close()

    def make(self, n):
        policy = {"kind": "random", "name": "random", "checkpoint_sha256": "", "noise": {}}
        recorder = Recorder(
            BatchEnv(SCENES["planar"], n=n, threads=1),
            self.folder / str(len(self.open)),
            policy=policy,
        )
        self.open.append(recorder)
        return recorder


def test_what_is_touched_first_is_counted_once_per_episode_that_touches():
    env = BatchEnv(SCENES["table"], EnvConfig(max_steps=40), n=4, threads=1)
    board = judged(
        env, Random(env.n, 13, RandomConfig(sigma=1.0)), episodes=8, k=2, seed=0, split="train"
    )
    collided = sum(score.collided for score in board.scores)
    assert collided > 0
    assert board.touches.total() == collided
    for pair in board.touches:
        first, second = (env.task.model.geom(geom).name for geom in pair)
        assert not {first, second} <= {"floor", *env.scene.robot.soles}
