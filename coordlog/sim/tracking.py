"""A log's scene run again with other actions than the logged ones, from the log's own first state
to its own end rules.

`Drive` keeps the servo targets that `Simulation` computes, and inverts them: which action brings a
target about.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import mujoco
import numpy as np

from coordlog.episode import CONTACT, Array
from coordlog.errors import FormatError
from coordlog.sim.physics import STATE, Physics
from coordlog.sim.replay import BEFORE, LED_TO, Log, task_of
from coordlog.sim.simulation import Simulation
from coordlog.sim.task import Task


class Drive:
    """Servo targets of the action joints under the command filter v ← c v + (1 - c) a, computed as
    `Simulation` does.
    """

    def __init__(self, task: Task, ctrl: Array) -> None:
        """Start at rest from the servo targets `ctrl` (n_servos,)."""
        self._task, self._ctrl = task, ctrl[None].copy()
        self._velocity = np.zeros(len(task.servos))
        self.angles: Array = np.zeros(len(task.servos))
        """Where the action joints are now, (n_u,) [rad].

        For whoever runs the simulation to keep.
        """

    @property
    def target(self) -> Array:
        """Present targets of the action joints, (n_u,) [rad]."""
        return np.asarray(self._ctrl[0, self._task.servos])

    def step(self, action: Array) -> None:
        """Move by one control period."""
        smoothing = self._task.config.smoothing
        self._velocity = smoothing * self._velocity + (1.0 - smoothing) * action.astype(np.float64)
        self._ctrl = self._task.target(self._ctrl, self._velocity[None])

    def action_to(self, target: Array) -> Array:
        """The action that brings the targets to `target` (n_u,) in one control period, or as near
        as an action can, (n_u,) float32.
        """
        config = self._task.config
        step = self._task.speeds * config.control_period
        velocity = np.divide(
            target - self.target, step, out=np.zeros(len(step)), where=step > 0
        )  # a locked joint stays
        action = (velocity - config.smoothing * self._velocity) / (1.0 - config.smoothing)
        return np.asarray(np.clip(action, -1.0, 1.0).astype(np.float32))


class Run(NamedTuple):
    """What came out of T steps."""

    columns: dict[str, Array]
    """The fields of `spec.STEP` but `step`, with the shapes of `episode.Episode`."""
    contacts: Array  # (C,) CONTACT
    torque: Array  # (T, n_u) Nm of the action joints, at the end of each step
    diverged: bool


def run(log: Log, act: Callable[[int, Drive], Array], *, steps: int | None = None) -> Run:
    """Run a log's scene until its episode ends, by the end rules of the log's own configuration.

    Args:
        log: Model, first state and constants; its actions are not looked at.
        act: Action (n_u,) float32 in [-1, 1] for a step and the servo targets before it.
        steps: Stop after this many, if nothing ends it earlier.

    Raises:
        FormatError: if the first state does not fit the model.
    """
    task = task_of(log)
    physics = Physics(log.model, n=1, threads=1, models=[log.model])
    simulation, ids = Simulation(task, physics, n=1), np.array([0])
    physics.rows[0] = _fitting(log)
    simulation.begin(ids, log.model.geom_size[task.sphere_geoms, 0][None])
    works = physics.torque  # bound before the first step: a later binding begins with zeros
    drive = Drive(task, physics.ctrl[0])
    before: dict[str, list[Array]] = {
        name: [getattr(simulation, name)[0].copy()] for name in BEFORE
    }
    led_to: dict[str, list[Array]] = {name: [] for name in LED_TO}
    actions: list[Array] = []
    torque: list[Array] = []
    contacts: list[Array] = []
    over = diverged = False
    while not over and (steps is None or len(actions) < steps):
        drive.angles = simulation.qpos[0, task.qpos_index]
        action = act(len(actions), drive)
        drive.step(action)
        outcome = simulation.step(action[None], ids)
        rows = outcome.contacts[0].copy()
        rows["step"] = len(actions)
        contacts.append(rows)
        actions.append(action)
        torque.append(works[0, task.servos].copy())
        for name in BEFORE:
            before[name].append(getattr(simulation, name)[0].copy())
        for name in LED_TO:
            led_to[name].append(getattr(outcome, name)[0])
        diverged = bool(outcome.diverged[0])
        over = diverged or bool(outcome.terminated[0] | outcome.truncated[0])
    columns = {name: np.array(values) for name, values in (before | led_to).items()}
    return Run(
        columns | {"action": np.array(actions)},
        np.concatenate([np.zeros(0, CONTACT), *contacts]),
        np.array(torque),
        diverged,
    )


def targets(log: Log) -> Array:
    """Servo targets of the action joints before each logged action and after the last, (T + 1, n_u)
    [rad].

    Raises:
        FormatError: if the first state does not fit the model.
    """
    data = mujoco.MjData(log.model)
    mujoco.mj_setState(log.model, data, _fitting(log), STATE)
    drive = Drive(task_of(log), data.ctrl)
    found = [drive.target.copy()]
    for action in log.action:
        drive.step(action)
        found.append(drive.target.copy())
    return np.stack(found)


def torques(log: Log, wanted: Array) -> Array:
    """Torques of the action joints at the end of each logged step, (T, n_u) [Nm].

    The physics alone: nothing is observed, and no task decides.

    Args:
        log: Model and first state.
        wanted: Servo targets as from `targets`.
    """
    task, model, data = task_of(log), log.model, mujoco.MjData(log.model)
    mujoco.mj_setState(model, data, _fitting(log), STATE)
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


def _fitting(log: Log) -> Array:
    size = mujoco.mj_stateSize(log.model, STATE)
    if log.start.shape != (size,):
        raise FormatError(
            f"initial state: expected {size} numbers for this model, got {log.start.size}"
        )
    return log.start
