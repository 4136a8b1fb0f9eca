"""Goals that move: where they go, what is asked for, and that a replay puts them back."""

from dataclasses import replace

import numpy as np
import pytest

from coordlog.contracts import Outcome
from coordlog.policies.scripted import scripted
from coordlog.sim.env import BatchEnv
from coordlog.sim.replay import Log, LogEnv
from coordlog.sim.rollout import rollout
from coordlog.sim.scoring import evaluate
from coordlog.sim.traced import Traced
from coordlog.tasks.config import EnvConfig, RewardConfig
from coordlog.tasks.hold.task import HoldConfig, HoldTask
from coordlog.tasks.scene import find

ONE = np.zeros(1, dtype=np.int64)


@pytest.fixture(scope="module")
def env():
    return BatchEnv(find("hold"), n=3, threads=1)


def test_goals_leave_and_arrive_at_rest_and_never_hurry():
    config = EnvConfig(max_steps=100)
    task = HoldTask(config, RewardConfig(), HoldConfig(seconds=3.0))
    start, way = np.array([[0.1, 0.2, 0.5], [0.1, -0.2, 0.5]]), np.array([0.0, 0.06, 0.08])
    track = task.track(start, way)
    assert track.shape == (101, 2, 3)
    assert track[0].tobytes() == start.tobytes()
    assert track[75:] == pytest.approx(np.broadcast_to(start + way, (26, 2, 3)), abs=1e-15)
    assert np.ptp(track - start, axis=1).max() < 1e-15, "all alike"
    step = np.linalg.norm(np.diff(track[:, 0], axis=0), axis=1)
    assert step[0] < 2e-4
    assert step.max() <= 0.1 * np.pi / 2 / 3.0 * config.control_period + 1e-12


def test_goals_start_on_the_palms_and_can_be_followed(env):
    reach, k = env.draw.reach, 2
    for index in range(8):
        problem = env.problem(seed=1, split="test", index=index)
        assert problem.goals == pytest.approx(reach.palms(problem.angles), abs=1e-12)
        way = problem.track[-1] - problem.track[0]
        assert 0.05 <= np.linalg.norm(way[0]) <= 0.12
        assert problem.track.shape == (76, k, 3)
        found = reach.solve(problem.track[-1])
        assert found is None or np.abs(reach.palms(found) - problem.track[-1]).max() < 3e-3


def test_the_state_and_the_log_say_where_the_goals_are(env):
    ids = np.arange(3)
    problems = [env.problem(seed=0, split="train", index=index) for index in range(3)]
    env.reset(ids, problems)
    for step in range(4):
        wanted = np.array([problem.track[step].ravel() for problem in problems])
        assert env.present(ids)["goals"].tobytes() == wanted.tobytes()
        assert env.task.view.physical(env.state, "goals") == pytest.approx(wanted, abs=1e-6)
        outcome = env.step(np.zeros((3, 13), np.float32), ids)
        palms = env.task.palms(env.physics.sensors)
        after = np.array([problem.track[step + 1] for problem in problems])
        away = np.linalg.norm(palms - after, axis=2)
        assert outcome.distance == pytest.approx(away, abs=1e-12), "to where they are then"


def test_it_lasts_three_seconds_and_only_a_fall_ends_it_before(env):
    scores = evaluate(env, scripted("expert", env), episodes=3, k=2, seed=0)
    assert [score.length for score in scores] == [75] * 3
    assert all(score.clean for score in scores)
    still = evaluate(env, scripted("still", env), episodes=3, k=2, seed=0)
    assert [score.length for score in still] == [75] * 3
    assert not any(score.success for score in still)


def test_a_replay_puts_the_goals_where_they_were(env):
    """With the logged goals all bits come again; without them the goals stand still."""
    from coordlog.episode import Header

    env.reset(ONE, [env.problem(seed=0, split="test", index=1)])
    start = env.physics.rows[0].copy()
    actions = np.random.default_rng(0).uniform(-0.3, 0.3, (12, 13)).astype(np.float32)
    rows, outcomes = [env.present(ONE)], []
    for action in actions:
        outcomes.append(env.step(action[None], ONE))
        rows.append(env.present(ONE))
    columns = {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}
    said = {"kind": "", "name": "", "checkpoint_sha256": "", "noise": {}}
    header = Header({"schema_version": 2, "control_period": 0.04}, env.describe(), said)
    log = Log(header, env.physics.model_of(0), start, actions, {"goals": columns["goals"]})

    def again(log):
        traced = Traced(LogEnv([log]))
        traced.reset(ONE, [traced.problem(seed=0, split="", index=0)])
        for action in actions:
            traced.step(action[None], ONE)
        return traced.trace(0).columns

    found = again(log)
    for name, column in columns.items():
        assert found[name].tobytes() == column.tobytes(), name
    for name in outcomes[0].columns:
        column = np.concatenate([outcome.columns[name] for outcome in outcomes])
        assert found[name].tobytes() == column.tobytes(), name
    lost = again(log._replace(given={}))
    assert lost["qpos"].tobytes() == columns["qpos"].tobytes()
    assert lost["distance"].tobytes() != found["distance"].tobytes()


def test_a_branch_goes_on_along_the_way(env):
    from coordlog.contracts import Branch

    ids = np.array([1])
    problem = env.problem(seed=0, split="train", index=0)
    actions = np.zeros((5, 13), np.float32)
    env.reset(ids, [problem])
    for action in actions:
        env.step(action[None], ids)
    branch = Branch("0" * 64, actions, env.state[1].copy())
    env.reset(ids, [replace(problem, branch=branch)])
    assert env.present(ids)["goals"].tobytes() == problem.track[5].tobytes()
    env.step(actions[0][None], ids)
    assert env.present(ids)["goals"].tobytes() == problem.track[6].tobytes()


def test_every_episode_of_the_loop_ends_where_its_time_is_over(env):
    lengths = np.zeros(3, int)

    def count(ids, outcome: Outcome):
        lengths[ids] += 1
        return lengths[ids] >= 4

    for _ in rollout(env, scripted("still", env), range(3), seed=0, over=count):
        pass
    assert lengths.tolist() == [4, 4, 4]
