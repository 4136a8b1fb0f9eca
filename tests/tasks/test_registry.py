"""What every task promises, over all that are registered, and where they are found."""

import numpy as np
import pytest

from coordlog.contracts import Reading
from coordlog.errors import ConfigError
from coordlog.robots.humanoid import HUMANOID
from coordlog.sim.env import BatchEnv
from coordlog.spec import after, before, names
from coordlog.tasks import registry
from coordlog.tasks.config import EnvConfig, RewardConfig
from coordlog.tasks.progress import Progress
from coordlog.tasks.registry import TASKS, follow, make_task, task_of
from coordlog.tasks.scene import SCENES, Scene

K, N = 2, 5


def task(name, **config):
    return make_task(name, EnvConfig(**config), RewardConfig())


def reading(rng, *, near=0.02):
    goals = rng.uniform(-0.3, 0.3, (N, K, 3))
    return Reading(
        angles=rng.uniform(-1, 1, (N, 13)),
        velocities=np.zeros((N, 13)),
        palms=goals + rng.uniform(-near, near, (N, K, 3)),
        goals=goals,
        spheres=np.zeros((N, 0, 4)),
        links=None,
        com=rng.uniform(-0.1, 0.1, (N, 2)),
        collision=rng.random(N) < 0.3,
        instability=rng.random(N) < 0.3,
    )


@pytest.mark.parametrize("name", list(TASKS))
def test_columns_are_the_declared_fields_and_types(name, rng):
    rules, seen = task(name), reading(rng)
    found = follow(rules, rules.measure(seen))
    own = after(rules.fields)
    assert set(found) == {*names(own), "reward", "terminated"}
    for field in own:
        assert found[field.name].dtype == field.type
        assert found[field.name].shape == ((N, K) if field.size else (N,))
        assert field.owner == name
    assert found["reward"].shape == (N, K)
    assert set(rules.given(seen)) == set(names(before(rules.fields)))


@pytest.mark.parametrize("name", list(TASKS))
def test_steps_together_and_one_by_one_give_the_same_bits(name, rng):
    rules = task(name)
    measured = rules.measure(reading(rng, near=0.05))
    together = follow(rules, measured)
    for row in range(N):
        alone = follow(rules, {key: value[row : row + 1] for key, value in measured.items()})
        for key, value in alone.items():
            assert value.tobytes() == together[key][row : row + 1].tobytes(), key


@pytest.mark.parametrize("name", list(TASKS))
def test_a_record_gives_the_task_again(name):
    env = BatchEnv(Scene("own", "", HUMANOID, task=name), n=1, threads=1)
    again = task_of(env.describe())
    assert again.name == name
    assert again.to_json() == env.task.rules.to_json()


def test_an_old_record_is_of_the_reach_task():
    env = BatchEnv(SCENES["planar"], n=1, threads=1).describe()
    del env["task"]
    assert task_of(env).name == "reach"


def test_an_unknown_task_or_constant_lists_the_choices():
    with pytest.raises(ConfigError, match="unknown task 'juggle'; choose one of: hold, reach"):
        task("juggle")
    with pytest.raises(ConfigError, match=r"unknown constant of task hold 'task.speed'"):
        make_task("hold", EnvConfig(), RewardConfig(), {"speed": 2})
    with pytest.raises(ConfigError, match="task 'reach': expected no constants of its own"):
        make_task("reach", EnvConfig(), RewardConfig(), {"speed": 2})
    with pytest.raises(ConfigError, match="task seconds: expected a positive number, got 0"):
        make_task("hold", EnvConfig(), RewardConfig(), {"seconds": 0.0})


def counted(rules, goal, *, truncated=True, collision=()):
    """What a progress makes of one episode, step by step and as one block."""
    steps, ids = len(goal), np.array([0])
    columns = {
        "goal": np.array(goal, dtype=bool),
        "collision": np.isin(np.arange(steps), collision),
        "instability": np.zeros(steps, dtype=bool),
        "truncated": np.arange(steps) == (steps - 1 if truncated else -1),
    }
    single, block = Progress(rules, 1), Progress(rules, 1)
    for step in range(steps):
        single.add(ids, {key: value[step : step + 1] for key, value in columns.items()})
    block.block(columns)
    found = [(bool(p.success(ids)[0]), bool(p.clean(ids)[0])) for p in (single, block)]
    assert found[0] == found[1]
    return found[0]


def test_success_at_any_step_and_throughout():
    reach, hold = task("reach"), task("hold")
    there, away, half = [True, True], [False, False], [True, False]
    assert counted(reach, [away, there], truncated=False) == (True, True)
    assert counted(reach, [half, [False, True]]) == (False, False)
    assert counted(reach, [away, there], collision=[0]) == (True, False)
    assert counted(hold, [there, there]) == (True, True)
    assert counted(hold, [there, there], collision=[1]) == (True, False)
    assert counted(hold, [there, away, there]) == (False, False)
    assert counted(hold, [there, there], truncated=False) == (False, False), "cut short by a fall"


def test_another_episode_begins_afresh():
    rules, ids = task("hold"), np.array([0, 1])
    progress = Progress(rules, 2)
    row = {
        "goal": np.array([[True, True], [False, True]]),
        "collision": np.array([False, True]),
        "instability": np.zeros(2, bool),
        "truncated": np.ones(2, bool),
    }
    progress.add(ids, row)
    assert progress.success(ids).tolist() == [True, False]
    progress.forget(ids[1:])
    row["goal"], row["collision"] = np.ones((2, 2), bool), np.zeros(2, bool)
    progress.add(ids, row)
    assert progress.clean(ids).tolist() == [True, True]


def test_a_task_registers_itself_and_takes_no_other_ones_name(monkeypatch):
    class Hasty(TASKS["reach"][0]):
        name = "hasty"

    monkeypatch.setattr(registry, "TASKS", dict(TASKS))
    registry.register(Hasty)
    registry.register(Hasty)  # a file that is run again
    assert isinstance(task("hasty"), Hasty)
    Hasty.name = "hold"
    with pytest.raises(ConfigError, match="task 'hold': expected a name that no other task has"):
        registry.register(Hasty)
