"""The options that say which environment: a scene, its start pose, and constants from a file."""

from __future__ import annotations

import runpy
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coordlog.commands.terminal import note
from coordlog.errors import ConfigError, unknown

if TYPE_CHECKING:
    from coordlog.episode import Json
    from coordlog.sim.env import BatchEnv
    from coordlog.tasks.scene import Scene

TABLES = ("env", "reward")


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a configuration file.

    Raises:
        ConfigError: if the file cannot be read or is no TOML.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot read the configuration: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: expected TOML, got: {error}") from error


def scene_of(name: str) -> Scene:
    """The scene that a person asks for: one that ships, or one of their own as FILE.py:NAME, for
    which the file is run.

    Names that come out of logs and policy files go to `sim.scene.find` instead: what somebody sent
    must not run anything.

    Raises:
        ConfigError: for an unknown name, a file that cannot be run, or a name in it that is no
            scene.
    """
    from coordlog.tasks.scene import Scene, find

    file, colon, attribute = name.rpartition(":")
    if not colon:
        return find(name)
    try:
        found = runpy.run_path(file)
    except Exception as error:  # the file is the user's, and so is whatever it raises
        raise ConfigError(
            f"{file}: cannot be run for its scenes: {type(error).__name__}: {error}"
        ) from error
    scenes = [key for key, value in found.items() if isinstance(value, Scene)]
    if attribute not in scenes:
        raise unknown(f"scene of {file}", attribute, scenes)
    own: Scene = found[attribute]
    return own


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
    doubts: bool = True,
) -> BatchEnv:
    """The batched environment that the options describe; doubtful reward constants of a
    configuration are said aloud.

    Args:
        scene: What to simulate, or the name of one that ships.
        tables: Tables "env" and "reward" of a configuration file, or none.
        start: Name of the start pose.
        envs: Number of simulations.
        threads: Threads to simulate on.
        doubts: Say what is doubtful; off for a second environment of the same constants.
        like: A `coordlog.env` record whose constants hold where the tables say nothing: those of
            the logs, or of a policy's training.

    Raises:
        ConfigError: for an unknown scene, pose, table or key, or a value out of range.
    """
    from coordlog.config import build
    from coordlog.sim.env import BatchEnv
    from coordlog.tasks.config import EnvConfig, RewardConfig
    from coordlog.tasks.scene import find

    for name in tables:
        if name not in TABLES:
            raise unknown("table", name, TABLES)
    before = like or {"config": {}, "reward": {}}
    reward = build(RewardConfig, before["reward"] | tables.get("reward", {}))
    constants = build(EnvConfig, before["config"] | tables.get("env", {}))
    if doubts and "reward" in tables:
        for doubt in reward.doubts(steps=constants.max_steps):
            note(doubt)
    return BatchEnv(
        find(scene) if isinstance(scene, str) else scene,
        constants,
        reward,
        n=envs,
        threads=threads,
        start=start,
    )
