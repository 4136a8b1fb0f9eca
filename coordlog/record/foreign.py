"""Episodes of environments that are not ours: any Gymnasium environment on MuJoCo, and anything
with a model and data.

    with Recorder(gym.make("Reacher-v5"), "logs/") as env: …    env.reset, env.step as before
    with recording(model, data, "logs/") as log: …              log.step(action, reward, …)
    record_env(env, policy, episodes=10, out="logs/")

A file holds the model, the first full state, and whatever the physics was given; each step is taken
again from that while it is recorded (sim/foreign.py), so a file that is there replays.
"""

from __future__ import annotations

import hashlib
import inspect
import platform
import re
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

import mujoco
import numpy as np

from coordlog.episode import INITIAL_STATE, Array, Header, Json
from coordlog.errors import ConfigError, SimulationError, SpecError
from coordlog.mjcf import actuator_label, load_attached, text_of
from coordlog.record.writer import BLOCK, EpisodeWriter
from coordlog.sim.env import hinges
from coordlog.sim.foreign import SUBSTEPS, TASK, Followed, Shadow, Watch, state_of
from coordlog.sim.inputs import Inputs
from coordlog.spec import INPUTS, SCHEMA_VERSION
from coordlog.version import __version__

RESET, STEP = (
    ("observation", "info"),
    ("observation", "reward", "terminated", "truncated", "info"),
)
VECTORISED = "{}: several environments in one: expected a single one; record each of them by itself"
Policy = Callable[[Any], Any]
"""Observation in, action out."""


class EpisodeLog:
    """One episode of a simulation that its owner steps.

    `step` is called after every step, with what the owner did and got. Leaving the context without
    an ending closes the episode as aborted, with all its steps.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        path: Path,
        *,
        attached: Mapping[str, bytes],
        about: Json,
        observation: Any = None,
        verify: bool = True,
    ) -> None:
        """Begin in the present state.

        Args:
            model: What is simulated.
            data: Its state.
            path: Name of the file, once it is finished.
            attached: The model as attachments (`attachments_of`).
            about: What is known of the episode: "episode" and "policy" records, in part, the names
                of "heads", and the "task" record.
            observation: What the policy sees first; without one the state is qpos and qvel.
            verify: Take each step again while recording.
        """
        self._model, self._data, self._path, self._about = model, data, path, about
        self._attached = {**attached, INITIAL_STATE: state_of(model, data).tobytes()}
        self._watch = Watch(model, data) if verify else None
        logged = load_attached(attached) if verify else model
        self._shadow = Shadow(logged, state_of(model, data)) if verify else None
        self._inputs = Inputs(model, n=1)
        self._start, self._before = float(data.time), state_of(model, data)
        self._writer: EpisodeWriter | None = None
        self._rows: list[dict[str, Array]] = []
        self._changes: list[tuple[int, int, Array]] = []
        self._seen = self._present(observation)
        self._like: dict[str, tuple[Any, tuple[int, ...]]] | None = None
        self._closed = False
        self.length = 0
        """Steps so far."""
        self.set_from_outside = 0
        """Steps in which the state was set from outside."""

    def step(
        self,
        action: Any,
        reward: Any = 0.0,
        *,
        observation: Any = None,
        terminated: bool = False,
        truncated: bool = False,
        info: Mapping[str, Any] | None = None,
    ) -> None:
        """Log the step that was just made.

        Args:
            action: What the policy asked for.
            reward: One number, or one for each head.
            observation: What the policy sees now.
            terminated: The task ended here.
            truncated: The episode was cut off here.
            info: Its numbers are logged, under the names they have at the first step.

        Raises:
            SimulationError: if the step cannot be taken again from what is logged; what came before
                stays in the file, which is closed as aborted.
            SpecError: for a NaN, or another number of values than before.
        """
        if self._closed:
            raise SimulationError("step: the episode has ended; begin another")
        try:
            followed = self._follow(state_of(self._model, self._data))
        except SimulationError as error:
            self.close(aborted=f"not replayable at step {self.length}: {error}")
            raise SimulationError(f"step {self.length} cannot be replayed: {error}") from None
        try:
            row, seen = self._row(action, reward, observation=observation, info=info or {})
        except SpecError as error:
            self.close(aborted=f"step {self.length}: {error}")
            raise SpecError(f"step {self.length}: {error}") from None
        row["terminated"] = np.array(bool(terminated))
        row["truncated"] = np.array(bool(truncated) and not terminated)
        row[SUBSTEPS] = np.array(followed.substeps, dtype=np.int32)
        for change in followed.changes:
            self._changes.append((self.length, change.substep, change.row))
        self.set_from_outside += followed.outside
        self._rows.append(row)
        self._seen = seen
        self.length += 1
        if len(self._rows) == BLOCK or terminated or truncated:
            self._flush()
        if terminated or truncated:
            self.close(aborted="")

    def _row(
        self, action: Any, reward: Any, *, observation: Any, info: Mapping[str, Any]
    ) -> tuple[dict[str, Array], dict[str, Array]]:
        """The values of a step, and those that hold after it.

        Raises:
            SpecError: for a NaN, or for values of another kind or number than before.
        """
        seen = self._present(observation)
        row = dict(self._seen)
        row["action"] = _flat(action).astype(np.float32)
        row["reward"] = _flat(reward).astype(np.float64)
        row["ctrl"], row["torque"] = self._data.ctrl.copy(), self._data.actuator_force.copy()
        said = {f"info_{key}": value for key, value in numbers(info).items()}
        if self._like is None:
            self._like = {name: (v.dtype, v.shape) for name, v in (row | said).items()}
        wanted = [name for name in self._like if name.startswith("info_")]
        if missing := [name for name in wanted if name not in said]:
            raise SpecError(
                f"info: expected the numbers of the first step, {missing[0].removeprefix('info_')} "
                "is missing"
            )
        row |= {name: said[name].astype(self._like[name][0]) for name in wanted}
        for values in (row, seen):
            for name, value in values.items():
                if value.shape != self._like.get(name, (None, None))[1]:
                    raise SpecError(
                        f"{name}: expected {_count(self._like.get(name))} as before, got "
                        f"{value.size}"
                    )
                if value.dtype.kind == "f" and not np.isfinite(value).all():
                    raise SpecError(f"{name}: expected numbers, got NaN or infinity")
        for name in wanted:
            if (row[name] != said[name]).any():
                raise SpecError(
                    f"{name}: expected {self._like[name][0]} as in the first step, got {said[name]}"
                )
        return row, seen

    def close(self, aborted: str = "interrupted") -> None:
        """Finish the file; an episode without steps leaves none."""
        self._closed = True
        if self._watch is not None:
            self._watch.close()
        if self._rows:
            self._flush()
        writer, self._writer = self._writer, None
        if writer is not None:
            writer.finish(self._seen, aborted=aborted)

    def __enter__(self) -> EpisodeLog:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        stopped = error is None or isinstance(error, KeyboardInterrupt)
        self.close("interrupted" if stopped else f"failed: {type(error).__name__}")

    def mark(self) -> None:
        """Keep the state as it is now: an owner that steps in halves sets its controls between."""
        if self._watch is not None:
            self._watch.mark()

    def _follow(self, end: Array) -> Followed:
        before, self._before = self._before, end
        if self._shadow is None or self._watch is None:
            return Followed(round((end[0] - before[0]) / self._model.opt.timestep), [])
        return self._shadow.follow(self._watch.taken(), end)

    def _present(self, observation: Any) -> dict[str, Array]:
        """The fields that hold before an action."""
        data = self._data
        values = (
            np.concatenate([data.qpos, data.qvel]) if observation is None else _flat(observation)
        )
        found = {
            "time": np.array(data.time - self._start),
            "qpos": data.qpos.copy(),
            "qvel": data.qvel.copy(),
            "state": values.astype(np.float32),
        }
        if observation is not None and values.dtype == np.float64:
            found["observation"] = values
        return found

    def _flush(self) -> None:
        """Write what has been collected, opening the file with the first of it."""
        if self._writer is None:
            header = self._header(self._rows[0])
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = EpisodeWriter(
                self._path, header, attachments=self._attached, display=True
            )
        names = list(self._rows[0])
        columns = {name: np.stack([row[name] for row in self._rows]) for name in names}
        inputs = self._messages()
        first = self.length - len(self._rows)
        self._rows = []
        self._writer.write_steps(first, columns, inputs=inputs)

    def _messages(self) -> dict[str, Array] | None:
        changes, self._changes = self._changes, []
        if not changes:
            return None
        columns: dict[str, list[Array]] = {item.name: [] for item in INPUTS.fields}
        for step, substep, row in changes:
            self._inputs.begin(np.array([0]), row[None])
            message = self._inputs.message(0, step)
            message["substep"], message["state"] = np.array([substep], np.int32), row[None]
            for name, value in message.items():
                columns[name].append(value)
        return {name: np.concatenate(values) for name, values in columns.items()}

    def _header(self, row: Mapping[str, Array]) -> Header:
        model, about = self._model, self._about
        widths = {name: row[name].size for name in ("state", "action", "reward")}
        heads = list(about.get("heads") or ("reward",))
        if len(heads) != widths["reward"]:
            heads = [f"reward_{i}" for i in range(widths["reward"])]
        period = int(row[SUBSTEPS]) * float(model.opt.timestep) or float(model.opt.timestep)
        fields = [_field(SUBSTEPS, "int32", "", "physics steps that the step made", "after")]
        if "observation" in row:
            fields.insert(
                0, _field("observation", "float64", str(row["observation"].size), "", "before")
            )
        for name, value in row.items():
            if name.startswith("info_"):
                kind = {"f": "float64", "b": "bool", "i": "int64"}[value.dtype.kind]
                fields.append(
                    _field(name, kind, str(value.size) if value.ndim else "", "", "after")
                )
        env = {
            "coordlog_version": __version__,
            "mujoco_version": mujoco.__version__,
            "architecture": platform.machine(),
            "task": {**about.get("task", {}), "name": TASK, "fields": fields},
            "reward": {},
            "config": {},
            "robot": {"name": about["episode"]["robot"]},
            "joints": hinges(model),
            "actuators": [actuator_label(model, i) for i in range(model.nu)],
            "geoms": [model.geom(i).name or f"geom {i}" for i in range(model.ngeom)],
            "arms": {head: list(range(widths["action"])) for head in heads},
            "action_joints": [f"action_{i}" for i in range(widths["action"])],
            "state": [f"state_{i}" for i in range(widths["state"])],
            "layout": {
                "n_q": model.nq,
                "n_v": model.nv,
                "n_x": widths["state"],
                "n_u": widths["action"],
                "k": widths["reward"],
                "n_c": model.nu,
            },
        }
        episode = {
            "schema_version": SCHEMA_VERSION,
            "kind": "simulated",
            "split": "",
            "seed": None,
            "index": 0,
            "start": "",
            "control_period": period,
            "goals": [],
            "obstacles": [],
            **about["episode"],
        }
        policy = {"kind": "", "name": "", "checkpoint_sha256": "", "noise": {}}
        return Header(episode, env, {**policy, **about.get("policy", {})})


def _field(name: str, kind: str, size: str, unit: str, when: str) -> Json:
    return {
        "name": name,
        "type": kind,
        "size": size,
        "unit": unit if len(unit) < 8 else "",
        "when": when,
    }


def _count(like: tuple[Any, tuple[int, ...]] | None) -> str:
    size = 0 if like is None else int(np.prod(like[1]))
    return f"{size} value" + "s" * (size != 1)


def _flat(value: Any) -> Array:
    """An observation, action or reward as one row of numbers; parts of a mapping in the order of
    their names.

    Raises:
        SpecError: if there is anything but numbers in it.
    """
    if isinstance(value, Mapping):
        return np.concatenate([_flat(value[key]) for key in sorted(value)])
    if isinstance(value, tuple):
        return np.concatenate([_flat(each) for each in value])
    array = np.asarray(value)
    if array.dtype.kind not in "fiub":
        raise SpecError(
            f"expected numbers in observation, action and reward, got {type(value).__name__}"
        )
    return np.atleast_1d(array).ravel()


def numbers(info: Mapping[str, Any]) -> dict[str, Array]:
    """The numbers of an info: scalars and short vectors, by name."""
    found = {}
    for said, value in info.items():
        key = re.sub(r"\W", "_", str(said), flags=re.ASCII)  # what a column may be called
        if not key or key in found:
            continue
        if isinstance(value, bool | np.bool_):
            found[key] = np.array(bool(value))
        elif isinstance(value, int | float | np.number):
            found[key] = np.array(float(value))
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiu" and value.ndim == 1:
            found[key] = value.astype(np.float64)
    return found


def attachments_of(model: mujoco.MjModel, source: Path | str | None = None) -> dict[str, bytes]:
    """A model that somebody else has compiled, as attachments.

    Args:
        model: As it is simulated.
        source: The file or the text it was compiled from; None for what MuJoCo compiled last.

    Raises:
        ConfigError: if no text is known that compiles to the same physics.
    """
    attached = text_of(model, source)
    if not attached:
        raise ConfigError(
            "the text that the model was compiled from is not known, or compiles to other physics: "
            "give it as `source`, a path or MJCF text"
        )
    return attached


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


def _takes_seed(reset: Callable[..., Any]) -> bool:
    known = inspect.signature(reset).parameters.values()
    return any(item.name == "seed" or item.kind is item.VAR_KEYWORD for item in known)


def _parts(given: Any, names: tuple[str, ...], verb: str) -> Any:
    """What `reset` or `step` of an environment gave.

    Raises:
        SpecError: if it is not as Gymnasium has it.
    """
    if not isinstance(given, tuple) or len(given) != len(names):
        got = f"{len(given)} values" if isinstance(given, tuple) else f"a {type(given).__name__}"
        raise SpecError(f"{verb}: expected {', '.join(names)} as of Gymnasium, got {got}")
    return given


def _file_of(env: Any) -> Path | None:
    """The model's file, where the environment says which it is."""
    path = getattr(getattr(env, "unwrapped", env), "fullpath", None)
    return Path(path) if isinstance(path, str) and Path(path).is_file() else None


class Recorder:
    """A Gymnasium environment that records: the same `reset` and `step`, and every episode becomes
    a file.

    Example:
        >>> import gymnasium as gym                                  # doctest: +SKIP
        >>> with Recorder(gym.make("Reacher-v5"), "logs/") as env:   # doctest: +SKIP
        ...     observation, info = env.reset(seed=0)
        ...     env.step(env.action_space.sample())
    """

    def __init__(
        self,
        env: Any,
        out: str | Path = "logs",
        *,
        policy: Json | None = None,
        verify: bool = True,
        source: Path | str | None = None,
    ) -> None:
        """Find the simulation; files appear as episodes end.

        Args:
            env: With `reset`, `step`, and a MuJoCo model and data.
            out: Folder; files already in it stay as they are.
            policy: What is known of who acts: kind, name, checkpoint_sha256.
            verify: Take each step again while recording.
            source: The file or the text that its model was compiled from, where the environment
                does not say it.

        Raises:
            ConfigError: if there is no MuJoCo in it, or the text of its model is not known.
        """
        self._env, self._out, self._policy, self._verify = env, Path(out), policy or {}, verify
        self._source = source if source is not None else _file_of(env)
        model, _ = simulation_of(env)
        self._attached = attachments_of(model, self._source)
        self._log: EpisodeLog | None = None
        self.run = uuid.uuid4().hex[:8]
        self.files: list[Path] = []
        """Files that were begun, in order."""
        self.steps = 0
        """Steps of all episodes."""
        self.set_from_outside = 0
        """Steps in which the environment set the state itself."""

    def __getattr__(self, name: str) -> Any:
        return getattr(self._env, name)

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:
        """Reset the environment, and begin an episode."""
        self._end("reset")
        observation, info = _parts(self._env.reset(**options), RESET, "reset")
        model, data = simulation_of(self._env)
        self._attached = self._attached or attachments_of(model, self._source)
        name, index = self._name(), len(self.files)
        path = self._out / f"{name}-{index:06d}-{self.run}.mcap"
        about = {
            "episode": {
                "id": hashlib.sha256(f"{self.run}/{index}".encode()).hexdigest()[:16],
                "run": self.run,
                "robot": name,
                "scene": name,
                "seed": options.get("seed"),
                "index": index,
                "start_time": time.time_ns(),
            },
            "policy": self._policy,
            "task": {"environment": name},
        }
        self._log = EpisodeLog(
            model,
            data,
            path,
            attached=self._attached,
            about=about,
            observation=observation,
            verify=self._verify,
        )
        self.files.append(path)
        return observation, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the environment, and log the step.

        Raises:
            SimulationError: if there is no episode, or the step cannot be replayed.
        """
        if self._log is None:
            raise SimulationError("step: expected an episode under way; call reset first")
        self._log.mark()
        given = _parts(self._env.step(action), STEP, "step")
        observation, reward, terminated, truncated, info = given
        if np.size(terminated) != 1 or np.size(truncated) != 1:
            raise SpecError(VECTORISED.format(type(self._env).__name__))
        log = self._log
        log.step(
            action,
            reward,
            observation=observation,
            terminated=terminated,
            truncated=truncated,
            info=info,
        )
        self.steps += 1
        if terminated or truncated:
            self.set_from_outside += log.set_from_outside
            self._log = None
        return observation, reward, terminated, truncated, info

    def close(self) -> None:
        """Close the episode under way as aborted; the environment stays open."""
        self._end("interrupted")

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _end(self, why: str) -> None:
        if self._log is not None:
            self.set_from_outside += self._log.set_from_outside
            self._log.close(aborted=why)
            self._log = None

    def _name(self) -> str:
        spec = getattr(self._env, "spec", None)
        said = (
            getattr(spec, "id", None) or type(getattr(self._env, "unwrapped", self._env)).__name__
        )
        return str(said).replace("/", "_")


@contextmanager
def recording(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    out: str | Path = "logs",
    *,
    name: str = "simulation",
    observation: Any = None,
    verify: bool = True,
    source: Path | str | None = None,
) -> Iterator[EpisodeLog]:
    """Record one episode of a loop of one's own, from the present state on.

    Args:
        model: What is simulated.
        data: Its state.
        out: Folder; files already in it stay as they are.
        name: What the scene is called.
        observation: What the policy sees first.
        verify: Take each step again while recording.
        source: The file or the text that the model was compiled from; None for what MuJoCo compiled
            last.

    Raises:
        ConfigError: if the text of the model is not known.

    Example:
        >>> with recording(model, data, "logs/") as log:           # doctest: +SKIP
        ...     for _ in range(100):
        ...         data.ctrl[:] = policy(data)
        ...         mujoco.mj_step(model, data, 5)
        ...         log.step(data.ctrl, reward=0.0)
    """
    run = uuid.uuid4().hex[:8]
    episode = {
        "id": hashlib.sha256(run.encode()).hexdigest()[:16],
        "run": run,
        "robot": name,
        "scene": name,
        "start_time": time.time_ns(),
    }
    path = Path(out) / f"{name.replace('/', '_')}-000000-{run}.mcap"
    log = EpisodeLog(
        model,
        data,
        path,
        attached=attachments_of(model, source),
        about={"episode": episode},
        observation=observation,
        verify=verify,
    )
    with log:
        yield log


def record_env(
    env: Any,
    policy: Policy,
    *,
    episodes: int = 10,
    out: str | Path = "logs",
    seed: int = 0,
    about: Json | None = None,
    verify: bool = True,
    source: Path | str | None = None,
    each: Callable[[Recorder], None] | None = None,
) -> Recorder:
    """Run a policy in a Gymnasium environment, and record its episodes.

    Args:
        env: On MuJoCo.
        policy: Observation in, action out.
        episodes: How many.
        out: Folder; files already in it stay as they are.
        seed: Of the first episode; each next one is one more. Not for a `reset` that takes none.
        about: What is known of the policy: kind, name, checkpoint_sha256.
        verify: Take each step again while recording.
        source: The file or the text that its model was compiled from, where it does not say it.
        each: Called after every episode.

    Returns:
        The recorder, closed: its files and counts.

    Raises:
        ConfigError: if the environment is not on MuJoCo.
        SimulationError: at the first step that cannot be replayed.
        StorageError: if a file cannot be written.
    """
    with Recorder(env, out, policy=about, verify=verify, source=source) as recorder:
        seeded = _takes_seed(env.reset)
        for index in range(episodes):
            observation, _ = recorder.reset(**({"seed": seed + index} if seeded else {}))
            over = False
            while not over:
                result = recorder.step(policy(observation))
                observation, over = result[0], result[2] or result[3]
            if each is not None:
                each(recorder)
    return recorder
