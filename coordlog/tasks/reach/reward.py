"""The paper's reward, and the flags it is made of, as pure functions of arrays.

Every operation is elementwise, so one step of 64 simulations and one whole episode of one give the
same bits.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coordlog.episode import Array
from coordlog.tasks.config import EnvConfig, RewardConfig


class Flags(NamedTuple):
    """Per arm (…, k) and per step (…) truth values.

    The leading axes are whatever the caller has.
    """

    boundary: Array  # (..., k)
    goal: Array  # (..., k)
    collision: Array  # (...)
    instability: Array  # (...)


def distances(palms: Array, goals: Array) -> Array:
    """Palm to goal of each arm, ||G_i - E_i|| [m]: (..., k, 3), (..., k, 3) → (..., k)."""
    gap = goals - palms
    x, y, z = gap[..., 0], gap[..., 1], gap[..., 2]
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def proximity(distance: Array, config: EnvConfig) -> tuple[Array, Array]:
    """The flags gb_i and goal_i: palms strictly closer than the boundary and the goal radius, (...,
    k) each.
    """
    return within(distance, boundary=config.boundary_radius, goal=config.goal_radius)


def within(distance: Array, *, boundary: float, goal: float) -> tuple[Array, Array]:
    """The same for radii [m] by themselves."""
    return distance < boundary, distance < goal


def rewards(distance: Array, flags: Flags, config: RewardConfig) -> Array:
    """Reward of each arm, (..., k).

    r_i = -α dist_i - n1 [cols] - n2 [instb] + m1 [gb_i] + m2 [goal_i], terms additive; every r_i =
    κ if all goals hold and neither collision nor instability does. Collision and instability depend
    on all arms and enter every arm's reward.

    Source: the paper's equations `reward` and the one after it.
    """
    finished = flags.goal.all(axis=-1) & ~flags.collision & ~flags.instability
    return np.where(finished[..., None], config.kappa, shaped(distance, flags, config))


def shaped(distance: Array, flags: Flags, config: RewardConfig) -> Array:
    """The terms of the reward that do not end an episode, (..., k): all but κ."""
    team = -config.n1 * flags.collision - config.n2 * flags.instability
    return np.asarray(
        -config.alpha * distance
        + config.m1 * flags.boundary
        + config.m2 * flags.goal
        + team[..., None]
    )


def ended(goal: Array, instability: Array) -> Array:
    """The task ended: the robot lost its balance, or every goal was reached at this step (the
    paper's Algorithm 1), (...).
    """
    return np.asarray(instability | goal.all(axis=-1))
