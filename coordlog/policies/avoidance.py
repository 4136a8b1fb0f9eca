"""Sliding past what is near: joint motions that would bring a link too fast towards it are turned
along its surface.

A velocity damper: the closer the link, the slower it may come (Faverjon and Tournassoud 1987). What
is in the way of a straight joint line is so passed by going around it, as a function of where
everything is now, which a policy can learn; a plan drawn by chance it cannot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from coordlog.episode import Array
from coordlog.errors import ConfigError
from coordlog.kinematics.ik import Approach, Reach


@dataclass(frozen=True)
class DamperConfig:
    """How near to what a motion may come; the table [damper] of a configuration file.

    Example:
        >>> DamperConfig(safe=0.05).gap_at(0.15)
        0.05
    """

    safe: float = 0.03
    """Gap that an arm's last link keeps to an obstacle on the way [m]."""
    close: float = 0.01
    """The same with the palms at the goals [m]."""
    on_the_way: float = 0.15
    """Further than this from its goal, a palm is on the way [m]; nearer, the gap shrinks in
    proportion."""
    body: float = 0.02
    """That gap between other links and an obstacle [m]; the body sways by more than a command
    says."""
    own: float = 0.006
    """That gap between an arm and the robot itself [m]."""
    lean: float = 0.06
    """What the torso keeps of the angle to where it counts as tipped [rad]. The feet give way by
    nearly half of it."""
    closing: float = 0.2
    """Share of the gap that is left to these by which it may close in one step, 0 to 1."""
    rounds: int = 4
    """Passes over all that is near: turning away from one thing may turn towards another."""

    def __post_init__(self) -> None:
        require_positive(self, besides=("own", "lean", "close"))
        if not self.closing <= 1:
            raise ConfigError(f"damper.closing: expected a share up to 1, got {self.closing}")

    def gap_at(self, distance: float) -> float:
        """Gap to keep between last links and obstacles [m] with the palm that is furthest from its
        goal at this distance [m].
        """
        return max(self.close, self.safe * min(1.0, distance / self.on_the_way))

    def allowed(self, found: Approach, safe: float) -> float:
        """By how much a gap may close in one step [m]; negative where it has to open."""
        if not found.solid:
            return self.closing * (found.gap - self.own)
        return self.closing * (found.gap - (safe if found.tip else self.body))


def require_positive(config: Any, *, besides: tuple[str, ...] = ()) -> None:
    """Hold the numbers of a policy's constants to their ranges: finite, and more than 0.

    Args:
        config: A dataclass of numbers and lists of numbers.
        besides: Names of those that may be 0; so may what is in a list.

    Raises:
        ConfigError: naming the first that is not.
    """
    for name, value in vars(config).items():
        many = isinstance(value, tuple)
        least = "at least 0" if many or name in besides else "above 0"
        for each in value if many else (value,):
            if not math.isfinite(each) or each < 0 or (each == 0 and least == "above 0"):
                raise ConfigError(f"{name}: expected a number {least}, got {each}")


def slide(
    reach: Reach,
    angles: Array,
    move: Array,
    *,
    effort: Array,
    config: DamperConfig,
    safe: float | None = None,
) -> Array:
    """A motion of the joints that is slowed towards what is near and turned along it.

    Args:
        reach: Kinematics, the spheres placed.
        angles: Joint angles, (n_u,) [rad].
        move: What is wanted of them in one step, (n_u,) [rad].
        effort: How far each joint can move in one step, (n_u,) [rad]; those that can do more give
            way more.
        config: Constants.
        safe: Gap to keep between last links and obstacles [m]; by default `config.safe`.
    """
    gap = config.safe if safe is None else safe
    near = [(found.closing, config.allowed(found, gap)) for found in reach.approaches(angles)]
    torso = reach.leaning()
    near.append((torso.closing, config.closing * (torso.gap - config.lean)))
    move = move.copy()
    for _ in range(config.rounds):
        for row, limit in near:
            excess = row @ move - limit
            if excess > 0:
                give = effort**2 * row
                move -= excess * give / max(row @ give, 1e-9)
    return move


def farthest(palms: Array, goals: Array) -> float:
    """Distance of the palm that is furthest from its goal, of points (k, 3) [m]."""
    return float(np.sqrt(np.square(palms - goals).sum(axis=1).max()))


def turned(
    reach: Reach,
    angles: Array,
    action: Array,
    *,
    step: Array,
    config: DamperConfig,
    distance: float,
) -> Array:
    """An action whose motion slides past what is near, no entry beyond ±1, (n_u,).

    Args:
        reach: Kinematics, the spheres placed.
        angles: Joint angles, (n_u,) [rad].
        action: What is wanted, (n_u,).
        step: How far action 1 moves each joint in one step, (n_u,) [rad]; 0 for one that is locked,
            which then gives no way either.
        config: Constants.
        distance: How far from its goal the palm is that is furthest [m].
    """
    safe = config.gap_at(distance)
    moved = slide(reach, angles, action * step, effort=step, config=config, safe=safe)
    found = moved / np.where(step > 0, step, 1.0)
    return np.asarray(found / max(1.0, np.abs(found).max()))
