"""Which tasks there are: the one place that names them.

A task of another package registers itself with an entry point of the group "coordlog.tasks", whose
name is the task's and whose value is its class.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import entry_points
from typing import Any

from coordlog.config import build
from coordlog.contracts import Task
from coordlog.episode import Array, Json
from coordlog.errors import ConfigError, unknown
from coordlog.tasks.config import EnvConfig, RewardConfig
from coordlog.tasks.hold.task import HoldConfig, HoldTask
from coordlog.tasks.reach.task import ReachTask
from coordlog.tasks.unknown import UnknownTask

TASKS: dict[str, tuple[type[Any], type[Any] | None]] = {
    "reach": (ReachTask, None),
    "hold": (HoldTask, HoldConfig),
}
"""By name: the task, and the dataclass of its own constants if it has any."""
GROUP = "coordlog.tasks"
SAID = ("name", "fields")
"""What a `coordlog.env` record says of a task besides the constants that are the task's own."""


def register(task: type[Any], own: type[Any] | None = None) -> None:
    """Add a task under its name, for this process.

    Args:
        task: Class with the members of `contracts.Task`, made from `EnvConfig`, `RewardConfig` and,
            if it has constants of its own, those.
        own: Frozen dataclass of its own constants.

    Raises:
        ConfigError: if another task has the name.
    """
    if task.name in TASKS and TASKS[task.name][0].__qualname__ != task.__qualname__:
        raise ConfigError(f"task '{task.name}': expected a name that no other task has")
    TASKS[task.name] = (task, own)


def task_class(name: str) -> tuple[type[Any], type[Any] | None]:
    """The class of a task, and that of its own constants (None without any).

    Raises:
        ConfigError: for a name that nothing registers; the message lists those that are.
    """
    if name in TASKS:
        return TASKS[name]
    others = {point.name: point for point in entry_points(group=GROUP)}
    if name not in others:
        raise unknown("task", name, [*TASKS, *others])
    kind = others[name].load()
    return kind, getattr(kind, "constants", None)


def is_installed(name: str) -> bool:
    """Whether a task of this name is registered."""
    return name in TASKS or any(point.name == name for point in entry_points(group=GROUP))


def task_or_unknown(env: Json) -> Task:
    """The task of a `coordlog.env` record; where it is not installed, what the log tells of it.

    Raises:
        ConfigError: if it is installed and does not know a constant that the record names.
    """
    name = env.get("task", {"name": "reach"})["name"]
    return task_of(env) if is_installed(name) else UnknownTask(env)


def make_task(
    name: str,
    config: EnvConfig,
    reward: RewardConfig,
    own: Mapping[str, Any] | None = None,
) -> Task:
    """A task with its constants.

    Args:
        name: As registered.
        config: Constants of the environment.
        reward: Constants of the reward.
        own: The task's own constants by name.

    Raises:
        ConfigError: for an unknown name or constant, or a value out of range.

    Example:
        >>> make_task("reach", EnvConfig(), RewardConfig()).name
        'reach'
    """
    kind, constants = task_class(name)
    if constants is None:
        if own:
            raise ConfigError(f"task '{name}': expected no constants of its own, got {sorted(own)}")
        task: Task = kind(config, reward)
        return task
    own_constants = build(constants, own or {}, prefix="task.", what=f"constant of task {name}")
    task = kind(config, reward, own_constants)
    return task


def task_of(env: Json) -> Task:
    """The task of a `coordlog.env` record. Version 1 files name none: they are of "reach".

    Raises:
        ConfigError: if it is not installed here, or a constant is not one of its.
    """
    said = env.get("task", {"name": "reach"})
    own = {key: value for key, value in said.items() if key not in SAID}
    config, reward = build(EnvConfig, env["config"]), build(RewardConfig, env["reward"])
    return make_task(said["name"], config, reward, own)


def follow(task: Task, measured: Mapping[str, Array]) -> dict[str, Array]:
    """The task's own columns, `reward` and `terminated`, from those columns that were measured.

    Simulation, check and hindsight all come here, so nothing they say of a step can differ.
    """
    columns = {**measured, **task.derive(measured)}
    columns["reward"], columns["terminated"] = task.reward(columns), task.ended(columns)
    return columns
