"""The options that say which environment: a scene, its start pose, and constants from a file."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coordlog.commands.terminal import note
from coordlog.errors import ConfigError, unknown

if TYPE_CHECKING:
    from coordlog.episode import Json
    from coordlog.sim.env import BatchEnv

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


def make_env(
    scene: str, tables: Mapping[str, Any], *, start: str, envs: int, threads: int, like: Json | None = None, doubts: bool = True
) -> BatchEnv:
    """The batched environment that the options describe; doubtful reward constants are said aloud.

    Args:
        scene: Name of the scene.
        tables: Tables "env" and "reward" of a configuration file, or none.
        start: Name of the start pose.
        envs: Number of simulations.
        threads: Threads to simulate on.
        doubts: Say what is doubtful; off for a second environment of the same constants.
        like: A `coordlog.env` record whose constants hold where the tables say nothing: those of the logs, or of a policy's training.

    Raises:
        ConfigError: for an unknown scene, pose, table or key, or a value out of range.
    """
    from coordlog.sim.config import EnvConfig, RewardConfig, from_mapping
    from coordlog.sim.env import BatchEnv
    from coordlog.sim.scene import find

    for name in tables:
        if name not in TABLES:
            raise unknown("table", name, TABLES)
    before = like or {"config": {}, "reward": {}}
    reward = from_mapping(RewardConfig, before["reward"] | tables.get("reward", {}))
    if doubts and "reward" in tables:
        for doubt in reward.doubts():
            note(doubt)
    constants = from_mapping(EnvConfig, before["config"] | tables.get("env", {}))
    return BatchEnv(find(scene), constants, reward, n=envs, threads=threads, start=start)
