"""A sampling planner as its users would call it: an inverse-kinematics goal, RRTConnect,
simplification; the base standing still.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from time import process_time
from typing import Any, NamedTuple

import mujoco
import numpy as np
from ompl import base, geometric, util

from coordlog.episode import Array
from coordlog.kinematics.pairs import obstacles
from coordlog.sim.env import BatchEnv
from coordlog.tasks.scene import sole_corner
from experiments.case import Case

RESOLUTION = 0.05
"""A motion is checked this often, in the norm of all joints [rad]."""
CLEARANCES = (0.01, 0.005, 0.0)
"""Distances to keep from obstacles [m]: the first that start and goal allow."""
TIMEOUT = 5.0  # s
RESTARTS = 60
PEAK = 1.875
"""Greatest speed of the minimum-jerk law over its mean."""
NEVER = -1e3  # m: a contact margin that no contact meets


class Plan(NamedTuple):
    """A path, or none, and the processor time of its parts [s]."""

    points: Array | None  # (n, n_u) rad
    cpu: dict[str, float]


class Rules:
    """Whether the action joints may stand somewhere: nothing touches or comes closer than
    `clearance`, and the mass is over the feet.
    """

    def __init__(self, env: BatchEnv, where: Case) -> None:
        """Copy the model; the base, legs and head stay as they are at the start."""
        task = env.task
        self._model = model = copy(where.log.model)
        self._data = data = mujoco.MjData(model)
        mujoco.mj_setState(model, data, where.log.start, mujoco.mjtState.mjSTATE_INTEGRATION)
        model.pair_margin[:] = NEVER  # soles on the floor
        self._places, self._obstacles, self._limits = task.qpos_index, obstacles(model), task.limits
        self._mass = model.body_mass / model.body_mass.sum()
        mujoco.mj_kinematics(model, data)
        corners = [
            model.site(sole_corner(sole, i)).id for sole in task.robot.soles for i in range(4)
        ]
        self._support = _edges(data.site_xpos[corners, :2], task.config.balance_margin)

    def keep(self, clearance: float) -> None:
        """Ask for this distance from obstacles from now on [m]."""
        self._model.geom_margin[self._obstacles] = clearance

    def free(self, q: Array) -> bool:
        """Whether the action joints may stand at q (n_u,) [rad]."""
        model, data = self._model, self._data
        data.qpos[self._places] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        if data.ncon:
            return False
        normal, offset = self._support
        return bool((normal @ (self._mass @ data.xipos)[:2] <= offset).all())


def _edges(points: Array, margin: float) -> tuple[Array, Array]:
    from scipy.spatial import ConvexHull

    equations = ConvexHull(points).equations  # normal · x + offset ≤ 0 inside
    return equations[:, :2], -equations[:, 2] - margin


def plan(env: BatchEnv, where: Case) -> Plan:
    """A simplified path from the start to a posture with both palms on their goals."""
    began = process_time()
    rules, start, limits = Rules(env, where), where.problem.angles, env.task.limits
    goal = _goal(env, where, rules, start)
    cpu = {"ik": process_time() - began}
    if goal is None:
        return Plan(None, cpu)
    began = process_time()
    info, space = space_within(limits, rules.free, start, goal)
    task = base.ProblemDefinition(info)
    task.setStartAndGoalStates(state_of(space, start), state_of(space, goal))
    planner = geometric.RRTConnect(info)
    planner.setProblemDefinition(task)
    planner.setup()
    solved = planner.solve(TIMEOUT)
    cpu["rrt"] = process_time() - began
    if not solved or not task.hasExactSolution():
        return Plan(None, cpu)
    began = process_time()
    path = task.getSolutionPath()
    geometric.PathSimplifier(info).simplifyMax(path)
    points = np.array([[state[j] for j in range(len(start))] for state in path.getStates()])
    cpu["simplify"] = process_time() - began
    return Plan(points, cpu)


def _goal(env: BatchEnv, where: Case, rules: Rules, start: Array) -> Array | None:
    """A posture to plan to.

    The clearance asked for from then on is the first that it and the start allow.
    """
    reach, rng = env.draw.reach, np.random.default_rng([where.problem.seed, where.problem.index])
    reach.place(where.problem.spheres)
    for clearance in CLEARANCES:
        rules.keep(clearance)
        if not rules.free(start):
            continue
        named = reach.solve(where.problem.goals, clearance=clearance)
        if named is not None and rules.free(named):
            return named
        for _ in range(RESTARTS):
            found = reach.descend(where.problem.goals, np.asarray(rng.uniform(*env.task.limits.T)))
            if found is not None and rules.free(found):
                return found
    return None


def space_within(limits: Array, free: Callable[[Array], bool], *inside: Array) -> tuple[Any, Any]:
    """What is known about the joints, (n, 2) [rad], and their space, widened to hold some
    configurations.
    """
    n = len(limits)
    space, bounds = base.RealVectorStateSpace(n), base.RealVectorBounds(n)
    for j in range(n):
        bounds.setLow(j, float(min(limits[j, 0], *(q[j] for q in inside))))
        bounds.setHigh(j, float(max(limits[j, 1], *(q[j] for q in inside))))
    space.setBounds(bounds)
    space.setLongestValidSegmentFraction(RESOLUTION / space.getMaximumExtent())
    info = base.SpaceInformation(space)
    scratch = np.empty(n)

    def valid(state: Any) -> bool:
        for j in range(n):
            scratch[j] = state[j]
        return free(scratch)

    info.setStateValidityChecker(valid)
    info.setup()
    return info, space


def state_of(space: Any, q: Array) -> Any:
    """A configuration as OMPL has it."""
    state = space.allocState()
    for j, value in enumerate(q):
        state[j] = float(value)
    return state


def quiet(seed: int) -> None:
    """No console output, and the same random numbers at every run.

    Has to come before anything else of OMPL's.
    """
    util.setLogLevel(util.LogLevel.LOG_NONE)
    util.RNG.setSeed(seed)


class Timed(NamedTuple):
    """A path along which joints move no faster than they may: straight between its points, under
    one minimum-jerk law.
    """

    points: Array
    along: Array
    """Time at which each point would be passed at full speed [s], from 0."""
    duration: float

    @classmethod
    def of(cls, points: Array, speeds: Array) -> Timed:
        """Time a path for joint speeds (n_u,) [rad/s]."""
        moved = np.abs(np.diff(points, axis=0)) / speeds
        points = points[np.append(True, moved.max(axis=1) > 1e-9)]
        along = np.append(0.0, np.cumsum((np.abs(np.diff(points, axis=0)) / speeds).max(axis=1)))
        return cls(points, along, PEAK * float(along[-1]))

    def __call__(self, t: float | Array) -> Array:
        """Joint angles at times [s], (…, n_u)."""
        x = np.clip(np.asarray(t) / self.duration, 0.0, 1.0)
        at = x**3 * (10.0 - 15.0 * x + 6.0 * x**2) * self.along[-1]
        return np.stack([np.interp(at, self.along, column) for column in self.points.T], axis=-1)
