"""One held-out problem set up in the simulation, and paths executed from its first state."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from coordlog.contracts import Problem
from coordlog.episode import Array, Header
from coordlog.sim.env import BatchEnv
from coordlog.sim.replay import Log, bound_task
from coordlog.sim.scoring import Score
from coordlog.sim.tracking import Drive, Run, run
from experiments.measure import SEED, SPLIT

ONE = np.zeros(1, dtype=np.int64)
TRIM = 0.3
"""Share of the remaining error by which the servo targets are moved at each step once a path has
come to its end, as smoothing does it."""


class Case(NamedTuple):
    """A problem, and a log of it that has no action yet."""

    problem: Problem
    log: Log
    qpos: Array
    """Configuration at the start, (n_q,)."""


def case(env: BatchEnv, index: int) -> Case:
    """Set up a held-out problem in simulation 0."""
    problem = env.problem(seed=SEED, split=SPLIT, index=index)
    env.reset(ONE, [problem])
    physics = env.physics
    said = {
        "schema_version": 1,
        "control_period": env.task.config.control_period,
        "start_time": 0,
        "goals": [],
        "obstacles": [],
    }
    header = Header(
        said, env.describe(), {"kind": "", "name": "", "checkpoint_sha256": "", "noise": {}}
    )
    log = Log(
        header,
        physics.model_of(0),
        physics.rows[0].copy(),
        np.zeros((0, env.layout.n_u), dtype=np.float32),
    )
    return Case(problem, log, physics.qpos[0].copy())


def chase(log: Log, path: Callable[[float], Array], duration: float) -> Run:
    """Drive the servos along a path of the action joints, path(t) (n_u,) [rad], and hold its end
    until the episode does.
    """
    task = bound_task(log)
    period, (low, high) = task.config.control_period, task.limits.T
    trim = np.zeros(len(low))

    def act(step: int, drive: Drive) -> Array:
        nonlocal trim
        if step * period >= duration:
            trim = trim + TRIM * (path(duration) - drive.angles)
        return drive.action_to(np.clip(path(min((step + 1) * period, duration)) + trim, low, high))

    return run(log, act)


def score(ran: Run) -> Score:
    """How an execution went, as an episode is scored."""
    columns, goal = ran.columns, ran.columns["goal"]
    success = bool(goal[-1].all()) and not ran.diverged
    collided, fell = bool(columns["collision"].any()), bool(columns["instability"].any())
    arrival = [int(column.argmax()) if column.any() else -1 for column in goal.T]
    return Score(
        length=len(goal),
        success=success,
        clean=success and not collided and not fell,
        collided=collided,
        fell=fell,
        distance=tuple(columns["distance"][-1].tolist()),
        arrival=tuple(arrival),
        diverged=ran.diverged,
    )
