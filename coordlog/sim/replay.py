"""A log simulated again, from nothing but what it carries: its model, its first state and its
actions.

On the MuJoCo version and architecture that recorded it every number must come back bit for bit;
elsewhere only nearly (`exact_here` says which). Logs are replayed many at a time, each simulation
on its own log's model.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from coordlog.config import build
from coordlog.episode import CONTACT, Array, Header
from coordlog.errors import FormatError
from coordlog.robots.robot import Robot
from coordlog.sim.physics import STATE, Physics
from coordlog.sim.simulation import Outcome, Simulation
from coordlog.sim.task import Task
from coordlog.spec import FINAL, STEP
from coordlog.tasks.config import EnvConfig, RewardConfig

BEFORE = tuple(item.name for item in FINAL.fields[1:])
LED_TO = (
    "reward",
    "distance",
    "boundary",
    "goal",
    "collision",
    "instability",
    "terminated",
    "truncated",
)


class Log(NamedTuple):
    """What a replay needs of one episode."""

    header: Header
    model: mujoco.MjModel
    start: Array
    """Full mjSTATE_INTEGRATION vector, (n_state,)."""
    action: Array
    """(T, n_u) float32."""


class Trace(NamedTuple):
    """What came out: the columns of an episode, with the shapes of `episode.Episode`."""

    columns: dict[str, Array]
    contacts: Array


def exact_here(header: Header) -> str:
    """Why this machine can only come near the log; empty if it must reproduce it bit for bit."""
    wanted = (header.env["mujoco_version"], header.env["architecture"])
    here = (mujoco.__version__, platform.machine())
    return (
        ""
        if wanted == here
        else f"recorded with MuJoCo {wanted[0]} on {wanted[1]}, replayed with MuJoCo {here[0]} on {here[1]}"
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


def task_of(log: Log) -> Task:
    """The task a log was recorded in, rebuilt from its header and model; the last one is kept."""
    global _last
    if _last is None or _last[0] is not log.header or _last[1] is not log.model:
        env = log.header.env
        config, reward = build(EnvConfig, env["config"]), build(RewardConfig, env["reward"])
        task = Task(Robot.from_json(env["robot"]), log.model, config, reward)
        _last = log.header, log.model, task
    return _last[2]


_last: tuple[Header, mujoco.MjModel, Task] | None = None


def _replay_alike(logs: Sequence[Log], *, threads: int) -> list[Trace]:
    """Replay logs of one environment, one simulation each."""
    task, n = task_of(logs[0]), len(logs)
    physics = Physics(logs[0].model, n=n, threads=threads, models=[log.model for log in logs])
    simulation = Simulation(task, physics, n=n)
    size = mujoco.mj_stateSize(logs[0].model, STATE)
    for i, log in enumerate(logs):
        if log.start.shape != (size,):
            raise FormatError(
                f"initial state: expected {size} numbers for this model, got {log.start.size}"
            )
        physics.rows[i] = log.start
    radii = np.array([log.model.geom_size[task.sphere_geoms, 0] for log in logs])
    simulation.begin(np.arange(n), radii)
    lengths = np.array([len(log.action) for log in logs])
    columns = _empty(logs, lengths)
    contacts: list[list[Array]] = [[] for _ in logs]
    for step in range(int(lengths.max(initial=0)) + 1):
        _observe(columns, simulation, np.flatnonzero(lengths >= step), step)
        running = np.flatnonzero(lengths > step)
        if len(running):
            outcome = simulation.step(
                np.stack([logs[int(i)].action[step] for i in running]), running
            )
            _store(columns, contacts, outcome, running, step)
    return [
        Trace(columns[i], np.concatenate(rows) if rows else np.zeros(0, dtype=CONTACT))
        for i, rows in enumerate(contacts)
    ]


def _empty(logs: Sequence[Log], lengths: Array) -> list[dict[str, Array]]:
    fields = [item for item in STEP.fields[1:] if item.name != "action"]
    return [
        {
            item.name: np.zeros(
                log.header.layout.shape(item, int(length) + (item.name in BEFORE)), dtype=item.type
            )
            for item in fields
        }
        for log, length in zip(logs, lengths, strict=True)
    ]


def _observe(
    columns: list[dict[str, Array]], simulation: Simulation, ids: Array, step: int
) -> None:
    for name in BEFORE:
        values = getattr(simulation, name)
        for i in ids:
            columns[i][name][step] = values[i]


def _store(
    columns: list[dict[str, Array]],
    contacts: list[list[Array]],
    outcome: Outcome,
    ids: Array,
    step: int,
) -> None:
    for name in LED_TO:
        for i, value in zip(ids, getattr(outcome, name), strict=True):
            columns[i][name][step] = value
    for row in np.flatnonzero(outcome.collision):
        rows = outcome.contacts[row].copy()
        rows["step"] = step
        contacts[ids[row]].append(rows)
