"""The scripted expert solves what it is there for. Few episodes here; `bench/` has the many."""

import numpy as np
import pytest

from coordlog.policies.expert import Expert
from coordlog.sim.env import BatchEnv
from coordlog.sim.rollout import rollout
from coordlog.tasks.scene import SCENES

EPISODES = 8


def play(name, *, episodes=EPISODES, split="test"):
    """Success and cleanliness of the expert's episodes, and its last distances [m]."""
    env = BatchEnv(SCENES[name], n=episodes, threads=1)
    touched, ended = np.zeros(episodes, dtype=bool), {}
    policy = Expert(env.task, env.draw.reach, episodes)
    for ids, outcome in rollout(env, policy, range(episodes), seed=0, split=split):
        touched[ids] |= outcome.collision | outcome.instability
        for row in np.flatnonzero(outcome.terminated | outcome.truncated):
            success = bool(outcome.goal[row].all())
            ended[int(ids[row])] = (
                success,
                success and not touched[ids[row]],
                outcome.distance[row],
            )
    success, clean, distance = zip(*ended.values(), strict=True)
    assert len(ended) == episodes
    return sum(success), sum(clean), np.array(distance)


@pytest.mark.parametrize("name", ["free", "table", "shelf"])
def test_the_expert_succeeds_and_touches_nothing(name):
    success, clean, distance = play(name)
    assert success == EPISODES
    assert clean == EPISODES
    assert distance.max() < 0.03


def test_the_expert_finds_its_way_among_spheres():
    success, clean, _ = play("spheres")
    assert success >= 7
    assert clean >= 6


def test_the_expert_is_no_more_than_its_plan_and_repeats_itself():
    env = BatchEnv(SCENES["shelf"], n=2, threads=1)
    traces = []
    for _ in range(2):
        expert = Expert(env.task, env.draw.reach, 2)
        traces.append(
            [outcome.reward.tobytes() for _, outcome in rollout(env, expert, range(2), seed=4)]
        )
    assert traces[0] == traces[1]
    assert 10 < len(traces[0]) < 150
