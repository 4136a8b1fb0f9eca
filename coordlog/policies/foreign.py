"""Policies of other people's: a name in a Python file, or a model that stable-baselines3 saved."""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from coordlog.episode import Json
from coordlog.errors import ConfigError, unknown
from coordlog.tasks.own import run_file

Act = Callable[[Any], Any]
"""Observation in, action out."""
ALGORITHMS = (
    ("target_entropy", "SAC"),
    ("policy_delay", "TD3"),
    ("exploration_fraction", "DQN"),
    ("clip_range", "PPO"),
    ("rms_prop_eps", "A2C"),
    ("n_steps", "A2C"),
)
"""What a saved model of stable-baselines3 says of itself, and whose it then is; the first holds."""


def load(name: str) -> tuple[Act, Json]:
    """A policy by FILE.py:NAME or by a model's file, and its `coordlog.policy` record.

    Raises:
        ConfigError: if there is none, or it is of another kind, which is named.
    """
    file, colon, attribute = name.rpartition(":")
    if colon and file.endswith(".py") and not Path(file).is_file():
        raise ConfigError(f"{file}: expected a policy's file, found no such file")
    if colon and file.endswith(".py"):
        found = run_file(Path(file), "policy")
        if attribute not in found:
            names = [key for key, value in found.items() if key[0] != "_" and callable(value)]
            raise unknown(f"policy of {file}", attribute, names)
        return as_act(found[attribute], name), _about("python", name, Path(file))
    path = Path(name)
    if not path.is_file():
        raise ConfigError(
            f"{name}: expected random, FILE.py:NAME or a model of stable-baselines3 (.zip), found "
            "no such file"
        )
    if zipfile.is_zipfile(path):
        return _stable_baselines(path), _about("stable-baselines3", path.stem, path)
    raise ConfigError(
        f"{name}: expected FILE.py:NAME or a model of stable-baselines3, got {_kind(path)}"
    )


def as_act(policy: Any, name: str) -> Act:
    """What maps an observation to an action: `predict`, `act`, or the object itself.

    Raises:
        ConfigError: if it can do nothing of the kind.
    """
    if isinstance(policy, type):
        try:
            policy = policy()
        except Exception as error:  # the class is the user's
            raise ConfigError(
                f"{name}: the class cannot be made without arguments: {type(error).__name__}: "
                f"{error}"
            ) from error
    if hasattr(policy, "predict"):
        return lambda observation: policy.predict(observation, deterministic=True)[0]
    if hasattr(policy, "act"):
        act: Act = policy.act
        return act
    if callable(policy):
        call: Act = policy
        return call
    raise ConfigError(
        f"{name}: expected something with `predict` or `act`, or a function of the observation, "
        f"got {type(policy).__name__}"
    )


def _about(kind: str, name: str, file: Path) -> Json:
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    return {"kind": kind, "name": name, "checkpoint_sha256": digest, "noise": {}}


def _stable_baselines(path: Path) -> Act:
    """A model that stable-baselines3 saved."""
    with zipfile.ZipFile(path) as archive:
        if "data" not in archive.namelist():
            raise ConfigError(
                f"{path}: expected a model of stable-baselines3, got a zip archive of "
                f"{', '.join(archive.namelist()[:4])}"
            )
        said = json.loads(archive.read("data"))
    algorithm = next((name for key, name in ALGORITHMS if key in said), "")
    if not algorithm:
        raise ConfigError(f"{path}: a model of stable-baselines3, but of none of {_names()}")
    try:
        import stable_baselines3
    except ImportError as error:
        raise ConfigError(
            f"{path}: a model of stable-baselines3 needs that package: pip install "
            "stable-baselines3"
        ) from error
    model = getattr(stable_baselines3, algorithm).load(path, device="cpu")
    return as_act(model, str(path))


def _names() -> str:
    return ", ".join(sorted({name for _, name in ALGORITHMS}))


def _kind(path: Path) -> str:
    """What a file is, by its first bytes."""
    head = path.read_bytes()[:16]
    if path.suffix == ".py":
        return "a file without the name in it: write FILE.py:NAME"
    if path.suffix == ".safetensors":
        return "a policy of coordlog's own (.safetensors), which acts in coordlog's scenes alone"
    if head[:1] == b"\x80":
        return "a pickle, which would run anything: save the policy with its own library"
    if head[:4] == b"\x7fELF":
        return "a program"
    return "a file of another kind"
