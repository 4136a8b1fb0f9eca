"""The scripted expert: arms out to the sides with elbows flexed, in front, then all palms to their
goals by inverse kinematics.

It sees what any policy sees, the state, and acts in [-1, 1]. At the start of an episode it tries a
few ways through the joint space and takes the first that touches nothing; under way it follows
straight joint lines with feedback, and near the end corrects the palms for the sway of a robot that
stands on its own feet. Goals that move are followed from where it arrives.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np

from coordlog.episode import Array
from coordlog.errors import ConfigError
from coordlog.kinematics.ik import Reach
from coordlog.policies.avoidance import DamperConfig, farthest, require_positive, turned
from coordlog.policies.ways import found_ways, known_ways, postures
from coordlog.sim.task import BoundTask


@dataclass(frozen=True)
class ExpertConfig:
    """Constants of the expert; the table [policy] of a configuration file, logged with every
    episode it acts in.

    Example:
        >>> ExpertConfig(gain_steps=6.0).arrived
        0.15
    """

    gain_steps: float = 4.0
    """An error is meant to be gone after this many steps at the speed it asks for. Fewer would
    overshoot behind the command filter."""
    arrived: float = 0.15
    """A way point is passed within this distance of every joint [rad]."""
    near: float = 0.06
    """Palm correction starts within this distance of the last way point [rad]."""
    correction: float = 0.15
    """Share of the palm error that the last way point takes up per step."""
    clearances: tuple[float, ...] = (0.03, 0.02, 0.01, 0.0)
    """Clearances that a way is tried with, the first that fits [m]."""
    own: tuple[float, ...] = (0.015, 0.0)
    """Clearances of last links and fingers from the robot itself that a way is tried with where the
    robot's ways are not known beforehand [m]."""
    sliding: tuple[float, ...] = (0.015, 0.0)
    """Clearances that a way past spheres is tried with, from other links than those that slide and
    from the robot itself [m]."""
    there: float = 0.02
    """Such a way arrives where every palm is this close to its goal [m]."""
    progress: float = 0.005
    """A way point is passed by if for `patience` steps its error has not shrunk by this much [rad]:
    a sphere is in its place."""
    patience: int = 10
    """Steps."""
    rollout: int = 130
    """Steps that a way may take."""
    restarts: int = 60
    """Random postures to search from when no known one leads to the goals."""
    tries: int = 60
    """Random changes to the via poses when no known way is free."""
    spread: float = 0.35
    """Their standard deviation [rad]."""

    def __post_init__(self) -> None:
        require_positive(self, besides=("correction", "restarts", "tries", "spread"))
        for name in ("clearances", "own"):
            if not getattr(self, name):
                raise ConfigError(f"{name}: expected at least one, got none")


@dataclass
class Plan:
    """What one slot is doing: way points in joint space, the last one on the goals."""

    points: list[Array]
    goals: Array
    bias: Array
    held: Array | None
    """Angles of locked joints, NaN for the others; None where all move."""
    spheres: Array
    at: int = 0
    least: float = np.inf
    """Least error to the present way point so far [rad]."""
    stuck: int = 0
    """Steps since it last became less."""


class Expert:
    """Plans at the start of an episode, then follows."""

    def __init__(
        self,
        task: BoundTask,
        reach: Reach,
        n: int,
        *,
        config: ExpertConfig | None = None,
        damper: DamperConfig | None = None,
    ) -> None:
        """Prepare the known ways through the joint space.

        Args:
            task: View of the state, joint speeds and limits.
            reach: Kinematics of the scene; the expert moves its spheres about.
            n: Number of slots.
            config: Its constants.
            damper: Those of sliding past spheres.
        """
        self._task, self._reach = task, reach
        self._config, self._damper = config or ExpertConfig(), damper or DamperConfig()
        self._plans: list[Plan | None] = [None] * n
        self._moves = ~task.locked  # (n_u,) bool
        self._step = np.where(
            self._moves, task.speeds * task.config.control_period, 1.0
        )  # (n_u,) rad per step at action 1
        self._ways = known_ways(task)
        self._own: tuple[float, ...] = (0.0,)
        self._seeds = [way[-1] for way in self._ways if way] or postures(reach)
        if not self._ways:
            self._own = self._config.own
            self._ways = found_ways(task, reach, self._seeds, own=self._own[0])

    def begin(self, ids: Array, state: Array, rngs: list[np.random.Generator]) -> None:
        """Plan a way for each slot."""
        view = self._task.view
        angles, goals = view.physical(state, "angles"), view.physical(state, "goals")
        palms = view.physical(state, "palms")
        spheres = (
            view.physical(state, "spheres") if self._task.n_spheres else np.zeros((len(ids), 0))
        )
        every = zip(ids, angles, palms, goals, spheres, rngs, strict=True)
        for slot, start, hands, goal, obstacle, rng in every:
            targets, around = np.asarray(goal.reshape(-1, 3)), obstacle.reshape(-1, 4)
            self._reach.place(around)
            held = None if self._moves.all() else np.where(self._moves, np.nan, start)
            there = farthest(hands.reshape(-1, 3), targets) < self._config.there
            way = [start] if there else self._way(start, targets, rng, held)
            self._plans[slot] = Plan(way, targets, np.zeros_like(targets), held, around)

    def act(self, ids: Array, state: Array) -> Array:
        """Towards each slot's next way point, all joints arriving together, (n, n_u)."""
        view = self._task.view
        angles, palms = view.physical(state, "angles"), view.physical(state, "palms")
        goals = view.physical(state, "goals")
        action = np.zeros((len(ids), len(self._step)), dtype=np.float32)
        for row, slot in enumerate(ids):
            plan = self._plans[slot]
            assert plan is not None, "begin() comes before act()"
            self._reach.place(plan.spheres)
            plan.goals = goals[row].reshape(-1, 3)  # where they are now: goals may move
            hands = palms[row].reshape(-1, 3)
            action[row] = self._towards(
                self._follow(plan, angles[row], hands), angles[row], farthest(hands, plan.goals)
            )
        return action

    def _towards(self, error: Array, angles: Array, distance: float) -> Array:
        """The action that takes up an error, all joints arriving together, sliding past what is
        near where there are spheres, (n_u,).
        """
        wanted = error / (self._step * self._config.gain_steps)
        action = wanted / max(1.0, np.abs(wanted).max())
        if not self._task.n_spheres:
            return np.asarray(action)
        return turned(
            self._reach,
            angles,
            action,
            step=self._step * self._moves,
            config=self._damper,
            distance=distance,
        )

    def _follow(self, plan: Plan, angles: Array, palms: Array) -> Array:
        """Error of the joints that move to the present way point [rad].

        Passes way points and corrects the last one.
        """
        error = self._next(plan, angles)
        if plan.at + 1 == len(plan.points) and np.abs(error).max() < self._config.near:
            plan.bias += self._config.correction * (plan.goals - palms)
            corrected = self._reach.descend(plan.goals + plan.bias, plan.points[-1], held=plan.held)
            if corrected is not None:
                plan.points[-1] = corrected
                error = (corrected - angles) * self._moves
        return error

    def _next(self, plan: Plan, angles: Array) -> Array:
        """Error to the way point that is next, once those that are reached, or blocked by a sphere,
        are passed.
        """
        error = np.asarray(plan.points[plan.at] - angles) * self._moves
        size = float(np.abs(error).max())
        plan.stuck = 0 if size < plan.least - self._config.progress else plan.stuck + 1
        plan.least = min(plan.least, size)
        while plan.at + 1 < len(plan.points) and (
            np.abs(error).max() < self._config.arrived or plan.stuck > self._config.patience
        ):
            plan.at, plan.stuck, plan.least = plan.at + 1, 0, np.inf
            error = (plan.points[plan.at] - angles) * self._moves
        return error

    def _way(
        self, start: Array, goals: Array, rng: np.random.Generator, held: Array | None
    ) -> list[Array]:
        """The first way that keeps its distance from everything; the known ways first, then random
        changes to them.

        Past spheres it slides, and does so straight to the goals if that is a way: it takes less
        than half the steps, and where to go then follows from where everything is, not from which
        way was taken before, so that it can be learnt.
        """
        ends = self._ends(goals, rng, held)
        ways = [[np.where(self._moves, via, start) for via in way] for way in self._ways]
        known = [[*vias, end] for end in ends for vias in ways]
        if self._task.n_spheres:
            direct = [[end] for end in ends]
            for clearance in self._config.sliding:
                for way in direct + known:
                    if self._slides(start, way, goals, clearance):
                        return way
        for own, clearance in product(self._own, self._config.clearances):
            for way in known:
                if self._clear([start, *way], clearance, own):
                    return way
        low, high = self._task.limits.T
        spread = (
            self._config.spread * self._moves * self._step / self._step.max()
        )  # a slow spine's detour would take the whole episode

        def bent(via: Array) -> Array:
            return np.asarray(np.clip(via + spread * rng.standard_normal(len(via)), low, high))

        for _ in range(self._config.tries):
            moved = [bent(via) for via in ways[0]]
            for end in ends:
                vias = moved or [bent((start + end) / 2)]  # about the middle of the straight way
                if self._clear([start, *vias, end], self._config.clearances[-1], self._own[-1]):
                    return [*vias, end]
        return [*ways[0], ends[0]]

    def _ends(self, goals: Array, rng: np.random.Generator, held: Array | None) -> list[Array]:
        """Legal postures with the palms on the goals, as different as their seeds.

        The start posture if there is none.
        """
        found = [self._reach.solve(goals, seed=seed, held=held) for seed in self._seeds] + [
            self._reach.solve(goals, held=held)
        ]
        legal = [end for end in found if end is not None]
        for _ in range(self._config.restarts if not legal else 0):
            end = self._reach.solve(
                goals, seed=np.asarray(rng.uniform(*self._task.limits.T)), held=held
            )
            if end is not None:
                return [end]
        return legal or [
            self._reach.standing_angles
            if held is None
            else np.where(self._moves, self._reach.standing_angles, held)
        ]

    def _slides(self, start: Array, way: list[Array], goals: Array, clearance: float) -> bool:
        """Whether following a way, sliding past spheres, arrives without coming close to anything,
        the base standing still.
        """
        plan, angles = (
            Plan(list(way), goals, np.zeros_like(goals), None, np.zeros((0, 4))),
            start.copy(),
        )
        for _ in range(self._config.rollout):
            error = self._next(plan, angles)
            distance = farthest(self._reach.palms(angles), goals)
            there = distance < self._config.there
            if plan.at + 1 == len(way) and (there or plan.stuck > self._config.patience):
                return there
            angles = angles + self._towards(error, angles, distance) * self._step
            if self._reach.touches(angles, clearance=clearance, own=clearance):
                return False
        return False

    def _clear(self, points: list[Array], clearance: float, own: float) -> bool:
        every = pairwise(points)
        return all(self._reach.free(a, b, clearance=clearance, own=own) for a, b in every)
