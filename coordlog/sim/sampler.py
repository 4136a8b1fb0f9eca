"""Problems from seeds: where the goals and spheres are and how the robot stands, every draw
verified feasible.

Episode i of a seed is the same problem however many simulations run beside it. `train` and `test`
use disjoint random streams.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

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
"""Draws after which a scene is given up of which none has been feasible."""
PATIENCE = 50
"""This many times as many draws are made where others of the scene's have been feasible."""
FEASIBLE = "feasible"
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
FAR_BELOW = -10.0
"""Height at which spheres are out of the way [m]: a start is drawn before they are."""
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
        resting: Sequence[tuple[int, int]] = (),
    ) -> None:
        """Copy what is needed to verify draws.

        Args:
            scene: What to draw for.
            task: Draws the goals.
            model: The scene's compiled model.
            config: Start noise and balance margin.
            standing: qpos of the settled start pose, shape (n_q,).
            start: Name of that pose.
            resting: Pairs of geoms that lie against one another and never count as touching.
        """
        self._scene, self._task, self._config, self._model = scene, task, config, model
        self.tally: Counter[str] = Counter()
        """How often a draw was feasible (FEASIBLE), and why the others were not."""
        self.reach = Reach(
            scene.robot,
            model,
            margin=config.balance_margin,
            tilt=config.tilt,
            standing=standing,
            resting=resting,
        )
        self._away = np.tile([0.0, 0.0, FAR_BELOW, scene.sphere_radius[0]], (scene.spheres, 1))
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
        for attempt in range(ATTEMPTS * PATIENCE):
            if attempt >= ATTEMPTS and not self.tally[FEASIBLE]:
                break
            angles = self._start(rng, split)
            spheres = self._spheres(rng)
            self.reach.place(spheres)
            sample = self._task.sample(rng, self._scene, self.reach, angles)
            why_not = self._infeasible(sample, spheres, angles)
            self.tally[why_not or FEASIBLE] += 1
            if sample is None or why_not:
                continue
            if (
                sample.track is None  # goals that move start where the palms are
                and split == "train"
                and self._config.start_solved > 0
                and rng.random() < self._config.start_solved
            ):
                angles = self._solved(rng, angles)
            drawn = (sample.goals, sample.centre, spheres, angles)
            return Problem(seed, split, index, *drawn, track=sample.track)
        raise SimulationError(
            f"scene '{self._scene.name}': no feasible problem in {attempt} draws (seed {seed}, "
            f"episode {index}): {self.reasons()}"
        )

    def reasons(self) -> str:
        """Why draws have not been feasible, the commonest first."""
        count = Counter({why: n for why, n in self.tally.items() if why != FEASIBLE})
        total = sum(self.tally.values())
        said = [f"{why} ({n} of {total})" for why, n in count.most_common(4)]
        return "; ".join(said) or "all were feasible"

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
            self.reach.place(self._away)
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

    def _infeasible(self, sample: Sample | None, spheres: Array, angles: Array) -> str:
        """Why a draw cannot be solved; empty if it can."""
        if sample is None:
            return "the task finds no goals from its start posture"
        goals = sample.goals
        for sphere in spheres:
            if (
                np.linalg.norm(goals - sphere[:3], axis=1) < sphere[3] + PALM_RADIUS + CLEARANCE
            ).any():
                return "a goal lies inside or beside a sphere"
        if self.reach.touches(angles, clearance=CLEARANCE):
            one, other = (self._model.geom(geom).name or f"geom {geom}" for geom in self.reach.met)
            return (
                f"the start pose touches: {one} and {other}, or an obstacle is within "
                f"{CLEARANCE * 100:g} cm of it"
            )
        if sample.reachable or self.reach.solve(goals) is not None:
            return ""
        if any(self.reach.descend(goals, seed) is not None for seed in self.reach.seeds):
            return "the goals are reached by no posture that touches nothing and keeps its balance"
        return "the goals are out of reach"
