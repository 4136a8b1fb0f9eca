"""Environments from a scene, tables of constants, and the records of logs and policies."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from coordlog.errors import unknown

if TYPE_CHECKING:
    from coordlog.episode import Json
    from coordlog.sim.env import BatchEnv
    from coordlog.tasks.scene import Scene

TABLES = ("env", "reward", "task")


def true_scene(env: Json) -> Json:
    """A `coordlog.env` record without what made training easier: the scene as it is judged."""
    from coordlog.tasks.config import TRAINING_ONLY

    return {
        **env,
        "config": {key: value for key, value in env["config"].items() if key not in TRAINING_ONLY},
    }


def make_env(
    scene: Scene | str,
    tables: Mapping[str, Any],
    *,
    start: str,
    envs: int,
    threads: int,
    like: Json | None = None,
    doubts: Callable[[str], None] | None = None,
) -> BatchEnv:
    """The batched environment of a scene with these constants.

    Args:
        scene: What to simulate, or the name of one that ships.
        tables: Tables "env", "reward" and "task" of a configuration file, or none; "task" has the
            constants that are the task's own.
        start: Name of the start pose.
        envs: Number of simulations.
        threads: Threads to simulate on.
        like: A `coordlog.env` record whose constants hold where the tables say nothing: those of
            the logs, or of a policy's training.
        doubts: Told what is doubtful about reward constants that the tables name, and about a
            robot that does not ship with coordlog.

    Raises:
        ConfigError: for an unknown scene, pose, table or key, or a value out of range.
    """
    from coordlog.config import build, plain
    from coordlog.sim.doubts import doubts as doubtful
    from coordlog.sim.env import BatchEnv, default_config
    from coordlog.tasks.config import EnvConfig, RewardConfig
    from coordlog.tasks.registry import SAID
    from coordlog.tasks.scene import SCENES, find

    for name in tables:
        if name not in TABLES:
            raise unknown("table", name, TABLES)
    place = find(scene) if isinstance(scene, str) else scene
    before = like or {"config": {}, "reward": {}}
    own = {key: value for key, value in before.get("task", {}).items() if key not in SAID}
    reward = build(RewardConfig, before["reward"] | tables.get("reward", {}))
    config = plain(default_config(place)) | before["config"] | tables.get("env", {})
    constants = build(EnvConfig, config)
    env = BatchEnv(
        place,
        constants,
        reward,
        n=envs,
        threads=threads,
        start=start,
        task=own | tables.get("task", {}),
    )
    if doubts is not None:
        said = reward.doubts(steps=constants.max_steps) if "reward" in tables else []
        if SCENES.get(place.name) is not place:  # of those that ship, the pages tell
            said += doubtful(place.robot, env.task.model)
        for doubt in said:
            doubts(doubt)
    return env
