"""From a held-out problem to a proven trajectory: a policy's rollout, smoothed under the scene's rules.

Two rollouts: `physics`, the policy in the simulation that it acts in; and `kinematic`, the policy on the same state with the servos
taken as exact and the base standing still, which is what a sampling planner plans with.
"""

from __future__ import annotations

from time import process_time
from typing import Any, NamedTuple, cast

import mujoco
import numpy as np

from coordlog.commands.smoothing import FASTER, fastest_of
from coordlog.episode import Array
from coordlog.rollout import Policy
from coordlog.sim.clearance import SceneChecker
from coordlog.sim.drive import Drive, Run
from coordlog.sim.env import BatchEnv
from coordlog.sim.replay import Log
from coordlog.sim.state import nearness
from coordlog.smooth.execute import follow
from coordlog.smooth.limits import Limits
from coordlog.smooth.result import Result
from coordlog.smooth.smoother import smooth
from results.case import ONE, Case

CLEARANCE = 0.005  # m, what `coordlog smooth` keeps by default


class Rollout(NamedTuple):
    """Where a policy led, (T + 1) configurations and T actions."""

    time: Array  # (T + 1,) s
    qpos: Array  # (T + 1, n_q)
    action: Array  # (T, n_u) float32
    arrived: bool


class Safe(NamedTuple):
    """A trajectory, and the processor time of its parts [s]."""

    result: Result
    rollout: Rollout
    cpu: dict[str, float]


def kinematic(env: BatchEnv, where: Case, policy: Policy) -> Rollout:
    """Act until both palms are at their goals, with servos that are exact and a base that stands still."""
    task, model = env.task, where.log.model
    config, data = task.config, mujoco.MjData(model)
    mujoco.mj_setState(model, data, where.log.start, mujoco.mjtState.mjSTATE_INTEGRATION)
    drive = Drive(task, data.ctrl)
    palms = [model.site(arm.palm).id for arm in task.robot.arms]
    links = model.site_bodyid[palms]
    mass = model.body_mass / model.body_mass.sum()
    goals, spheres = where.problem.goals, where.problem.spheres
    fixed: dict[str, Array] = {"goals": goals.ravel(), "spheres": spheres.ravel()}
    qpos, actions = [], []
    arrived = False
    for _ in range(config.max_steps + 1):
        data.qpos[task.qpos_index] = drive.target
        mujoco.mj_kinematics(model, data)
        qpos.append(data.qpos.copy())
        here = data.site_xpos[palms]
        arrived = bool((np.linalg.norm(goals - here, axis=1) < config.goal_radius).all())
        if arrived or len(actions) == config.max_steps:
            break
        parts = fixed | {
            "angles": drive.target,
            "palms": here.ravel(),
            "difference": (goals - here).ravel(),
            "com": (mass @ data.xipos)[:2],
        }
        if "nearness" in task.view.places:
            parts["nearness"] = nearness(data.xpos[links][None], here[None], spheres[None]).ravel()
        action = np.clip(policy.act(ONE, task.view.scaled(parts)[None])[0], -1.0, 1.0).astype(np.float32)
        actions.append(action)
        drive.step(action)
    return Rollout(np.arange(len(qpos)) * config.control_period, np.array(qpos), np.array(actions), arrived)


def physical(where: Case, env: BatchEnv, policy: Policy) -> Rollout:
    """Act in the simulation until the episode ends."""
    task = env.task
    state = {"now": env.state[:1].copy()}
    qpos, actions, over, arrived = [where.qpos], [], False, False
    while not over:
        action = np.clip(policy.act(ONE, state["now"])[0], -1.0, 1.0).astype(np.float32)
        outcome = env.step(action[None], ONE)
        actions.append(action)
        qpos.append(env.simulation.qpos[0].copy())
        state["now"] = env.state[:1].copy()
        over = bool(outcome.terminated[0] | outcome.truncated[0] | outcome.diverged[0])
        arrived = bool(outcome.goal[0].all())
    return Rollout(np.arange(len(qpos)) * task.config.control_period, np.array(qpos), np.array(actions), arrived)


def safe(env: BatchEnv, where: Case, policy: Policy, *, physics: bool) -> Safe:
    """Roll out and smooth; the env has to stand at the case's start."""
    began = process_time()
    policy.begin(ONE, env.state[:1], [np.random.default_rng(0)])
    rolled = physical(where, env, policy) if physics else kinematic(env, where, policy)
    cpu = {"rollout": process_time() - began}
    began = process_time()
    task = env.task
    checker = SceneChecker(where.log.model, task.robot, task.config, time=rolled.time, qpos=rolled.qpos, initial=where.log.start)
    angles = rolled.qpos[:, task.qpos_index]
    fastest = fastest_of(rolled.time, angles)
    limits = Limits(task.limits[:, 0], task.limits[:, 1], speed=FASTER * np.maximum(task.speeds, fastest), pace=task.speeds)
    # The checker is one by its methods: the simulation's room knows nothing of smoothing.
    result = smooth(
        rolled.time, angles, cast("Any", checker), limits=limits, joints=task.robot.action_joints, ends="soft", clearance=CLEARANCE
    )
    cpu["smooth"] = process_time() - began
    return Safe(result, rolled, cpu)


def executed(where: Case, env: BatchEnv, found: Safe) -> Run:
    """The smoothed path driven through the simulation from the case's first state (`coordlog.smooth.execute.follow`)."""
    log = Log(where.log.header, where.log.model, where.log.start, found.rollout.action)
    return follow(log, found.result, found.rollout.qpos[:, env.task.qpos_index], arrives=found.rollout.arrived)
