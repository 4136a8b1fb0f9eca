"""Problems from seeds: where the goals and spheres are and how the robot stands, every draw
verified feasible.

Episode i of a seed is the same problem however many simulations run beside it. `train` and `test`
use disjoint random streams.
"""

from __future__ import annotations

import mujoco
import numpy as np

from coordlog.contracts import Problem, Sample, Task
from coordlog.episode import Array
from coordlog.errors import SimulationError, unknown
from coordlog.kinematics.ik import Reach
from coordlog.tasks.config import EnvConfig
from coordlog.tasks.goals import inside
from coordlog.tasks.scene import Scene

SPLITS = {"train": 0, "test": 1}
ATTEMPTS = 200
CLEARANCE = 0.02
"""Obstacles keep this far [m] from the start pose, and spheres leave this much room around a goal
beyond the palm's own size."""
PALM_RADIUS = 0.02
POSTURES = 100
"""Random postures that are looked at before a start is left where it was."""
SPREAD = 4.0
"""Starts on the line between two poses are spread this many times further than those in a pose."""
SHARED = 0.3
"""Share of their way that shared joints of a robot on feet go towards a random posture: the spine
carries half the mass."""
TIGHT = 0.005
"""Obstacles keep this far [m] from starts near postures that reach: goals are close to what holds
them."""


class Draw:
    """Draws the problems of one scene; owns the kinematic model that verifies them."""

    def __init__(
        self,
        scene: Scene,
        task: Task,
        model: mujoco.MjModel,
        config: EnvConfig,
        *,
        standing: Array,
        start: str = "stand",
    ) -> None:
        """Copy what is needed to verify draws.

        Args:
            scene: What to draw for.
            task: Draws the goals.
            model: The scene's compiled model.
            config: Start noise and balance margin.
            standing: qpos of the settled start pose, shape (n_q,).
            start: Name of that pose.
        """
        self._scene, self._task, self._config = scene, task, config
        self.reach = Reach(
            scene.robot, model, margin=config.balance_margin, tilt=config.tilt, standing=standing
        )
        robot = scene.robot
        self._poses = [
            self.reach.angles_of(robot, pose)
            for pose in robot.poses
            if pose not in ("neutral", start)
        ]
        self._freedom = np.array(
            [
                SHARED if name in robot.shared and robot.soles else 1.0
                for name in robot.action_joints
            ]
        )

    def problem(self, *, seed: int, split: str, index: int) -> Problem:
        """The problem of one episode.

        Raises:
            ConfigError: for an unknown split.
            SimulationError: if no feasible problem is found; the scene asks too much.
        """
        if split not in SPLITS:
            raise unknown("split", split, SPLITS)
        rng = np.random.default_rng([seed, SPLITS[split], index])
        for _ in range(ATTEMPTS):
            angles = self._start(rng, split)
            spheres = self._spheres(rng)
            self.reach.place(spheres)
            sample = self._task.sample(rng, self._scene, self.reach, angles)
            if sample is not None and self._feasible(sample, spheres, angles):
                if (
                    sample.track is None  # goals that move start where the palms are
                    and split == "train"
                    and self._config.start_solved > 0
                    and rng.random() < self._config.start_solved
                ):
                    angles = self._solved(rng, angles)
                return Problem(
                    seed,
                    split,
                    index,
                    sample.goals,
                    sample.centre,
                    spheres,
                    angles,
                    track=sample.track,
                )
        raise SimulationError(
            f"scene '{self._scene.name}': no feasible problem in {ATTEMPTS} draws (seed {seed}, episode {index})"
        )

    def _start(self, rng: np.random.Generator, split: str) -> Array:
        """The start pose and noise; of the split "train", a share elsewhere."""
        config, (low, high) = self._config, self.reach.limits.T
        noise = rng.uniform(-1.0, 1.0, len(low)) * config.start_noise
        standing = self.reach.standing_angles
        elsewhere = config.start_line + config.start_random if split == "train" else 0.0
        kind = rng.random() if elsewhere > 0 else 1.0
        if kind < config.start_line and self._poses:
            pose = self._poses[rng.integers(len(self._poses))]
            return np.clip(standing + rng.random() * (pose - standing) + SPREAD * noise, low, high)
        if config.start_line <= kind < elsewhere:
            for _ in range(POSTURES):
                angles = standing + rng.random() * self._freedom * (
                    rng.uniform(low, high) - standing
                )
                if self.reach.legal(angles, clearance=CLEARANCE):
                    return np.asarray(angles)
        return np.clip(standing + noise, low, high)

    def _solved(self, rng: np.random.Generator, otherwise: Array) -> Array:
        """A legal posture around one that reaches goals of another draw: a way back from where
        others end (Florensa et al. 2017).
        """
        low, high = self.reach.limits.T
        other = self._task.sample(rng, self._scene, self.reach, otherwise)
        there = None if other is None else self.reach.solve(other.goals)
        if there is None:
            return otherwise
        for _ in range(POSTURES):
            angles = np.clip(
                there + rng.random() ** 2 * self._freedom * (rng.uniform(low, high) - there),
                low,
                high,
            )
            if self.reach.legal(angles, clearance=TIGHT):
                return np.asarray(angles)
        return otherwise

    def _spheres(self, rng: np.random.Generator) -> Array:
        count, box = self._scene.spheres, self._scene.sphere_box
        if not count or box is None:
            return np.zeros((0, 4))
        low, high = self._scene.sphere_radius
        return np.stack([np.append(inside(rng, box), rng.uniform(low, high)) for _ in range(count)])

    def _feasible(self, sample: Sample, spheres: Array, angles: Array) -> bool:
        goals = sample.goals
        for sphere in spheres:
            if (
                np.linalg.norm(goals - sphere[:3], axis=1) < sphere[3] + PALM_RADIUS + CLEARANCE
            ).any():
                return False
        if self.reach.touches(angles, clearance=CLEARANCE):
            return False
        return sample.reachable or self.reach.solve(goals) is not None
