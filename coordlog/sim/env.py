"""N live episodes of one scene: problems from seeds in, flags and rewards out."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from coordlog.config import build, plain
from coordlog.contracts import Branch, Outcome, Problem
from coordlog.episode import INITIAL_STATE, Array, Json
from coordlog.errors import ConfigError, SimulationError, unknown
from coordlog.mjcf import (
    Looks,
    actuator_label,
    compile_model,
    compose,
    pack_source,
    robot_looks,
    with_radii,
)
from coordlog.sim.physics import Physics
from coordlog.sim.sampler import Draw
from coordlog.sim.settling import faults, settle
from coordlog.sim.simulation import Simulation
from coordlog.sim.task import BoundTask
from coordlog.spec import Field, Layout
from coordlog.tasks.config import EnvConfig, RewardConfig
from coordlog.tasks.registry import make_task, task_class
from coordlog.tasks.scene import Scene
from coordlog.version import __version__

SAME = 0.01
"""How far a branch may begin from where it was left, in entries of the state: nothing on the
machine that recorded it."""


class BatchEnv:
    """N simulations of one scene on one thread pool.

    The same seed, split and index is the same problem and, action for action, the same episode, bit
    for bit, whatever N and the number of threads are.
    """

    def __init__(
        self,
        scene: Scene,
        config: EnvConfig | None = None,
        reward: RewardConfig | None = None,
        *,
        n: int = 1,
        threads: int = 0,
        start: str = "stand",
        task: Mapping[str, Any] | None = None,
    ) -> None:
        """Compile the scene and let the robot come to rest in its start pose.

        Args:
            scene: What to simulate.
            config: Control, endings, balance and state.
            reward: Constants of the reward.
            n: Number of simulations.
            threads: Threads to step on; 0 for all cores.
            start: Name of the robot's start pose.
            task: Constants of the scene's task that are its own, by name.

        Raises:
            ConfigError: for a pose, period or name that does not fit the robot's model, a file it
                lacks, or a pose it does not hold.
            SimulationError: if it does not compile.
        """
        config, reward = config or default_config(scene), reward or RewardConfig()
        if start not in scene.robot.poses:
            raise unknown("start pose", start, scene.robot.poses)
        self.scene, self.start = scene, start
        self.source = compose(scene, config)
        model = compile_model(self.source)
        rules = make_task(scene.task, config, reward, task)
        self.task = BoundTask(rules, scene.robot, model, config, reward)
        rest = settle(scene.robot, model, start)
        wrong = faults(scene.robot, model, start, rest)
        if wrong:
            raise ConfigError(f"robot '{scene.robot.name}': {'; '.join(wrong)}")
        self.resting = rest.resting
        """Pairs of geoms that lie against one another in the start pose and that no action moves
        apart: their contacts are none."""
        self.physics = Physics(model, n=n, threads=threads, resting=self.resting)
        self.simulation = Simulation(self.task, self.physics, n=n)
        self._rest = rest.row
        standing = self._rest[1 : 1 + model.nq]
        self.draw = Draw(
            scene, rules, model, config, standing=standing, resting=self.resting, start=start
        )
        self._packed: dict[str, bytes] = {}
        self._object = (
            int(model.body("object").mocapid[0]) if scene.object_half is not None else None
        )

    @property
    def n(self) -> int:
        """Number of simulations."""
        return self.simulation.n

    @property
    def state(self) -> Array:
        """Present policy state of every simulation, (N, n_x) float32."""
        return self.simulation.state

    @property
    def fields(self) -> tuple[Field, ...]:
        """What the task logs of its own."""
        return self.task.fields

    def present(self, ids: Array) -> dict[str, Array]:
        """Every field that holds before an action, the core's and the task's, (len(ids), …)."""
        return self.simulation.present(ids)

    def problem(self, *, seed: int, split: str, index: int) -> Problem:
        """The problem of one episode (sim/sampler.py)."""
        return self.draw.problem(seed=seed, split=split, index=index)

    def reset(self, ids: Array, problems: Sequence[Problem]) -> None:
        """Start an episode in each of the simulations `ids`.

        Raises:
            SimulationError: if the actions of a branch do not lead to where they did.
        """
        physics, task = self.physics, self.task
        physics.rows[ids] = self._rest
        for sim, problem in zip(ids, problems, strict=True):
            physics.qpos[sim, task.qpos_index] = problem.angles
            physics.ctrl[sim, task.servos] = problem.angles
            physics.mocap_pos[sim, task.goal_mocaps] = problem.goals
            if self._object is not None:
                physics.mocap_pos[sim, self._object] = problem.centre
            if task.n_spheres:
                physics.mocap_pos[sim, task.sphere_mocaps] = problem.spheres[:, :3]
        radii = np.array([problem.spheres[:, 3] for problem in problems]) + task.config.inflate
        if task.n_spheres:
            physics.resize(ids, task.sphere_geoms, radii)
        self.simulation.begin(ids, radii, [problem.track for problem in problems])
        branched = [
            (int(sim), problem, problem.branch)
            for sim, problem in zip(ids, problems, strict=True)
            if problem.branch is not None
        ]
        for sim, problem, branch in branched:
            self._follow(sim, problem, branch)

    def _follow(self, sim: int, problem: Problem, branch: Branch) -> None:
        """Do what led to a branch, and begin there."""
        at = np.array([sim])
        for action in branch.actions:
            self.simulation.step(action[None], at)
        away = float(np.abs(self.simulation.state[sim] - branch.state).max())
        if not away <= SAME:
            raise SimulationError(
                f"episode {branch.parent[:12]}: its first {len(branch.actions)} actions do not "
                "lead here to where they led when it was "
                f"recorded (the state differs by {away:.2g}): expected the same environment and "
                "the same MuJoCo"
            )
        self.physics.rows[sim, 0] = 0.0  # time
        track = None if problem.track is None else problem.track[len(branch.actions) :]
        self.simulation.begin(at, self.simulation.radii[at], [track])

    def step(self, action: Array, ids: Array) -> Outcome:
        """Advance simulations `ids` by one control period.

        Actions (len(ids), n_u) float32 in [-1, 1].
        """
        return self.simulation.step(action, ids)

    def attachments(self, sim: int) -> dict[str, bytes]:
        """What a file needs so that it alone can be simulated again: one simulation's model and its
        state.

        Read right after `reset`. Compiling the text, which has the episode's own spheres, gives the
        model the simulation runs on.
        """
        state = self.physics.rows[sim].tobytes()
        return {**self._model_attachments(sim), INITIAL_STATE: state}

    def _model_attachments(self, sim: int) -> dict[str, bytes]:
        radii = tuple(float(radius) for radius in self.simulation.radii[sim])
        if not radii and self._packed:
            return self._packed
        source = with_radii(self.source, radii) if radii else self.source
        self._packed = {**pack_source(source), **self.looks.attached}
        return self._packed

    @cached_property
    def looks(self) -> Looks:
        """What its robot wears in pictures."""
        return robot_looks(self.scene.robot)

    @property
    def layout(self) -> Layout:
        """The lengths that give every logged field its shape."""
        model = self.task.model
        return Layout(
            n_q=model.nq,
            n_v=model.nv,
            n_x=len(self.task.view),
            n_u=len(self.task.servos),
            k=len(self.scene.robot.arms),
            n_c=model.nu,
        )

    def describe(self) -> Json:
        """The `coordlog.env` record of every episode of this environment (`episode.Header.env`)."""
        model, robot = self.task.model, self.scene.robot
        return {
            "coordlog_version": __version__,
            "mujoco_version": mujoco.__version__,
            "architecture": platform.machine(),
            "robot": robot.to_json(),
            "config": plain(self.task.config),
            "reward": plain(self.task.reward),
            "task": self.task.rules.to_json(),
            "joints": hinges(model),
            "actuators": [actuator_label(model, i) for i in range(model.nu)],
            "geoms": [model.geom(i).name for i in range(model.ngeom)],
            "resting": [list(pair) for pair in self.resting],
            "arms": robot.served,
            "action_joints": list(robot.action_joints),
            "layout": asdict(self.layout),
            **self.task.view.to_json(),
        }


def default_config(scene: Scene) -> EnvConfig:
    """The environment's constants in a scene, where nobody says otherwise: its task's."""
    return build(EnvConfig, task_class(scene.task)[0].defaults)


def hinges(model: mujoco.MjModel) -> list[Json]:
    """Name and addresses of every joint of one degree of freedom, in model order."""
    # MuJoCo's enumerators equal plain ints only: an np.int32 is never `in` a tuple of them.
    kinds = [int(kind) for kind in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)]
    joints = (model.joint(int(i)) for i in np.flatnonzero(np.isin(model.jnt_type, kinds)))
    return [
        {"name": joint.name, "qpos": int(joint.qposadr[0]), "qvel": int(joint.dofadr[0])}
        for joint in joints
    ]
