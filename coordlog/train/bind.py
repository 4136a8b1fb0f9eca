"""From what a log or an environment says of itself (its `coordlog.env` record) to what training
needs to know.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from coordlog.config import build, plain
from coordlog.contracts import Task as Rules
from coordlog.episode import Array, Json
from coordlog.errors import SpecError
from coordlog.robots.robot import Robot
from coordlog.spec import LEARNT, names, owned
from coordlog.tasks import registry
from coordlog.tasks.config import EnvConfig, RewardConfig
from coordlog.tasks.reach.observation import StateView
from coordlog.train.columns import Columns
from coordlog.train.relabel import GoalView
from coordlog.train.task import Motion, Task

FARTHEST = 2.0
"""A palm is taken to be no further from its goal than this many workspace radii.

Bounds the return.
"""
SPHERES = ("spheres", "nearness")
"""Parts of a state that tell of one sphere after the other."""
SPHERE = 4
"""Entries of a sphere in the first of them: where it is, and its radius."""
NEEDED = names(owned(LEARNT, "reach"))
"""Columns of a task that there must be for it to be learnt: rewards depend on nothing else."""
SAME = ("robot", "action_joints", "arms", "layout", "state", "state_offset", "state_scale")
"""Keys of the record that must agree for logs to be learnt from together."""


def learning_task(env: Json, *, reward: RewardConfig | None = None) -> Task:
    """The task that a `coordlog.env` record describes.

    Args:
        env: The record.
        reward: Constants to learn from instead of those the record names.

    Raises:
        ConfigError: if the task is not installed.
        SpecError: if it has no goals for the palms.
    """
    if reward is not None:
        env = env | {"reward": plain(reward)}
    rules = registry.task_of(env)
    _require_learnable(rules, env["layout"]["k"])
    layout, places = env["layout"], StateView.from_json(env).places
    listed = tuple(places[name] for name in SPHERES if name in places)
    spheres = (
        (places["spheres"].stop - places["spheres"].start) // SPHERE if "spheres" in places else 0
    )
    return Task(
        n_x=layout["n_x"],
        n_u=layout["n_u"],
        arms=env["arms"],
        reward=partial(_rewards, rules),
        farthest=FARTHEST * env["robot"]["reach"],
        view=goal_view(env, rules),
        motion=motion(env),
        ended=partial(_ended, rules),
        spheres=spheres,
        listed=listed,
    )


def recorded_task(env: Json, logs: Columns) -> Task:
    """The task of an environment that is not ours: its rewards as they were logged, a head for each
    of them.

    Args:
        env: Its `coordlog.env` record.
        logs: What is learnt from.

    Raises:
        SpecError: if every reward is 0.
    """
    rewards = logs.steps["reward"]
    low, high = float(rewards.min()), float(rewards.max())
    if low == high == 0:
        raise SpecError("logs: expected rewards to learn from, got 0 at every step")
    layout = env["layout"]
    return Task(layout["n_x"], layout["n_u"], env["arms"], None, rewards=(low, high))


def goal_view(env: Json, rules: Rules) -> GoalView:
    """Where palms and goals stand in the state of a `coordlog.env` record."""
    view, config = StateView.from_json(env), build(EnvConfig, env["config"])
    difference = view.places.get("difference")
    palms, goals = view.places["palms"], view.places["goals"]
    return GoalView(
        palms,
        goals,
        difference,
        view.offset,
        view.scale,
        config.goal_radius,
        config.boundary_radius,
        partial(_ended, rules),
    )


def motion(env: Json) -> Motion:
    """How far an action moves the joints in one step of a `coordlog.env` record."""
    view, config = StateView.from_json(env), build(EnvConfig, env["config"])
    angles = view.places["angles"]
    speeds = Robot.from_json(env["robot"]).speeds(private=config.speed, shared=config.shared_speed)
    return Motion(angles, speeds * config.control_period / view.scale[angles])


def require_alike(first: Json, other: Json, *, where: str) -> None:
    """Refuse logs of another robot, state, action or control period: the same action would mean
    another motion.

    Raises:
        SpecError: naming what differs.
    """
    for key in SAME:
        if _seen(first.get(key)) != _seen(other.get(key)):
            raise SpecError(
                f"{where}: its {key} is not that of the other logs; train on logs of one robot and "
                "one state layout at a time"
            )
    tasks = [env.get("task", {"name": "reach"})["name"] for env in (first, other)]
    if tasks[0] != tasks[1]:
        raise SpecError(
            f"{where}: its task is {tasks[1]}, that of the other logs {tasks[0]}; "
            "train on logs of one task at a time"
        )
    before, now = (env["config"].get("control_period") for env in (first, other))
    if before != now:
        raise SpecError(
            f"{where}: its control period is {now:g} s, that of the other logs {before:g} s; train "
            "on logs of one period at a time"
        )


def _seen(value: object) -> object:
    """What learning sees of an entry: files of version 1 do not count actuators."""
    return {k: v for k, v in value.items() if k != "n_c"} if isinstance(value, dict) else value


def _require_learnable(rules: Rules, k: int) -> None:
    """Refuse a task whose rewards depend on what training does not keep."""
    missing = [name for name in NEEDED if name not in names(rules.fields)]
    if missing:
        raise SpecError(
            f"task '{rules.name}': expected fields {', '.join(NEEDED)} to learn from, "
            f"got none called {', '.join(missing)}"
        )
    none, flag = np.zeros((1, k), dtype=bool), np.zeros(1, dtype=bool)
    try:
        _rewards(rules, np.zeros((1, k)), none, none, flag, flag)
        _ended(rules, none, flag)
    except KeyError as error:
        raise SpecError(
            f"task '{rules.name}': expected rewards and endings of {', '.join(NEEDED)} alone to "
            f"learn from, got some that depend on {error}"
        ) from None


def _rewards(
    rules: Rules,
    distance: Array,
    boundary: Array,
    goal: Array,
    collision: Array,
    instability: Array,
) -> Array:
    every = (distance, boundary, goal, collision, instability)
    return rules.reward(dict(zip(NEEDED, every, strict=True)))


def _ended(rules: Rules, goal: Array, instability: Array) -> Array:
    return rules.ended({"goal": goal, "instability": instability})
