"""Logs as an environment: each simulation starts on its own log's model, in its first state.

With the logged actions that is a replay. On the MuJoCo version and architecture that recorded a log
every number must come back bit for bit; elsewhere only nearly (`exact_here` says which).
"""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from coordlog.config import build
from coordlog.contracts import Outcome, Problem
from coordlog.episode import CONTACT, Array, Episode, Header
from coordlog.errors import FormatError
from coordlog.robots.robot import Robot
from coordlog.sim import foreign
from coordlog.sim.physics import STATE, Physics
from coordlog.sim.rollout import rollout
from coordlog.sim.simulation import Simulation
from coordlog.sim.task import BoundTask
from coordlog.sim.traced import Trace, Traced
from coordlog.spec import CORE, before, names
from coordlog.tasks import registry
from coordlog.tasks.config import EnvConfig, RewardConfig
from coordlog.tasks.unknown import UnknownTask

GOALS = "goals"
"""A task's field of this name, "3*k" wide and before the action, says where goals that move are."""


class Log(NamedTuple):
    """What a replay needs of one episode."""

    header: Header
    model: mujoco.MjModel
    start: Array
    """Full mjSTATE_INTEGRATION vector, (n_state,)."""
    action: Array
    """(T, n_u) float32."""
    given: Mapping[str, Array] = {}
    """The task's logged columns that hold before an action, (T + 1, …); of an episode of another
    program's environment all columns."""
    inputs: Mapping[str, Array] = {}
    """What else the physics was given: columns of `spec.INPUTS`."""

    @classmethod
    def of(cls, episode: Episode, model: mujoco.MjModel, start: Array) -> Log:
        """The log of an episode: its header, actions, and what its task was given."""
        if episode.header.task == foreign.TASK:
            return cls(
                episode.header, model, start, episode.action, episode.columns, episode.inputs
            )
        fields = before(episode.header.fields)
        given = {item.name: getattr(episode, item.name) for item in fields if item.owner != CORE}
        return cls(episode.header, model, start, episode.action, given)


def exact_here(header: Header) -> str:
    """Why this machine can only come near the log; empty if it must reproduce it bit for bit."""
    wanted = (header.env["mujoco_version"], header.env["architecture"])
    here = (mujoco.__version__, platform.machine())
    return (
        ""
        if wanted == here
        else (
            f"recorded with MuJoCo {wanted[0]} on {wanted[1]}, replayed with MuJoCo {here[0]} on "
            f"{here[1]}"
        )
    )


def replay(logs: Sequence[Log], *, threads: int = 1) -> list[Trace]:
    """Simulate logs again; the order of the result is that of the logs.

    Raises:
        FormatError: if a log's first state does not fit its model, or its model lacks what its
            header names.
    """
    groups: dict[str, list[int]] = {}
    for i, log in enumerate(logs):
        groups.setdefault(
            json.dumps(log.header.env, sort_keys=True) + str(log.model.nbuffer), []
        ).append(i)
    traces: dict[int, Trace] = {}
    for members in groups.values():
        traces.update(
            zip(members, _replay_alike([logs[i] for i in members], threads=threads), strict=True)
        )
    return [traces[i] for i in range(len(logs))]


def resting_of(header: Header) -> list[tuple[int, int]]:
    """Pairs of geoms whose contacts are none in an episode."""
    return [(int(one), int(other)) for one, other in header.env.get("resting", [])]


def _replay_alike(logs: Sequence[Log], *, threads: int) -> list[Trace]:
    """Replay logs of one environment, one simulation each."""
    if logs[0].header.task == foreign.TASK:
        return [_retraced(log) for log in logs]
    env = Traced(LogEnv(logs, threads=threads))
    lengths = np.array([len(log.action) for log in logs])
    ids = np.arange(len(logs))
    env.reset(ids, [env.problem(seed=0, split="", index=int(i)) for i in ids])

    def over(ids: Array, outcome: Outcome) -> Array:
        return np.asarray(env.steps[ids] >= lengths[ids])

    actor = Logged([log.action for log in logs])
    for _ in rollout(env, actor, (), seed=0, running=ids[lengths > 0], over=over):
        pass
    rules, wanted = env.rules, set(names(logs[0].header.fields)) - {"action"}
    if isinstance(rules, UnknownTask):
        wanted -= rules.untold
    return [env.trace(int(i), wanted) for i in ids]


def _retraced(log: Log) -> Trace:
    """An episode of another program's environment again: its motion, not its task."""
    ctrl = log.given.get("ctrl", np.zeros((len(log.action), 0)))
    moved = foreign.retrace(log.model, log.start, ctrl, log.given[foreign.SUBSTEPS], log.inputs)
    return Trace(moved, np.zeros(0, CONTACT))


def bound_task(log: Log) -> BoundTask:
    """The task a log was recorded in, rebuilt from its header and model; the last one is kept.

    Where the task is not installed, a stand-in that judges nothing.

    Raises:
        ConfigError: if the model lacks what the header names.
    """
    global _last
    if _last is None or _last[0] is not log.header or _last[1] is not log.model:
        env = log.header.env
        config, reward = build(EnvConfig, env["config"]), build(RewardConfig, env["reward"])
        robot, rules = Robot.from_json(env["robot"]), registry.task_or_unknown(env)
        _last = log.header, log.model, BoundTask(rules, robot, log.model, config, reward)
    return _last[2]


_last: tuple[Header, mujoco.MjModel, BoundTask] | None = None


class LogEnv:
    """Logs of one environment, simulation i on the model of log i; episode i starts as log i did.

    Example:
        >>> env = LogEnv([log])                                 # doctest: +SKIP
        >>> env.reset(ids, [env.problem(seed=0, split="", index=0)])  # doctest: +SKIP
    """

    def __init__(self, logs: Sequence[Log], *, threads: int = 1) -> None:
        """Build the simulations.

        Args:
            logs: Of one environment; their models have one layout.
            threads: Threads to simulate on.

        Raises:
            ConfigError: if a model lacks what its header names.
        """
        self._logs, self.task = logs, bound_task(logs[0])
        models, resting = [log.model for log in logs], resting_of(logs[0].header)
        own = models if any(model is not models[0] for model in models) else None
        self.physics = Physics(models[0], n=len(logs), threads=threads, models=own, resting=resting)
        self.simulation = Simulation(self.task, self.physics, n=len(logs))

    @property
    def n(self) -> int:
        """Number of simulations."""
        return len(self._logs)

    @property
    def state(self) -> Array:
        """Present policy state of every simulation, (N, n_x) float32."""
        return self.simulation.state

    def present(self, ids: Array) -> dict[str, Array]:
        """Every field that holds before an action, (len(ids), …)."""
        return self.simulation.present(ids)

    def problem(self, *, seed: int, split: str, index: int) -> Problem:
        """What log `index` started from; its first state says everything else."""
        none = np.zeros((0, 4))
        return Problem(seed, split, index, none[:, :3], None, none, none[:, 0])

    def reset(self, ids: Array, problems: list[Problem]) -> None:
        """Put simulation i in the first state of log i.

        Raises:
            FormatError: if a first state does not fit its model.
        """
        tracks: list[Array | None] = []
        radii = np.zeros((len(ids), self.task.n_spheres))
        for row, (sim, problem) in enumerate(zip(ids.tolist(), problems, strict=True)):
            assert sim == problem.index, "a log runs on its own model alone"
            log = self._logs[sim]
            self.physics.rows[sim] = first_state(log)
            radii[row] = log.model.geom_size[self.task.sphere_geoms, 0]
            goals = log.given.get(GOALS)
            tracks.append(None if goals is None else goals.reshape(len(goals), -1, 3))
        self.simulation.begin(ids, radii, tracks)

    def step(self, action: Array, ids: Array) -> Outcome:
        """Advance simulations `ids` by one control period."""
        return self.simulation.step(action, ids)


def first_state(log: Log) -> Array:
    """The log's first state, (n_state,).

    Raises:
        FormatError: if it does not fit the log's model.
    """
    size = mujoco.mj_stateSize(log.model, STATE)
    if log.start.shape != (size,):
        raise FormatError(
            f"initial state: expected {size} numbers for this model, got {log.start.size}"
        )
    return log.start


class Logged:
    """A policy that does again what was done: row t of a log's actions at its step t."""

    def __init__(self, actions: Sequence[Array]) -> None:
        self._actions = actions
        self._step = np.zeros(len(actions), dtype=np.int64)

    def begin(self, ids: Array, state: Array, rngs: list[np.random.Generator]) -> None:
        """Start at the first action."""
        self._step[ids] = 0

    def act(self, ids: Array, state: Array) -> Array:
        """The logged actions, (n, n_u)."""
        found = [self._actions[sim][self._step[sim]] for sim in ids.tolist()]
        self._step[ids] += 1
        return np.stack(found)
