"""Policies for other people's environments: a name in a Python file, a model that stable-baselines3
saved, or what coordlog has learnt from an environment's logs.
"""

from __future__ import annotations

import hashlib
import json
import re
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from coordlog.episode import Array, Json
from coordlog.errors import ConfigError, FormatError, unknown
from coordlog.policies.learned import Policy
from coordlog.policies.registry import SUFFIX, policy_file
from coordlog.sim.foreign import flat, of_environment
from coordlog.tasks.own import run_file

Act = Callable[[Any], Any]
"""Observation in, action out."""
SCALES = ("action_low", "action_high", "state_offset", "state_scale")
"""What a policy for an environment is told of it, in its `coordlog.env` record: it sees states less
the offset by the scale, and its -1 and 1 are the least and the greatest action.
"""
VERSION = re.compile(r"-v\d+$")
"""Of a Gymnasium id."""
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
    if path.is_dir() or path.suffix == SUFFIX or path.with_name(path.name + SUFFIX).is_file():
        own = policy_file(name, "")
        assert own is not None  # no scripted policy has such a name
        return learnt(Policy.load(own), own), _about("digrad", name, own)
    if not path.is_file():
        raise ConfigError(
            f"{name}: expected random, FILE.py:NAME, a model of stable-baselines3 (.zip) or a run "
            "folder, found no such file"
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


def learnt(policy: Policy, name: str | Path) -> Act:
    """What coordlog has learnt from an environment's logs, in the environment's own units.

    Raises:
        ConfigError: if it was learnt in a scene of coordlog's.
        FormatError: if its file lacks the scales.
    """
    env = policy.about.get("env", {})
    if not of_environment(env):
        raise ConfigError(
            f"{name}: a policy that acts in coordlog's scenes alone, trained in "
            f"'{policy.about.get('scene', '')}'; expected one that was learnt from logs of an "
            "environment"
        )
    try:
        low, high, offset, scale = (np.array(env[key], np.float32) for key in SCALES)
        fits = low.shape == high.shape == (policy.n_u,) and offset.shape == scale.shape
    except (KeyError, TypeError, ValueError) as error:
        raise FormatError(f"{name}: expected the scales {', '.join(SCALES)} in it") from error
    if not fits or offset.shape != (policy.n_x,):
        raise FormatError(f"{name}: its scales {', '.join(SCALES)} do not fit its network")

    def act(observation: Any) -> Array:
        seen = flat(observation).astype(np.float32)
        if seen.shape != offset.shape:
            raise ConfigError(
                f"{name}: expected an observation of {policy.n_x} numbers, as in "
                f"'{policy.about.get('scene', '')}' where it was trained, got {seen.size}"
            )
        return np.asarray(low + (policy((seen - offset) / scale) + 1) / 2 * (high - low))

    return act


def at_home(policy: Policy, name: str | Path, now: Json) -> str:
    """What is to be said of a policy that acts elsewhere than where it was learnt; "" if that is
    the same environment.

    Args:
        policy: As `learnt` takes it.
        name: What it is called.
        now: Where it is to act: its "environment", and "joints", "actuators" and "model_sha256" as
            a `coordlog.env` record has them.

    Raises:
        ConfigError: if it is another environment: neither the id, but for its version, nor the
            model is that of the logs.
    """
    env = policy.about["env"]
    was, here = env["task"].get("environment", ""), now["environment"]
    named = all(env.get(key) == now[key] for key in ("joints", "actuators"))
    digest = env.get("model_sha256", "")  # older logs say none
    same = named and digest in ("", now["model_sha256"])
    home = f"'{was or policy.about.get('scene', '')}'"
    if was in ("", here):
        if same:
            return ""
        if was or named:
            return f"{name}: '{here}' has another model here than where it was learnt, in {home}"
    elif VERSION.sub("", was) == VERSION.sub("", here) or (same and digest):
        model = "the same" if same else "another"
        return f"{name}: learnt in {home}, acts in '{here}', whose model is {model}"
    raise ConfigError(
        f"{name}: learnt in {home}, where its actions mean something else than in '{here}'; "
        "expected that environment, or a policy that was learnt from logs of this one"
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
    if head[:1] == b"\x80":
        return "a pickle, which would run anything: save the policy with its own library"
    if head[:4] == b"\x7fELF":
        return "a program"
    return "a file of another kind"
