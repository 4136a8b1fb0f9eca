"""Physics and task together: N simulations that take actions and return flags and rewards.

Live environments and replays of logs both run on this one class, so what is checked is what was
recorded.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coordlog.episode import Array
from coordlog.sim.physics import Physics
from coordlog.sim.task import Task
from coordlog.tasks.reach import reward


class Outcome(NamedTuple):
    """What one step led to, one row per simulation stepped."""

    reward: Array  # (n, k)
    distance: Array  # (n, k) m
    boundary: Array  # (n, k) bool
    goal: Array  # (n, k) bool
    collision: Array  # (n,) bool
    instability: Array  # (n,) bool
    terminated: Array  # (n,) bool
    truncated: Array  # (n,) bool
    diverged: Array  # (n,) bool: the state is no number any more, and nothing above means anything
    contacts: list[Array]  # CONTACT rows per simulation, step not yet filled in


class Simulation:
    """N simulations; `qpos`, `qvel`, `state` are always the present ones, (N, …)."""

    def __init__(self, task: Task, physics: Physics, *, n: int) -> None:
        self.task, self.physics, self.n = task, physics, n
        self.steps: Array = np.zeros(n, dtype=np.int64)
        self.radii: Array = np.zeros((n, task.n_spheres))
        """Of the spheres as simulated, (N, n_spheres) [m]."""
        self.state: Array = np.zeros((n, len(task.view)), dtype=np.float32)
        self._target = np.zeros((n, task.model.nu))
        self._velocity = np.zeros((n, len(task.servos)))
        self._com_velocity = np.zeros((n, 3))

    @property
    def qpos(self) -> Array:
        """Present MuJoCo qpos, (N, n_q)."""
        return self.physics.qpos

    @property
    def qvel(self) -> Array:
        """Present MuJoCo qvel, (N, n_v)."""
        return self.physics.qvel

    @property
    def time(self) -> Array:
        """Present time since the start of each episode, (N,) [s]: steps times the control
        period.
        """
        return self.steps * self.task.config.control_period

    def begin(self, ids: Array, radii: Array) -> None:
        """Start episodes from the states that stand in `physics.rows[ids]`.

        `radii` are their spheres', (len(ids), n_spheres) [m].
        """
        self.physics.refresh(ids)
        self.steps[ids] = 0
        self.radii[ids] = radii
        self._velocity[ids] = 0.0
        self._target[ids] = self.physics.ctrl[ids]
        sensors = self.physics.sensors[ids]
        self._com_velocity[ids] = self.task.com_velocity(sensors)
        self._observe(ids, sensors)

    def step(self, action: Array, ids: Array) -> Outcome:
        """Advance some simulations by one control period.

        The command is filtered, integrated to servo targets and moved to linearly over the
        substeps, v ← c v + (1 - c) a.

        Args:
            action: Actions to execute, shape (len(ids), n_u), float32 in [-1, 1].
            ids: Which simulations.
        """
        task, config = self.task, self.task.config
        velocity = config.smoothing * self._velocity[ids] + (
            1.0 - config.smoothing
        ) * action.astype(np.float64)
        before = self._target[ids]
        after = task.target(before, velocity)
        self._velocity[ids], self._target[ids] = velocity, after
        collision, contacts = self.physics.advance(ids, before, after, substeps=task.substeps)
        self.steps[ids] += 1
        sensors = self.physics.sensors[ids]
        self._observe(ids, sensors)
        return self._outcome(ids, sensors, collision, contacts)

    def _outcome(
        self, ids: Array, sensors: Array, collision: Array, contacts: list[Array]
    ) -> Outcome:
        task = self.task
        com_velocity = task.com_velocity(sensors)
        acceleration = (com_velocity - self._com_velocity[ids]) / task.config.control_period
        self._com_velocity[ids] = com_velocity
        distance = reward.distances(task.palms(sensors), task.goals(self.physics.mocap_pos[ids]))
        boundary, goal = reward.proximity(distance, task.config)
        flags = reward.Flags(boundary, goal, collision, task.instability(sensors, acceleration))
        terminated = reward.terminations(flags)
        truncated = ~terminated & (self.steps[ids] >= task.config.max_steps)
        earned = reward.rewards(distance, flags, task.reward)
        return Outcome(
            earned, distance, *flags, terminated, truncated, self.physics.diverged(ids), contacts
        )

    def _observe(self, ids: Array, sensors: Array) -> None:
        physics = self.physics
        told = self.radii[ids] - self.task.config.inflate
        self.state[ids] = self.task.state(
            physics.qpos[ids], physics.qvel[ids], sensors, physics.mocap_pos[ids], told
        )
