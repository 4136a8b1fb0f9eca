"""The options that say which environment: a scene, its start pose, and constants from a file."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coordlog.commands.terminal import note
from coordlog.errors import ConfigError, unknown

if TYPE_CHECKING:
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


def make_env(scene: str, *, config: Path | None, start: str, envs: int, threads: int) -> BatchEnv:
    """The batched environment that the options describe; doubtful reward constants are said aloud.

    Raises:
        ConfigError: for an unknown scene, pose or key, or a value out of range.
    """
    from coordlog.sim.config import EnvConfig, RewardConfig, from_mapping
    from coordlog.sim.env import BatchEnv
    from coordlog.sim.scene import find

    tables = read_toml(config) if config else {}
    for name in tables:
        if name not in TABLES:
            raise unknown("table", name, TABLES)
    reward = from_mapping(RewardConfig, tables.get("reward", {}))
    if "reward" in tables:
        for doubt in reward.doubts():
            note(doubt)
    if envs < 1:
        raise ConfigError(f"--envs: expected at least 1, got {envs}")
    return BatchEnv(find(scene), from_mapping(EnvConfig, tables.get("env", {})), reward, n=envs, threads=threads, start=start)
