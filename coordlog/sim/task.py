"""A task bound to one compiled model: where in MuJoCo's arrays everything stands that it reads.

It is bound by name alone, so a live scene and the model attached to a log give the same numbers.
"""

from __future__ import annotations

import mujoco
import numpy as np

from coordlog.contracts import Reading, Task
from coordlog.episode import Array
from coordlog.errors import ConfigError, unknown
from coordlog.kinematics import balance
from coordlog.mjcf.servos import require_servos
from coordlog.robots.robot import Robot
from coordlog.spec import Field
from coordlog.tasks.config import EnvConfig, RewardConfig
from coordlog.tasks.scene import goal_body, link_sensor, palm_sensor, sole_corner, sphere_geom


class BoundTask:
    """A task for one robot in one compiled model; holds indices and constants, never a state.

    Example:
        >>> bound = env.task                                    # doctest: +SKIP
        >>> bound.rules.name, bound.limits.shape                # doctest: +SKIP
        ('reach', (13, 2))
    """

    def __init__(
        self,
        rules: Task,
        robot: Robot,
        model: mujoco.MjModel,
        config: EnvConfig,
        reward: RewardConfig,
    ) -> None:
        """Look up every name once.

        Args:
            rules: The task.
            robot: Names.
            model: Robot and scene, compiled.
            config: Control, balance.
            reward: Constants of the reward, for whoever asks for them.

        Raises:
            ConfigError: if the model lacks a joint, servo, site or body that the spec names.
        """
        self.rules, self.robot, self.model = rules, robot, model
        self.config, self.reward = config, reward
        try:
            joints = [model.joint(name) for name in robot.action_joints]
            servos = require_servos(model, robot)
            self._goals = [int(model.body(goal_body(arm.name)).mocapid[0]) for arm in robot.arms]
            self._palms = self._sensors([palm_sensor(arm.name) for arm in robot.arms])
        except KeyError as error:
            raise ConfigError(
                f"robot '{robot.name}': its spec names something its model lacks: "
                f"{str(error).splitlines()[0]}"
            ) from error
        self.n_spheres = 0
        while mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, sphere_geom(self.n_spheres)) >= 0:
            self.n_spheres += 1
        spheres = range(self.n_spheres)
        self.sphere_geoms = [model.geom(sphere_geom(i)).id for i in spheres]
        self.sphere_mocaps = [int(model.body(sphere_geom(i)).mocapid[0]) for i in spheres]
        self.goal_mocaps = self._goals
        self.substeps = config.substeps(model.opt.timestep)
        self.qpos_index: Array = np.array([joint.qposadr[0] for joint in joints])
        self.qvel_index: Array = np.array([joint.dofadr[0] for joint in joints])
        self.servos: Array = np.array(servos)
        self.limits: Array = np.array([joint.range for joint in joints])  # (n_u, 2) rad
        for name, (low, high) in zip(robot.action_joints, self.limits, strict=True):
            if not low < high:
                raise ConfigError(
                    f"robot '{robot.name}': expected a range for joint '{name}', which the action "
                    "moves; its model has none"
                )
        for name in config.locked:
            if name not in robot.action_joints:
                raise unknown("locked joint", name, robot.action_joints)
        self.locked: Array = np.isin(robot.action_joints, config.locked)  # (n_u,) bool
        self.speeds: Array = (
            robot.speeds(private=config.speed, shared=config.shared_speed) * ~self.locked
        )  # (n_u,) rad/s at action 1
        self.view = rules.view(robot, self.limits, spheres=self.n_spheres)
        self._bind_sensors()

    def _bind_sensors(self) -> None:
        robot = self.robot
        self._links: Array | None = None
        if "nearness" in self.view.places:
            self._links = self._sensors([link_sensor(arm.name) for arm in robot.arms])
        if robot.soles:
            self._com = self._sensors(["com"])
            self._upright = self._sensors(["upright"])
            self._corners = self._sensors(self._corner_names())
        self._com_velocity: Array | None = None
        if self.config.balance == "com+zmp" and robot.soles:
            self._com_velocity = self._sensors(["com_velocity"])

    def _corner_names(self) -> list[str]:
        """The corners of all soles; of those that coincide, as under a sphere, the first: the
        support polygon is the same, and costs the cube of their number.
        """
        names = [sole_corner(sole, i) for sole in self.robot.soles for i in range(4)]
        apart: dict[tuple[int, bytes], str] = {}
        for name in names:
            site = self.model.site(name)
            apart.setdefault((int(site.bodyid[0]), site.pos.tobytes()), name)
        return [*apart.values()] if len(apart) > 2 else names

    def _sensors(self, names: list[str]) -> Array:
        """Addresses of three-dimensional sensors, (len(names), 3)."""
        return np.array([self.model.sensor(name).adr[0] + np.arange(3) for name in names])

    @property
    def name(self) -> str:
        """The task's."""
        return self.rules.name

    @property
    def fields(self) -> tuple[Field, ...]:
        """What the task logs of its own."""
        return self.rules.fields

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
        if self._com_velocity is None:
            return np.zeros((len(sensors), 3))
        return np.asarray(sensors[:, self._com_velocity[0]])

    def filtered(self, velocity: Array, action: Array) -> Array:
        """The velocity command v ← c v + (1 - c) a that servo targets move at, (n, n_u)."""
        smoothing = self.config.smoothing
        return np.asarray(smoothing * velocity + (1.0 - smoothing) * action.astype(np.float64))

    def target(self, before: Array, velocity: Array) -> Array:
        """Servo targets one control period later: action joints move at `velocity` (of their
        speed), within their ranges, (n, n_c).
        """
        moved = before[:, self.servos] + velocity * self.speeds * self.config.control_period
        after = before.copy()
        after[:, self.servos] = np.clip(moved, self.limits[:, 0], self.limits[:, 1])
        return after

    def action_to(self, target: Array, before: Array, velocity: Array) -> Array:
        """The action that brings the action joints' servo targets from `before` to `target`, (n_u,)
        [rad], in one control period, or as near as an action can, (n_u,) float32.

        Args:
            target: Where they are to be.
            before: Where they are.
            velocity: The velocity command so far, (n_u,).
        """
        step = self.speeds * self.config.control_period
        wanted = np.divide(
            target - before, step, out=np.zeros(len(step)), where=step > 0
        )  # a locked joint stays
        smoothing = self.config.smoothing
        action = (wanted - smoothing * velocity) / (1.0 - smoothing)
        return np.asarray(np.clip(action, -1.0, 1.0).astype(np.float32))

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

    def reading(
        self, qpos: Array, qvel: Array, sensors: Array, mocap_pos: Array, radii: Array
    ) -> Reading:
        """What the task is told of n states.

        `radii` (n, n_spheres) are those of the spheres as the policy is told of them [m].
        """
        spheres = np.concatenate([mocap_pos[:, self.sphere_mocaps], radii[:, :, None]], axis=2)
        return Reading(
            angles=qpos[:, self.qpos_index],
            velocities=qvel[:, self.qvel_index],
            palms=self.palms(sensors),
            goals=self.goals(mocap_pos),
            spheres=spheres,
            links=None if self._links is None else sensors[:, self._links],
            com=sensors[:, self._com[0, :2]] if self.robot.soles else None,
        )

    def state(self, reading: Reading) -> Array:
        """The policy's state, (n, n_x) float32."""
        return self.view.scaled(self.rules.parts(reading, self.view))
