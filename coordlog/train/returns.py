"""Rewards of several steps as one: the n-step return that a target starts with, cut where the task
or the record ends.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coordlog.episode import Array


class Return(NamedTuple):
    """What n steps earned, and what the rest is worth."""

    reward: Array  # (B, k) Σ_j γ^j r_j over the steps that count
    last: Array  # (B,) which step was the last to count, from 0
    discount: (
        Array  # (B,) γ^(number of steps that count), 0 where the task ended at the last of them
    )


def n_step(reward: Array, terminated: Array, within: Array, *, gamma: float) -> Return:
    """Sum the discounted rewards of n consecutive steps, as far as the episode goes.

    A step counts if it is in the record and no step before it ended the task. The first always
    does.

    Args:
        reward: Rewards, (B, n, k).
        terminated: Whether the task ended with the step, (B, n) bool.
        within: Whether the step is in the record and of the same episode, (B, n) bool, true for the
            first.
        gamma: Discount per step.

    Source: Sutton 1988; with replay and without correction as in Hessel et al. 2018 (Rainbow) and
    Barth-Maron et al. 2018 (D4PG).
    """
    if reward.shape[1] == 1:  # the common case, without the bookkeeping
        return Return(
            reward[:, 0], np.zeros(len(reward), np.intp), np.where(terminated[:, 0], 0.0, gamma)
        )
    counts = within.copy()
    counts[:, 1:] &= ~np.logical_or.accumulate(terminated[:, :-1], axis=1)
    weight = counts * gamma ** np.arange(reward.shape[1])
    last = counts.sum(axis=1) - 1
    ended = terminated[np.arange(len(last)), last]
    return Return(
        (reward * weight[..., None]).sum(axis=1), last, np.where(ended, 0.0, gamma ** (last + 1.0))
    )
