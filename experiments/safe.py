"""From a held-out problem to a proven trajectory: a policy's rollout, smoothed under the scene's
rules.

Two rollouts: `physics`, the policy in the simulation that it acts in, smoothed and executed as
`coordlog smooth` does it; and `kinematic`, the policy on the same state with the servos taken as
exact and the base standing still, which is what a sampling planner plans with. The latter is a path
that nobody has gone yet. So it ends in a posture with the palms on their goals, is timed, and is
executed like a planner's.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import process_time
from typing import NamedTuple

import mujoco
import numpy as np

from coordlog.contracts import Policy
from coordlog.episode import Array
from coordlog.policies.avoidance import farthest
from coordlog.sim.env import BatchEnv
from coordlog.sim.replay import Log
from coordlog.sim.tracking import Run
from coordlog.smooth.execute import follow
from coordlog.smooth.recorded import smooth_motion
from coordlog.smooth.result import Result
from coordlog.tasks.reach.observation import nearness
from experiments.case import ONE, Case, chase

CLEARANCE = 0.005  # m, what `coordlog smooth` keeps by default

KNOTS = 30
"""Configurations of a kinematic rollout that are kept, at most: they say where to go, and the
certificate looks between."""
SLOWER = 1.15
"""A kinematic rollout takes this much longer than the policy, whose joints are at their speeds'
limits: a path that starts softly and goes around something has to be faster somewhere, and without
room for that turns back into the rollout, jerks and all."""
PEAK = 1.92
"""Greatest speed of the smoothest path there is, over its mean: 3/2 of a cubic at rest at both
ends, times 4/π of ends that are eased over half of it each (`coordlog.smooth.blending`). A motion that
is to be no faster than its joints takes at least as long."""


class Rollout(NamedTuple):
    """Where a policy led."""

    time: Array  # (n,) s
    qpos: Array  # (n, n_q)
    action: Array  # (T, n_u) float32, T < n
    arrived: bool
    exact: bool
    """Whether the servos were taken as exact: the angles are the targets, and the times are ours to
    choose."""


class Safe(NamedTuple):
    """A trajectory, and the processor time of its parts [s]."""

    result: Result
    rollout: Rollout
    cpu: dict[str, float]


def kinematic(env: BatchEnv, where: Case, policy: Policy) -> Rollout:
    """Act until both palms are at their goals, with servos that are exact and a base that stands
    still, and close the gap that is left.
    """
    task, model = env.task, where.log.model
    config, data = task.config, mujoco.MjData(model)
    mujoco.mj_setState(model, data, where.log.start, mujoco.mjtState.mjSTATE_INTEGRATION)
    target, command = data.ctrl[None].copy(), np.zeros((1, len(task.servos)))
    palms = [model.site(arm.palm).id for arm in task.robot.arms]
    links = model.site_bodyid[palms]
    mass = model.body_mass / model.body_mass.sum()
    goals, spheres = where.problem.goals, where.problem.spheres
    fixed: dict[str, Array] = {"goals": goals.ravel(), "spheres": spheres.ravel()}
    path, actions = list[Array](), list[Array]()
    while True:
        path.append(target[0, task.servos])
        data.qpos[task.qpos_index] = path[-1]
        mujoco.mj_kinematics(model, data)
        here = data.site_xpos[palms]
        arrived = farthest(here, goals) < config.goal_radius
        if arrived or len(actions) == config.max_steps:
            break
        parts = fixed | {
            "angles": path[-1],
            "palms": here.ravel(),
            "difference": (goals - here).ravel(),
            "com": (mass @ data.xipos)[:2],
        }
        if "nearness" in task.view.places:
            parts["nearness"] = nearness(data.xpos[links][None], here[None], spheres[None]).ravel()
        action = np.clip(policy.act(ONE, task.view.scaled(parts)[None])[0], -1.0, 1.0).astype(
            np.float32
        )
        actions.append(action)
        command = task.filtered(command, action[None])
        target = task.target(target, command)
    if arrived:
        path += _closing(env, path[-1], goals)
    kept = np.unique(np.linspace(0, len(path) - 1, min(KNOTS, len(path))).round().astype(int))
    angles = np.array(path)[kept]
    straight = float((np.abs(angles[-1] - angles[0]) / task.speeds).max())
    duration = max(SLOWER * (len(path) - 1) * config.control_period, PEAK * straight)
    qpos = np.repeat(data.qpos[None], len(kept), axis=0)
    qpos[:, task.qpos_index] = angles
    return Rollout(duration * kept / kept[-1], qpos, np.array(actions), arrived, exact=True)


def _closing(env: BatchEnv, angles: Array, goals: Array) -> list[Array]:
    """Steps on from where the policy arrived until the palms are on their goals: executed, the base
    does not stand quite still.
    """
    task = env.task
    there = env.draw.reach.descend(goals, angles)
    if there is None:
        return []
    count = int(
        np.ceil((np.abs(there - angles) / (task.speeds * task.config.control_period)).max())
    )
    return [angles + (there - angles) * (i / count) for i in range(1, count + 1)]


def physical(where: Case, env: BatchEnv, policy: Policy) -> Rollout:
    """Act in the simulation until the episode ends."""
    task = env.task
    state = {"now": env.state[:1].copy()}
    qpos, actions, over, arrived = [where.qpos], list[Array](), False, False
    while not over:
        action = np.clip(policy.act(ONE, state["now"])[0], -1.0, 1.0).astype(np.float32)
        outcome = env.step(action[None], ONE)
        actions.append(action)
        qpos.append(env.simulation.qpos[0].copy())
        state["now"] = env.state[:1].copy()
        over = bool(outcome.terminated[0] | outcome.truncated[0] | outcome.diverged[0])
        arrived = bool(outcome.goal[0].all())
    return Rollout(
        np.arange(len(qpos)) * task.config.control_period,
        np.array(qpos),
        np.array(actions),
        arrived,
        exact=False,
    )


def safe(env: BatchEnv, where: Case, policies: Sequence[Policy], *, physics: bool) -> Safe:
    """The first of these policies that leads to the goals by a path that is proven, or the last;
    the env has to stand at the start.
    """
    cpu: dict[str, float] = {}
    for policy in policies:
        found = _safe(env, where, policy, physics=physics)
        cpu = {name: cpu.get(name, 0.0) + spent for name, spent in found.cpu.items()}
        if found.rollout.arrived and found.result.certified:
            break
    return found._replace(cpu=cpu)


def _safe(env: BatchEnv, where: Case, policy: Policy, *, physics: bool) -> Safe:
    began = process_time()
    policy.begin(ONE, env.state[:1], [np.random.default_rng(0)])
    rolled = physical(where, env, policy) if physics else kinematic(env, where, policy)
    cpu = {"rollout": process_time() - began}
    began = process_time()
    result, _ = smooth_motion(
        where.log, rolled.time, rolled.qpos, ends="soft", settings={"clearance": CLEARANCE}
    )
    cpu["smooth"] = process_time() - began
    return Safe(result, rolled, cpu)


def executed(where: Case, env: BatchEnv, found: Safe) -> Run:
    """The smoothed path driven through the simulation from the case's first state.

    One from a simulation by its servo targets, too.
    """
    if found.rollout.exact:
        return chase(where.log, found.result.spline, float(found.result.spline.time[-1]))
    log = Log(where.log.header, where.log.model, where.log.start, found.rollout.action)
    return follow(
        log, found.result, found.rollout.qpos[:, env.task.qpos_index], arrives=found.rollout.arrived
    )
