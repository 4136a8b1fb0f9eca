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

TASKS: dict[str, tuple[type[Any], type[Any] | None]] = {
    "reach": (ReachTask, None),
    "hold": (HoldTask, HoldConfig),
}
"""By name: the task, and the dataclass of its own constants if it has any."""
GROUP = "coordlog.tasks"
