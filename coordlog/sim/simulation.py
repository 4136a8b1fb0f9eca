"""Physics and task together: N simulations that take actions and return flags and rewards.

Live environments, replays of logs and executions of paths all run on this one class, so what is
checked is what was recorded.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from coordlog.contracts import Outcome, Reading
from coordlog.episode import Array
from coordlog.sim.physics import Physics
from coordlog.sim.task import BoundTask
from coordlog.spec import before
from coordlog.tasks.progress import Progress
from coordlog.tasks.registry import follow


class Simulation:
    """N simulations; `qpos`, `qvel`, `state` are always the present ones, (N, …).

    Example:
        >>> outcome = env.simulation.step(action, ids)          # doctest: +SKIP
        >>> env.simulation.present(ids)["qpos"].shape           # doctest: +SKIP
        (16, 41)
    """

    def __init__(self, task: BoundTask, physics: Physics, *, n: int) -> None:
        self.task, self.physics, self.n = task, physics, n
        self.steps: Array = np.zeros(n, dtype=np.int64)
        self.radii: Array = np.zeros((n, task.n_spheres))
        """Of the spheres as simulated, (N, n_spheres) [m]."""
        self.state: Array = np.zeros((n, len(task.view)), dtype=np.float32)
        self.target: Array = np.zeros((n, task.model.nu))
        """Present servo targets, (N, n_c)."""
        self.command: Array = np.zeros((n, len(task.servos)))
        """Present velocity command of the action joints, (N, n_u), as share of their speeds."""
        self._com_velocity = np.zeros((n, 3))
        self._progress = Progress(task.rules, n)
        self._tracks: dict[int, Array] = {}
        self._given: dict[str, Array] = {}
        self._has_given = bool(before(task.fields))

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

    def present(self, ids: Array) -> dict[str, Array]:
        """Every field that holds before an action, the core's and the task's, (len(ids), …)."""
        core = {
            "time": self.time[ids],
            "qpos": self.qpos[ids],
            "qvel": self.qvel[ids],
            "state": self.state[ids],
        }
        return core | {name: values[ids] for name, values in self._given.items()}

    def begin(self, ids: Array, radii: Array, tracks: list[Array | None] | None = None) -> None:
        """Start episodes from the states that stand in `physics.rows[ids]`.

        Args:
            ids: Which simulations.
            radii: Radii of their spheres, (len(ids), n_spheres) [m].
            tracks: Where their goals are before each step and after the last, (T + 1, k, 3) [m]
                each; None for goals that stay where they are.
        """
        for row, sim in enumerate(ids.tolist()):
            self._tracks.pop(sim, None)
            track = tracks[row] if tracks else None
            if track is not None:
                self._tracks[sim] = track
        self.physics.refresh(ids)
        self._progress.forget(ids)
        self.steps[ids] = 0
        self.radii[ids] = radii
        self.command[ids] = 0.0
        self.target[ids] = self.physics.ctrl[ids]
        self._move_goals(ids)
        sensors = self.physics.sensors[ids]
        self._com_velocity[ids] = self.task.com_velocity(sensors)
        self._observe(ids, self._reading(ids, sensors))

    def step(self, action: Array, ids: Array) -> Outcome:
        """Advance some simulations by one control period.

        The command is filtered, integrated to servo targets and moved to linearly over the
        substeps; then goals that move are moved.

        Args:
            action: Actions to execute, shape (len(ids), n_u), float32 in [-1, 1].
            ids: Which simulations.
        """
        task = self.task
        velocity = task.filtered(self.command[ids], action)
        start = self.target[ids]
        after = task.target(start, velocity)
        self.command[ids], self.target[ids] = velocity, after
        collision, contacts = self.physics.advance(ids, start, after, substeps=task.substeps)
        self.steps[ids] += 1
        self._move_goals(ids)
        sensors = self.physics.sensors[ids]
        reading = self._reading(ids, sensors)
        self._observe(ids, reading)
        com_velocity = task.com_velocity(sensors)
        acceleration = (com_velocity - self._com_velocity[ids]) / task.config.control_period
        self._com_velocity[ids] = com_velocity
        unstable = task.instability(sensors, acceleration)
        reading = replace(reading, collision=collision, instability=unstable)
        columns = self._columns(ids, reading, after)
        self._progress.add(ids, columns)
        success, clean = self._progress.success(ids), self._progress.clean(ids)
        return Outcome(columns, self.physics.diverged(ids), contacts, success, clean)

    def _columns(self, ids: Array, reading: Reading, ctrl: Array) -> dict[str, Array]:
        """Every field that holds after the step, the core's first."""
        found = follow(self.task.rules, self.task.rules.measure(reading))
        terminated = found["terminated"]
        core = {
            "reward": found["reward"],
            "terminated": terminated,
            "truncated": ~terminated & (self.steps[ids] >= self.task.config.max_steps),
            "ctrl": ctrl,
            "torque": self.physics.torque[ids],
        }
        return core | {
            item.name: found[item.name] for item in self.task.fields if item.when == "after"
        }

    def _move_goals(self, ids: Array) -> None:
        """Put goals that move where they are at the present step."""
        if not self._tracks:
            return
        for sim in ids.tolist():
            track = self._tracks.get(sim)
            if track is not None:
                at = min(int(self.steps[sim]), len(track) - 1)
                self.physics.mocap_pos[sim, self.task.goal_mocaps] = track[at]

    def _reading(self, ids: Array, sensors: Array) -> Reading:
        physics = self.physics
        told = self.radii[ids] - self.task.config.inflate
        return self.task.reading(
            physics.qpos[ids], physics.qvel[ids], sensors, physics.mocap_pos[ids], told
        )

    def _observe(self, ids: Array, reading: Reading) -> None:
        self.state[ids] = self.task.state(reading)
        if self._has_given:
            for name, values in self.task.rules.given(reading).items():
                if name not in self._given:
                    self._given[name] = np.zeros((self.n, *values.shape[1:]), values.dtype)
                self._given[name][ids] = values
