"""What training takes from a log's record of its environment."""

from __future__ import annotations

import numpy as np
import pytest

from coordlog.errors import SpecError
from coordlog.sim.env import BatchEnv
from coordlog.tasks import registry
from coordlog.tasks.config import RewardConfig
from coordlog.tasks.reach.task import ReachTask
from coordlog.tasks.scene import SCENES
from coordlog.train.bind import learning_task, require_alike
from coordlog.train.relabel import outcome


@pytest.fixture(scope="module")
def records() -> dict[str, dict[str, object]]:
    return {name: BatchEnv(SCENES[name], n=1, threads=1).describe() for name in ("planar", "hold")}


def test_rewards_and_endings_are_those_of_the_records_task(records) -> None:  # type: ignore[no-untyped-def]
    flags = np.array([[True, True]]), np.array([[True, True]])
    still = np.zeros(1, bool)
    hold = learning_task(records["hold"])
    assert hold.reward(np.zeros((1, 2)), *flags, still, still) == pytest.approx(0.4)
    assert not hold.ended(flags[1], still).any(), "being there does not end it"
    assert hold.ended(flags[1], ~still).all()
    there = np.ones((1, 3), bool)
    reach = learning_task(records["planar"], reward=RewardConfig(kappa=77.0))
    assert (reach.reward(np.zeros((1, 3)), there, there, still, still) == 77.0).all()
    assert reach.ended(there, still).all()


def test_goals_in_hindsight_are_judged_by_the_same_task(records) -> None:  # type: ignore[no-untyped-def]
    task, still = learning_task(records["hold"]), np.zeros(1, bool)
    assert task.view is not None
    points = np.full((1, 2, 3), 0.3)
    found = outcome(
        task.view, task.reward, palms=points, goals=points, collision=still, instability=still
    )
    assert found.goal.all()
    assert not found.terminated.any()
    assert found.reward == pytest.approx(0.4)


def test_a_task_whose_reward_needs_more_than_training_keeps_is_refused(
    records,  # type: ignore[no-untyped-def]
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Hurried(ReachTask):
        name = "hurried"

        def reward(self, columns):  # type: ignore[no-untyped-def]
            return super().reward(columns) - columns["hurry"][:, None]

    monkeypatch.setattr(registry, "TASKS", registry.TASKS | {"hurried": (Hurried, None)})
    with pytest.raises(SpecError, match=r"task 'hurried': .* got some that depend on 'hurry'"):
        learning_task(records["planar"] | {"task": {"name": "hurried"}})


def test_logs_of_two_tasks_are_not_learnt_from_together(records) -> None:  # type: ignore[no-untyped-def]
    first = records["hold"]
    other = first | {"task": {"name": "reach"}}
    require_alike(first, dict(first), where="a")
    with pytest.raises(SpecError, match="b: its task is reach, that of the other logs hold"):
        require_alike(first, other, where="b")
