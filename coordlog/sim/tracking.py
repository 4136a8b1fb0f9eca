"""A log's scene run again with other actions than the logged ones, from the log's own first state
to its own end rules.

What acts is told the present servo targets and joint angles, and may ask which action brings a
target about (`Drive`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import mujoco
import numpy as np

from coordlog.contracts import Outcome
from coordlog.episode import Array
from coordlog.sim.physics import STATE
from coordlog.sim.replay import Log, LogEnv, bound_task, first_state
from coordlog.sim.rollout import ended, rollout
from coordlog.sim.simulation import Simulation
from coordlog.sim.traced import Traced
from coordlog.spec import names


class Drive:
    """The action joints of one simulation, and the action that moves their servo targets.

    Example:
        >>> run(log, lambda step, drive: drive.action_to(path(step)))  # doctest: +SKIP
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation, self._task = simulation, simulation.task

    @property
    def angles(self) -> Array:
        """Where the action joints are, (n_u,) [rad]."""
        return np.asarray(self._simulation.qpos[0, self._task.qpos_index])

    @property
    def target(self) -> Array:
        """Where their servos are told to bring them, (n_u,) [rad]."""
        return np.asarray(self._simulation.target[0, self._task.servos])

    def action_to(self, target: Array) -> Array:
        """The action that brings the targets to `target` (n_u,) in one control period, or as near
        as an action can, (n_u,) float32.
        """
        return self._task.action_to(target, self.target, self._simulation.command[0])


class _Driver:
    """A function of step and drive, as a policy."""

    def __init__(self, act: Callable[[int, Drive], Array], simulation: Simulation) -> None:
        self._act, self._simulation = act, simulation
        self._drive = Drive(simulation)

    def begin(self, ids: Array, state: Array, rngs: list[np.random.Generator]) -> None:
        """Nothing to prepare."""

    def act(self, ids: Array, state: Array) -> Array:
        """What the function says, (1, n_u)."""
        return self._act(int(self._simulation.steps[0]), self._drive)[None]


class Run(NamedTuple):
    """What came out of T steps."""

    columns: dict[str, Array]
    """The fields that the log's header names, with the shapes of `episode.Episode`."""
    contacts: Array  # (C,) CONTACT
    torque: Array  # (T, n_u) Nm of the action joints, at the end of each step
    diverged: bool


def run(log: Log, act: Callable[[int, Drive], Array], *, steps: int | None = None) -> Run:
    """Run a log's scene until its episode ends, by the end rules of the log's own configuration.

    Args:
        log: Model, first state and constants; its actions are not looked at.
        act: Action (n_u,) float32 in [-1, 1] for a step and the joints before it.
        steps: Stop after this many, if nothing ends it earlier.

    Raises:
        FormatError: if the first state does not fit the model.
    """
    env = LogEnv([log])
    traced, diverged = Traced(env), False

    def over(ids: Array, outcome: Outcome) -> Array:
        enough = steps is not None and bool(traced.steps[0] >= steps)
        return ended(ids, outcome) | enough

    for _, outcome in rollout(traced, _Driver(act, env.simulation), [0], seed=0, over=over):
        diverged = bool(outcome.diverged[0])
    every, contacts = traced.trace(0)
    torque = every["torque"][:, env.task.servos]
    columns = {name: every[name] for name in names(log.header.fields)}
    return Run(columns, contacts, torque, diverged)


def targets(log: Log) -> Array:
    """Servo targets of the action joints before each logged action and after the last, (T + 1, n_u)
    [rad].

    Raises:
        FormatError: if the first state does not fit the model.
    """
    task, data = bound_task(log), mujoco.MjData(log.model)
    mujoco.mj_setState(log.model, data, first_state(log), STATE)
    target, command = data.ctrl[None].copy(), np.zeros((1, len(task.servos)))
    found = [target[0, task.servos]]
    for action in log.action:
        command = task.filtered(command, action[None])
        target = task.target(target, command)
        found.append(target[0, task.servos])
    return np.stack(found)


def torques(log: Log, wanted: Array) -> Array:
    """Torques of the action joints at the end of each logged step, (T, n_u) [Nm].

    The physics alone: nothing is observed, and no task decides.

    Args:
        log: Model and first state.
        wanted: Servo targets as from `targets`.
    """
    task, model, data = bound_task(log), log.model, mujoco.MjData(log.model)
    mujoco.mj_setState(model, data, first_state(log), STATE)
    found = np.empty((len(wanted) - 1, len(task.servos)))
    before = data.ctrl.copy()
    for step in range(len(found)):
        after = before.copy()
        after[task.servos] = wanted[step + 1]
        for k in range(task.substeps):
            data.ctrl[:] = before + (after - before) * ((k + 1.0) / task.substeps)
            mujoco.mj_step(model, data)
        found[step], before = data.actuator_force[task.servos], after
    return found
