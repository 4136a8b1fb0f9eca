"""The options that say which environment: a scene, its start pose, and constants from a file."""

from __future__ import annotations

import runpy
import sys
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coordlog.commands.terminal import note
from coordlog.errors import ConfigError, unknown

if TYPE_CHECKING:
    from coordlog.episode import Json
    from coordlog.sim.env import BatchEnv
    from coordlog.tasks.scene import Scene

TABLES = ("env", "reward", "task")
MOST = 1 << 20
"""Largest configuration file that is read [bytes]."""


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a configuration file.

    Raises:
        ConfigError: if the file cannot be read or is no TOML.
    """
    try:
        with path.open("rb") as stream:
            data = stream.read(MOST + 1)
    except OSError as error:
        raise ConfigError(f"{path}: cannot read the configuration: {error.strerror}") from error
    if len(data) > MOST:
        raise ConfigError(f"{path}: expected a configuration of at most {MOST:,} bytes, got more")
    try:
        tables = tomllib.loads(data.decode("utf-8-sig"))
    except RecursionError:
        raise ConfigError(f"{path}: expected TOML, got one that is too deep") from None
    except ValueError as error:
        raise ConfigError(f"{path}: expected TOML, got: {error}") from error
    for name, table in tables.items():
        if not isinstance(table, dict):
            raise ConfigError(f"{path}: '{name}': expected a table [{name}], got {str(table)[:40]}")
    return tables


def scene_of(name: str) -> Scene:
    """The scene that a person asks for: one that ships, one of their own as FILE.py:NAME, for which
    the file is run, or a robot's card, ROBOT.toml.

    Names that come out of logs and policy files go to `tasks.scene.find` instead: what somebody
    sent must not run anything.

    Raises:
        ConfigError: for an unknown name, a file that cannot be run or read, or a name in it that is
            no scene.
    """
    from coordlog.tasks.card import read_card
    from coordlog.tasks.scene import Scene, find

    if name.endswith(".toml"):
        return read_card(Path(name))
    file, colon, attribute = name.rpartition(":")
    if not colon:
        return find(name)
    found = _run(Path(file))
    scenes = [key for key, value in found.items() if isinstance(value, Scene)]
    if attribute not in scenes:
        raise unknown(f"scene of {file}", attribute, scenes)
    own: Scene = found[attribute]
    if own.robot.assets is None and isinstance(own.robot.mjcf, str):  # beside the file, as Python
        own = replace(own, robot=replace(own.robot, assets=Path(file).resolve().parent))
    return own


def _run(file: Path) -> dict[str, Any]:
    """Run a file of the user's as `python FILE.py` does: its own folder is where it imports from
    first.
    """
    folder = str(file.resolve().parent)
    sys.path.insert(0, folder)
    try:
        return runpy.run_path(str(file))
    except Exception as error:  # the file is the user's, and so is whatever it raises
        raise ConfigError(
            f"{file}: cannot be run for its scenes: {type(error).__name__}: {error}"
        ) from error
    finally:
        sys.path.remove(folder)


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
        tables: Tables "env", "reward" and "task" of a configuration file, or none; "task" has the
            constants that are the task's own.
        start: Name of the start pose.
        envs: Number of simulations.
        threads: Threads to simulate on.
        doubts: Say what is doubtful; off for a second environment of the same constants.
        like: A `coordlog.env` record whose constants hold where the tables say nothing: those of
            the logs, or of a policy's training.

    Raises:
        ConfigError: for an unknown scene, pose, table or key, or a value out of range.
    """
    from coordlog.config import build, plain
    from coordlog.sim.env import BatchEnv, default_config
    from coordlog.tasks.config import EnvConfig, RewardConfig
    from coordlog.tasks.registry import SAID
    from coordlog.tasks.scene import find

    for name in tables:
        if name not in TABLES:
            raise unknown("table", name, TABLES)
    place = find(scene) if isinstance(scene, str) else scene
    before = like or {"config": {}, "reward": {}}
    own = {key: value for key, value in before.get("task", {}).items() if key not in SAID}
    reward = build(RewardConfig, before["reward"] | tables.get("reward", {}))
    config = plain(default_config(place)) | before["config"] | tables.get("env", {})
    constants = build(EnvConfig, config)
    if doubts and "reward" in tables:
        for doubt in reward.doubts(steps=constants.max_steps):
            note(doubt)
    return BatchEnv(
        place,
        constants,
        reward,
        n=envs,
        threads=threads,
        start=start,
        task=own | tables.get("task", {}),
    )
