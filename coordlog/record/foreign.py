"""Episodes of environments that are not ours: any Gymnasium environment on MuJoCo, and anything
with a model and data.

    with Recorder(gym.make("Reacher-v5"), "logs/") as env: …    env.reset, env.step as before
    with recording(model, data, "logs/") as log: …              log.step(action, reward, …)
    record_env(env, policy, episodes=10, out="logs/")

A file holds the model, the first full state, and whatever the physics was given; the steps are
taken again from that while they are recorded (sim/foreign.py), so a file that is there replays.
"""

from __future__ import annotations

import hashlib
import time
import uuid
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import mujoco

from coordlog.episode import Json
from coordlog.errors import SimulationError
from coordlog.record.foreign_env import (
    Subject,
    after,
    at_first,
    name_of,
    range_of,
    several,
    simulation_of,
    source_of,
    takes_seed,
)
from coordlog.record.foreign_episode import EpisodeLog
from coordlog.record.recording import Recording
from coordlog.record.storage import PART

Policy = Callable[[Any], Any]
"""Observation in, action out."""


class Recorder:
    """An environment that records: the same `reset` and `step`, and every episode becomes a file.

    As Gymnasium, dm_env or robosuite have it; of a SyncVectorEnv each environment has files of its
    own.

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
        run: str = "",
    ) -> None:
        """Find the simulation; files appear as episodes end.

        Args:
            env: With `reset`, `step`, and a MuJoCo model and data.
            out: Folder; files already in it stay as they are.
            policy: What is known of who acts: kind, name, checkpoint_sha256.
            verify: Take the steps again while recording.
            source: The file or the text that its model was compiled from, where the environment
                does not say it.
            run: Name of a run to go on with, whose whole episodes stay and whose part files are
                written again. "" for a new run.

        Raises:
            ConfigError: if there is no MuJoCo in it, or the text of its model is not known.
        """
        self._env, self._out, self._policy, self._verify = env, Path(out), policy or {}, verify
        self._source = source
        self._log: EpisodeLog | None = None
        self._resumed, self.run = bool(run), run or uuid.uuid4().hex[:8]
        self.files: list[Path] = []
        """Files that were begun, in order."""
        self.steps = 0
        """Steps of all episodes."""
        self.set_from_outside = 0
        """Steps in which the environment set the state itself."""
        self._inside = several(env)
        options = {"policy": policy, "verify": verify, "source": source}
        self._each = [_Part(self, each, out, **options) for each in self._inside]
        if self._each:
            env.unwrapped.envs = type(env.unwrapped.envs)(self._each)
        else:
            self._subject = self._subject_of(simulation_of(env)[0])
            self._range = range_of(env)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._env, name)

    def reset(self, **options: Any) -> Any:
        """Reset the environment, and begin an episode; what the environment gives."""
        if self._each:
            return self._env.reset(**options)
        self._end("reset")
        given = self._env.reset(**options)
        observation, _ = at_first(given)
        model, data = simulation_of(self._env)
        if model is not self._subject.model:  # some environments compile one for every episode
            self._subject = self._subject_of(model)
        name, index = name_of(self._env), len(self.files)
        path = self._free()
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
            "actions": self._range,
        }
        self._log = EpisodeLog(
            self._subject,
            data,
            path,
            about=about,
            observation=observation,
            verify=self._verify,
        )
        self.files.append(path)
        return given

    def has_next(self) -> bool:
        """Whether the next episode is there, whole, from before its run was stopped; it counts
        then, and its turn is over.
        """
        path = self._path()
        if not (self._resumed and path.exists()):
            return False
        result = Recording(path).result
        if result.aborted:
            return False
        self.files.append(path)
        self.steps += result.length
        return True

    def _path(self) -> Path:
        return self._out / f"{name_of(self._env)}-{len(self.files):06d}-{self.run}.mcap"

    def _free(self) -> Path:
        """The next episode's file; of a run that goes on, what it left half is begun again: a part
        file is replaced by the same steps and more, an aborted episode stays beside it.
        """
        first = path = self._path()
        attempt = 1
        while self._resumed and path.exists():
            attempt += 1
            path = first.with_name(f"{first.stem}-{attempt}{first.suffix}")
        if self._resumed:
            path.with_name(path.name + PART).unlink(missing_ok=True)
        return path

    def step(self, action: Any) -> Any:
        """Step the environment, and log the step; what the environment gives.

        Raises:
            SimulationError: if there is no episode, or the step cannot be replayed.
        """
        if self._each:
            return self._env.step(action)
        if self._log is None:
            raise SimulationError("step: expected an episode under way; call reset first")
        given = self._env.step(action)
        found, log = after(self._env, given), self._log
        log.step(
            action,
            found.reward,
            observation=found.observation,
            terminated=found.terminated,
            truncated=found.truncated,
            info=found.info,
        )
        self.steps += 1
        if found.terminated or found.truncated:
            self._count(log)
        return given

    def _subject_of(self, model: mujoco.MjModel) -> Subject:
        return Subject(model, source_of(self._env) if self._source is None else self._source)

    def _count(self, log: EpisodeLog) -> None:
        self.set_from_outside += log.set_from_outside
        self._log = None

    def close(self) -> None:
        """Close the episodes under way as aborted; the environment stays open."""
        self._end("interrupted")
        for each in self._each:
            each.close()
        if self._each:
            self._env.unwrapped.envs = type(self._env.unwrapped.envs)(self._inside)

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _end(self, why: str) -> None:
        if self._log is not None:
            self._log.close(aborted=why)
            self._count(self._log)


class _Part(Recorder):
    """One environment of a vectorised one; its files and counts are the whole's, too."""

    def __init__(self, whole: Recorder, *given: Any, **options: Any) -> None:
        super().__init__(*given, **options)
        self._whole = whole

    def reset(self, **options: Any) -> Any:
        given = super().reset(**options)
        self._whole.files.append(self.files[-1])
        return given

    def step(self, action: Any) -> Any:
        before = self.set_from_outside
        given = super().step(action)
        self._whole.steps += 1
        self._whole.set_from_outside += self.set_from_outside - before
        return given


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
        verify: Take the steps again while recording.
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
        Subject(model, source),
        data,
        path,
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
) -> Recorder:
    """Run a policy in a Gymnasium environment, and record its episodes.

    Args:
        env: On MuJoCo.
        policy: Observation in, action out.
        episodes: How many.
        out: Folder; files already in it stay as they are.
        seed: Of the first episode; each next one is one more. Not for a `reset` that takes none.
        about: What is known of the policy: kind, name, checkpoint_sha256.
        verify: Take the steps again while recording.
        source: The file or the text that its model was compiled from, where it does not say it.

    Returns:
        The recorder, closed: its files and counts.

    Raises:
        ConfigError: if the environment is not on MuJoCo.
        SimulationError: at the first step that cannot be replayed.
        StorageError: if a file cannot be written.
    """
    with Recorder(env, out, policy=about, verify=verify, source=source) as recorder:
        for _ in played(recorder, env, policy, range(seed, seed + episodes)):
            pass
    return recorder


def played(recorder: Recorder, env: Any, policy: Policy, seeds: Iterable[int]) -> Iterator[Path]:
    """Run a policy for an episode of each seed; the file of each as it ends.

    Args:
        recorder: Of the environment.
        env: The environment itself.
        policy: Observation in, action out.
        seeds: Not for a `reset` that takes none.

    Raises:
        SimulationError: at the first step that cannot be replayed.
        StorageError: if a file cannot be written.
    """
    seeded = takes_seed(env.reset)
    for seed in seeds:
        if not recorder.has_next():
            given = recorder.reset(**({"seed": seed} if seeded else {}))
            observation, over = at_first(given)[0], False
            while not over:
                found = after(env, recorder.step(policy(observation)))
                observation, over = found.observation, found.terminated or found.truncated
        yield recorder.files[-1]
