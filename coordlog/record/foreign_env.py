"""Environments of other people's libraries: where their simulation is, and what they give."""

from __future__ import annotations

import hashlib
import inspect
import warnings
from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from coordlog.episode import MODEL_XML, Array, Json
from coordlog.errors import ConfigError, SpecError
from coordlog.mjcf import (
    Looks,
    actuator_label,
    load_attached,
    looks_of,
    same_physics,
    text_of,
)
from coordlog.record.display import Shown
from coordlog.sim.description import Description
from coordlog.sim.env import hinges
from coordlog.sim.foreign import Parts, Shadow
from coordlog.sim.inputs import Inputs

VECTORISED = (
    "{}: several environments in one, whose simulations cannot be told apart or are in other "
    "processes: "
    "use gymnasium.vector.SyncVectorEnv, of which each environment is recorded, or record each by "
    "itself"
)

REMEMBERED = 8
"""Models whose text is remembered."""
_seen: list[tuple[mujoco.MjModel, dict[str, bytes]]] = []


class Given(NamedTuple):
    """What an environment gave after a step, as Gymnasium has it."""

    observation: Any
    reward: Any
    terminated: bool
    truncated: bool
    info: Mapping[str, Any]


class Subject:
    """A model that somebody else has compiled, and what is made of it once for all its episodes.

    Example:
        >>> subject = Subject(env.unwrapped.model)              # doctest: +SKIP
        >>> subject.attached["model.xml"][:7]                   # doctest: +SKIP
        b'<mujoco'
    """

    def __init__(self, model: mujoco.MjModel, source: Path | str | None = None) -> None:
        """Arguments and errors as of `attachments_of`."""
        self.model, self.attached = model, attachments_of(model, source)
        self.parts, self.inputs = Parts(model), Inputs(model, n=1)
        self._shadow: Shadow | None = None

    def shadow(self, start: Array) -> Shadow:
        """A second simulation, on the model as it is logged, in a full state."""
        if self._shadow is None:
            self._shadow = Shadow(self._logged, start)
        else:
            self._shadow.begin(start)
        return self._shadow

    def shown(self, start: Array) -> Shown:
        """What viewers see of an episode that begins in a full state."""
        return Shown(self._description, start)

    @cached_property
    def looks(self) -> Looks:
        """What it wears in pictures, beyond what the attached text has."""
        return looks_of(self.model) if self._logged.ngeom < self.model.ngeom else Looks()

    @cached_property
    def names(self) -> Json:
        """Names of its joints, actuators and geoms, and its digest, as a header has them."""
        model = self.model
        return {
            "model_sha256": hashlib.sha256(self.attached[MODEL_XML]).hexdigest(),
            "joints": hinges(model),
            "actuators": [actuator_label(model, i) for i in range(model.nu)],
            "geoms": [model.geom(i).name or f"geom {i}" for i in range(model.ngeom)],
        }

    @cached_property
    def _logged(self) -> mujoco.MjModel:
        return load_attached(self.attached)

    @cached_property
    def _description(self) -> Description:
        return Description(self._logged)


def attachments_of(model: mujoco.MjModel, source: Path | str | None = None) -> dict[str, bytes]:
    """A model that somebody else has compiled, as attachments.

    Args:
        model: As it is simulated.
        source: The file or the text it was compiled from; None for what MuJoCo compiled last.

    Raises:
        ConfigError: if no text is known that compiles to the same physics.
    """
    attached = text_of(model, source) or _known(model)
    _seen.insert(0, (model, attached))
    del _seen[REMEMBERED:]
    if not attached:
        raise ConfigError(
            "the text that the model was compiled from is not known, or compiles to other "
            "physics: give it as `source`, a path or MJCF text"
        )
    return attached


def _known(model: mujoco.MjModel) -> dict[str, bytes]:
    """What was found for the same model before: MuJoCo keeps the text of the last one alone."""
    for other, attached in _seen:
        if other is model and attached and same_physics(load_attached(attached), model):
            return attached
    return {}


def simulation_of(env: Any) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The MuJoCo model and data of an environment, wherever its library keeps them.

    Raises:
        ConfigError: if it has none.
    """
    inner = getattr(env, "unwrapped", env)
    if getattr(env, "num_envs", 1) != 1:
        raise ConfigError(VECTORISED.format(type(inner).__name__))
    for holder in (inner, getattr(inner, "physics", None), getattr(inner, "sim", None)):
        model, data = getattr(holder, "model", None), getattr(holder, "data", None)
        for name in ("ptr", "_model"):
            model = getattr(model, name, model)
        for name in ("ptr", "_data"):
            data = getattr(data, name, data)
        if isinstance(model, mujoco.MjModel) and isinstance(data, mujoco.MjData):
            return model, data
    raise ConfigError(
        f"{type(inner).__name__}: expected an environment on MuJoCo, one with `model` and `data` "
        "(or `physics`, or `sim`), found neither"
    )


def several(env: Any) -> list[Any]:
    """The environments of a vectorised one that steps them one after another in this process
    (Gymnasium's SyncVectorEnv); none of any other.
    """
    inner = getattr(env, "unwrapped", env)
    each = getattr(inner, "envs", None)
    if not isinstance(each, list | tuple) or len(each) != getattr(inner, "num_envs", 0):
        return []
    return list(each)


def at_first(given: Any) -> tuple[Any, Mapping[str, Any]]:
    """Observation and info of what `reset` gave: as Gymnasium has it, a time step of dm_env, or an
    observation alone.

    Raises:
        SpecError: if it is none of these.
    """
    if hasattr(given, "step_type"):
        return given.observation, {}
    if isinstance(given, tuple):
        if len(given) == 2 and isinstance(given[1], Mapping):
            return given[0], given[1]
        raise SpecError(
            f"reset: expected observation, info as of Gymnasium, got {len(given)} values"
        )
    if isinstance(given, Mapping | np.ndarray):
        return given, {}
    raise SpecError(
        f"reset: expected observation, info as of Gymnasium, got a {type(given).__name__}"
    )


def after(env: Any, given: Any) -> Given:
    """What `step` gave, as Gymnasium has it: from Gymnasium, from dm_env (a time step), or from
    robosuite and others that say observation, reward, done, info.

    Raises:
        SpecError: if it is none of these, or of several environments.
    """
    if type(given) is tuple and len(given) == 5 and type(given[2]) is type(given[3]) is bool:
        return Given(*given)
    if hasattr(given, "step_type"):
        over = bool(given.last())
        ended = over and given.discount == 0.0
        found = Given(given.observation, given.reward, ended, over and not ended, {})
    elif isinstance(given, tuple) and len(given) == 5:
        found = Given(*given)
    elif isinstance(given, tuple) and len(given) == 4 and isinstance(given[3], Mapping):
        observation, reward, done, info = given
        horizon = getattr(env, "horizon", None)
        cut = info.get("TimeLimit.truncated", horizon is not None and env.timestep >= horizon)
        found = Given(observation, reward, done and not cut, done and cut, info)
    else:
        got = f"{len(given)} values" if isinstance(given, tuple) else f"a {type(given).__name__}"
        raise SpecError(
            "step: expected observation, reward, terminated, truncated, info as of Gymnasium, got "
            f"{got}"
        )
    if np.size(found.terminated) != 1 or np.size(found.truncated) != 1:
        raise SpecError(VECTORISED.format(type(env).__name__))
    return found


def takes_seed(reset: Callable[..., Any]) -> bool:
    """Whether a `reset` takes a seed."""
    known = inspect.signature(reset).parameters.values()
    return any(item.name == "seed" or item.kind is item.VAR_KEYWORD for item in known)


def range_of(env: Any) -> tuple[list[float], list[float]] | None:
    """Least and greatest of each action, where an environment of Gymnasium, dm_env or robosuite
    says them and they are finite.
    """
    space = getattr(env, "action_space", None)
    if space is None:
        space = getattr(env, "action_spec", None)
        space = space() if callable(space) else space
    low = getattr(space, "low", getattr(space, "minimum", None))
    high = getattr(space, "high", getattr(space, "maximum", None))
    if isinstance(space, tuple) and len(space) == 2:
        low, high = space
    try:
        ends = [np.asarray(each, np.float64).ravel() for each in (low, high)]
    except (TypeError, ValueError):
        return None
    if ends[0].shape != ends[1].shape or not np.isfinite(ends).all():
        return None
    return ends[0].tolist(), ends[1].tolist()


def make(name: str) -> Any:
    """A Gymnasium environment by its id.

    Raises:
        ConfigError: if Gymnasium is not there, or cannot make it, with its reason.
    """
    try:
        import gymnasium
    except ImportError as error:
        raise ConfigError(
            '--env: needs Gymnasium and its MuJoCo environments: pip install "gymnasium[mujoco]"'
        ) from error
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return gymnasium.make(name)
        except Exception as error:  # whatever the environment's own package raises
            raise ConfigError(
                f"--env {name}: Gymnasium cannot make it: {type(error).__name__}: "
                f"{str(error).splitlines()[0]}"
            ) from error


def source_of(env: Any) -> Path | str | None:
    """The file or the text of the model, where the environment says it: Gymnasium's `fullpath`,
    robosuite's `model.get_xml()`.
    """
    inner = getattr(env, "unwrapped", env)
    path = getattr(inner, "fullpath", None)
    if isinstance(path, str) and Path(path).is_file():
        return Path(path)
    text = getattr(getattr(inner, "model", None), "get_xml", None)
    found = text() if callable(text) else None
    return found if isinstance(found, str) else None


def name_of(env: Any) -> str:
    """What an environment is called: by its id, else its task or class."""
    inner = getattr(env, "unwrapped", env)
    said = getattr(getattr(env, "spec", None), "id", None) or type(inner).__name__
    return str(said).replace("/", "_")
