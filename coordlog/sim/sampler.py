"""Problems from seeds: where the goals and spheres are and how the robot stands, every draw
verified feasible.

Episode i of a seed is the same problem however many simulations run beside it. `train` and `test`
use disjoint random streams.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from coordlog.episode import Array
from coordlog.errors import SimulationError, unknown
from coordlog.kinematics.ik import Reach
from coordlog.tasks.config import EnvConfig
from coordlog.tasks.scene import Box3, Scene

SPLITS = {"train": 0, "test": 1}
ATTEMPTS = 200
"""Draws after which a scene is given up of which none has been feasible."""
PATIENCE = 50
"""This many times as many draws are made where others of the scene's have been feasible."""
CLEARANCE = 0.02
"""Obstacles keep this far [m] from the start pose, and spheres leave this much room around a goal
beyond the palm's own size."""
FEASIBLE = "feasible"
PALM_RADIUS = 0.02
MIDDLE = 0.35
"""Goals that are a random posture's palms: the share of every joint's range, around its middle,
that the posture is drawn from. Over the whole range most postures are only reached by way of
others."""


@dataclass(frozen=True, eq=False)
class Branch:
    """Where another episode is left: its first actions lead there, and an episode of its own
    begins.
    """

    parent: str
    """What it is left of, by its digest."""
    actions: Array  # (t, n_u) float32
    state: Array  # (n_x,) float32, where they lead


@dataclass(frozen=True, eq=False)
class Problem:
    """One drawn episode: goals, obstacles and start angles."""

    seed: int
    split: str
    index: int
    goals: Array  # (k, 3) m
    centre: Array | None  # (3,) of the object, m
    spheres: Array  # (n_spheres, 4): x, y, z, radius, m
    angles: Array  # (n_u,) start angles of the action joints, rad
    branch: Branch | None = None
    """Where the episode begins, if not at its own beginning."""


class Draw:
    """Draws the problems of one scene; owns the kinematic model that verifies them."""

    def __init__(
        self,
        scene: Scene,
        model: mujoco.MjModel,
        config: EnvConfig,
        *,
        standing: Array,
        resting: Sequence[tuple[int, int]] = (),
    ) -> None:
        """Copy what is needed to verify draws.

        Args:
            scene: What to draw for.
            model: The scene's compiled model.
            config: Start noise and balance margin.
            standing: qpos of the settled start pose, shape (n_q,).
            resting: Pairs of geoms that lie against one another and never count as touching.
        """
        self._scene, self._config, self._model = scene, config, model
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
            angles = self._start(rng)
            spheres = self._spheres(rng)
            goals, centre = self._goals(rng)
            why_not = self._infeasible(goals, spheres, angles)
            self.tally[why_not or FEASIBLE] += 1
            if not why_not:
                return Problem(seed, split, index, goals, centre, spheres, angles)
        raise SimulationError(
            f"scene '{self._scene.name}': no feasible problem in {attempt} draws (seed {seed}, episode {index}): {self.reasons()}"
        )

    def reasons(self) -> str:
        """Why draws have not been feasible, the commonest first."""
        count = Counter({why: n for why, n in self.tally.items() if why != FEASIBLE})
        total = sum(self.tally.values())
        said = [f"{why} ({n} of {total})" for why, n in count.most_common(4)]
        return "; ".join(said) or "all were feasible"

    def _start(self, rng: np.random.Generator) -> Array:
        noise = rng.uniform(-1.0, 1.0, len(self.reach.limits)) * self._config.start_noise
        return np.clip(
            self.reach.standing_angles + noise, self.reach.limits[:, 0], self.reach.limits[:, 1]
        )

    def _spheres(self, rng: np.random.Generator) -> Array:
        count, box = self._scene.spheres, self._scene.sphere_box
        if not count or box is None:
            return np.zeros((0, 4))
        low, high = self._scene.sphere_radius
        return np.stack(
            [np.append(_inside(rng, box), rng.uniform(low, high)) for _ in range(count)]
        )

    def _goals(self, rng: np.random.Generator) -> tuple[Array, Array | None]:
        if (
            self._scene.object_box is None
        ):  # a goal of its own for every arm: where a random posture puts the palms
            middle, half = self.reach.limits.mean(axis=1), np.ptp(self.reach.limits, axis=1) / 2
            return self.reach.palms(
                rng.uniform(middle - MIDDLE * half, middle + MIDDLE * half)
            ), None
        centre = _inside(rng, self._scene.object_box)
        sides = np.array([self._scene.palm_offset, -self._scene.palm_offset])
        return np.stack([centre + np.array([0.0, side, 0.0]) for side in sides]), centre

    def _infeasible(self, goals: Array, spheres: Array, angles: Array) -> str:
        """Why a draw cannot be solved; empty if it can."""
        for sphere in spheres:
            if (
                np.linalg.norm(goals - sphere[:3], axis=1) < sphere[3] + PALM_RADIUS + CLEARANCE
            ).any():
                return "a goal lies inside or beside a sphere"
        self.reach.place(spheres)
        if self.reach.touches(angles, clearance=CLEARANCE):
            one, other = (self._model.geom(geom).name or f"geom {geom}" for geom in self.reach.met)
            return f"the start pose touches: {one} and {other}, or an obstacle is within {CLEARANCE * 100:g} cm of it"
        # Goals that were drawn as a posture's palms are reachable as drawn.
        if self._scene.object_box is None or self.reach.solve(goals) is not None:
            return ""
        if any(self.reach.descend(goals, seed) is not None for seed in self.reach.seeds):
            return "the goals are reached by no posture that touches nothing and keeps its balance"
        return "the goals are out of reach"


def _inside(rng: np.random.Generator, box: Box3) -> Array:
    low, high = np.array(box).T
    return np.asarray(rng.uniform(low, high))
