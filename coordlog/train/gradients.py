"""How the tasks' gradients become one: DiGrad's mask, and the gradient surgery it is compared
with.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from coordlog.episode import Array
from coordlog.errors import ConfigError
from coordlog.train.config import Gradient


def gradient_mask(arms: Mapping[str, Sequence[int]], n_u: int) -> Array:
    """DiGrad's mask m (k, n_u) for any sharing of joints.

    m[i, j] = 1 / (number of arms that joint j serves) if it serves arm i, else 0: eq. (3)'s 1 for a
    private action, 1/k for one shared by all, 0 for another arm's, and the mean over those
    concerned where only some share a joint. Every column sums to one.

    Args:
        arms: Action indices of each arm, shared ones in each of theirs, as in an episode's header.
        n_u: Number of actions.

    Raises:
        ConfigError: if an index is out of range, or an action serves no arm and could never learn.
    """
    serves = np.zeros((len(arms), n_u))
    for row, (name, indices) in enumerate(arms.items()):
        if len(indices) == 0 or min(indices) < 0 or max(indices) >= n_u:
            raise ConfigError(
                f"arm '{name}': expected action indices between 0 and {n_u - 1}, got "
                f"{list(indices)}"
            )
        serves[row, list(indices)] = 1
    arms_served = serves.sum(axis=0)
    if (arms_served == 0).any():
        raise ConfigError(
            f"actions {np.flatnonzero(arms_served == 0).tolist()} serve no arm; give each to an "
            "arm or leave it out of the action"
        )
    return np.asarray(serves / arms_served)


def head_weights(gradient: Gradient, mask: Array) -> Array:
    """Weights (k, n_u) of ∂Q_i/∂a_j in the sum over heads: DiGrad's mask, or all ones ("sum",
    "pcgrad") or 1/k ("mean").
    """
    if gradient == "mask":
        return mask
    return np.full(mask.shape, 1 / len(mask) if gradient == "mean" else 1.0)


def project_conflicts(gradients: Sequence[Tensor], *, generator: torch.Generator) -> Tensor:
    """Sum of the tasks' gradients, each with what opposes another task's removed.

    g_i ← g_i - (g_i · g_j / |g_j|²) g_j for every other j, in random order, wherever g_i · g_j < 0.

    Args:
        gradients: One flat vector per task.
        generator: For the order.

    Source: Yu et al. 2020, Gradient Surgery for Multi-Task Learning (PCGrad), Algorithm 1.
    """
    total = torch.zeros_like(gradients[0])
    for i, gradient in enumerate(gradients):
        projected = gradient.clone()
        for j in torch.randperm(
            len(gradients), generator=generator, device=generator.device
        ).tolist():
            if j == i:
                continue
            overlap = torch.dot(projected, gradients[j])
            squared = torch.dot(gradients[j], gradients[j]).clamp_min(
                torch.finfo(overlap.dtype).tiny
            )
            projected -= overlap.clamp_max(0) / squared * gradients[j]
        total += projected
    return total
