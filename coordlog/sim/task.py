"""What a model's numbers mean to the task: palms, goals, balance, policy state, servo targets.
Arrays in, arrays out.

A task is built from a robot spec and a compiled model by name alone, so a live scene and the model
attached to a log give the same task.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from coordlog.episode import Array
from coordlog.errors import ConfigError, unknown
from coordlog.kinematics import balance
from coordlog.mjcf.servos import require_servos
from coordlog.robots.robot import Robot
from coordlog.tasks.config import EnvConfig, RewardConfig
from coordlog.tasks.reach.fields import FIELDS
from coordlog.tasks.reach.observation import nearness, state_view
from coordlog.tasks.scene import goal_body, link_sensor, palm_sensor, sole_corner, sphere_geom


class Task:
    """The paper's task for one robot in one compiled model.

    Holds indices and constants, never a state.
    """

    name = "reach"
    fields = FIELDS

    def __init__(
        self, robot: Robot, model: mujoco.MjModel, config: EnvConfig, reward: RewardConfig
    ) -> None:
        """Look up every name once.

        Raises:
            ConfigError: if the model lacks a joint, servo, site or body that the spec names.
        """
        self.robot, self.model, self.config, self.reward = robot, model, config, reward
        try:
            joints = [model.joint(name) for name in robot.action_joints]
            servos = require_servos(model, robot)
            self._goals = [int(model.body(goal_body(arm.name)).mocapid[0]) for arm in robot.arms]
            self._palms = self._sensors([palm_sensor(arm.name) for arm in robot.arms])
        except KeyError as error:
            raise ConfigError(
                f"robot '{robot.name}': its spec names something its model lacks: {str(error).splitlines()[0]}"
            ) from error
        self.n_spheres = 0
        while mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, sphere_geom(self.n_spheres)) >= 0:
            self.n_spheres += 1
        self.sphere_geoms = [model.geom(sphere_geom(i)).id for i in range(self.n_spheres)]
        self.sphere_mocaps = [
            int(model.body(sphere_geom(i)).mocapid[0]) for i in range(self.n_spheres)
        ]
        self.goal_mocaps = self._goals
        self.substeps = config.substeps(model.opt.timestep)
        self.qpos_index: Array = np.array([joint.qposadr[0] for joint in joints])
        self.qvel_index: Array = np.array([joint.dofadr[0] for joint in joints])
        self.servos: Array = np.array(servos)
        self.limits: Array = np.array([joint.range for joint in joints])  # (n_u, 2) rad
        for name, (low, high) in zip(robot.action_joints, self.limits, strict=True):
            if not low < high:
                raise ConfigError(
                    f"robot '{robot.name}': expected a range for joint '{name}', which the action moves; its model has none"
                )
        for name in config.locked:
            if name not in robot.action_joints:
                raise unknown("locked joint", name, robot.action_joints)
        self.locked: Array = np.isin(robot.action_joints, config.locked)  # (n_u,) bool
        self.speeds: Array = (
            robot.speeds(private=config.speed, shared=config.shared_speed) * ~self.locked
        )  # (n_u,) rad/s at action 1
        self.view = state_view(robot, self.limits, spheres=self.n_spheres, config=config)
        if "nearness" in self.view.places:
            self._links = self._sensors([link_sensor(arm.name) for arm in robot.arms])
        if robot.soles:
            self._com = self._sensors(["com"])
            self._upright = self._sensors(["upright"])
            self._corners = self._sensors(
                [sole_corner(sole, i) for sole in robot.soles for i in range(4)]
            )
        if config.balance == "com+zmp" and robot.soles:
            self._com_velocity = self._sensors(["com_velocity"])

    def _sensors(self, names: list[str]) -> Array:
        """Addresses of three-dimensional sensors, (len(names), 3)."""
        return np.array([self.model.sensor(name).adr[0] + np.arange(3) for name in names])

    def palms(self, sensors: Array) -> Array:
        """Palm positions, (n, k, 3) [m]."""
        return np.asarray(sensors[:, self._palms])

    def goals(self, mocap_pos: Array) -> Array:
        """Goal positions, (n, k, 3) [m]."""
        return np.asarray(mocap_pos[:, self._goals])

    def com_velocity(self, sensors: Array) -> Array:
        """Velocity of the centre of mass, (n, 3) [m/s].

        Zero unless the zero-moment point is watched.
        """
        return (
            np.asarray(sensors[:, self._com_velocity[0]])
            if hasattr(self, "_com_velocity")
            else np.zeros((len(sensors), 3))
        )

    def target(self, before: Array, velocity: Array) -> Array:
        """Servo targets one control period later: action joints move at `velocity` (of their
        speed), within their ranges, (n, n_u).
        """
        moved = before[:, self.servos] + velocity * self.speeds * self.config.control_period
        after = before.copy()
        after[:, self.servos] = np.clip(moved, self.limits[:, 0], self.limits[:, 1])
        return after

    def instability(self, sensors: Array, acceleration: Array) -> Array:
        """Falling: the centre of mass (and the zero-moment point, if watched) not over the shrunk
        feet, or the torso tipped, (n,).
        """
        if not self.robot.soles:
            return np.zeros(len(sensors), dtype=bool)
        com, corners = sensors[:, self._com[0]], sensors[:, self._corners]
        margin = balance.support_margin(com[:, :2], corners)
        if self.config.balance == "com+zmp":
            margin = np.minimum(
                margin,
                balance.support_margin(balance.zero_moment_point(com, acceleration), corners),
            )
        tipped = sensors[:, self._upright[0, 2]] < np.cos(self.config.tilt)
        return np.asarray((margin < self.config.balance_margin) | tipped)

    def state(
        self, qpos: Array, qvel: Array, sensors: Array, mocap_pos: Array, radii: Array
    ) -> Array:
        """The policy's state, (n, n_x) float32 (tasks/reach/observation.py).

        `radii` (n, n_spheres) [m].
        """
        palms, goals = self.palms(sensors), self.goals(mocap_pos)
        n = len(qpos)
        parts: dict[str, Any] = {
            "angles": qpos[:, self.qpos_index],
            "palms": palms.reshape(n, -1),
            "goals": goals.reshape(n, -1),
        }
        if self.n_spheres:
            spheres = np.concatenate([mocap_pos[:, self.sphere_mocaps], radii[:, :, None]], axis=2)
            parts["spheres"] = spheres.reshape(n, -1)
        if "difference" in self.view.places:
            parts["difference"] = (goals - palms).reshape(n, -1)
        if "com" in self.view.places:
            parts["com"] = sensors[:, self._com[0, :2]]
        if "nearness" in self.view.places:
            parts["nearness"] = nearness(sensors[:, self._links], palms, spheres).reshape(n, -1)
        if "velocity" in self.view.places:
            parts["velocity"] = qvel[:, self.qvel_index]
        return self.view.scaled(parts)
