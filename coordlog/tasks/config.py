"""The environment's constants.

The paper publishes none of them: every value here is our choice, and is written into every log.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from coordlog.errors import ConfigError, unknown

BALANCE_CRITERIA = ("com", "com+zmp")
MOST_SUBSTEPS = 10_000
"""Physics steps that an action may take; ours take 8, and each is kept in memory."""
STATE_EXTRAS = ("difference", "com", "nearness", "velocity")
FATTEST = 0.02
"""Obstacles grow by no more than this [m]: the clearance that drawn problems leave around goals and
the start."""
TRAINING_ONLY = ("start_line", "start_random", "start_solved", "inflate")
"""Constants that make training easier and are zero wherever anything is judged."""


@dataclass(frozen=True)
class EnvConfig:
    """Control, endings, balance and what the policy sees."""

    control_period: float = 0.04
    """Seconds between two actions; a whole number of physics timesteps."""
    max_steps: int = 150
    """Steps after which an episode is truncated (the paper's MaxStep)."""
    speed: float = 1.0
    """Joint speed of a private joint at action ±1 [rad/s]."""
    shared_speed: float = 0.3
    """Joint speed of a shared joint at action ±1 [rad/s]: the spine carries half the mass, and its
    reversals topple the robot."""
    smoothing: float = 0.7
    """First-order filter on the velocity command, 0 (none) to below 1: v ← smoothing · v + (1 -
    smoothing) · a."""
    goal_radius: float = 0.03
    """A palm this close to its goal [m] has reached it."""
    boundary_radius: float = 0.10
    """A palm this close to its goal [m] earns the boundary reward."""
    balance: str = "com"
    """What must stay over the feet: "com" (centre of mass) or "com+zmp" (and the zero-moment
    point)."""
    balance_margin: float = 0.01
    """The support polygon is shrunk by this much [m]."""
    tilt: float = 1.2
    """The torso leaning further than this from upright [rad] is instability too."""
    start_noise: float = 0.05
    """Start angles are the start pose ± this much [rad], uniform."""
    state_extras: tuple[str, ...] = ("difference", "com", "nearness")
    """What the policy sees beyond the paper's state: any of "difference" (palm to goal), "com",
    "nearness" (of spheres to the last link of each arm, if there are any), "velocity"."""
    locked: tuple[str, ...] = ()
    """Action joints that their servos hold at the start angle, whatever the action: state, action
    and problems stay the same."""
    start_line: float = 0.0
    """Share of the problems of the split "train" that begin on the joint line from the start pose
    to another named one."""
    start_random: float = 0.0
    """Share of them that begin in a random posture which touches nothing and is balanced.

    The others in the start pose.
    """
    start_solved: float = 0.0
    """Share of all of them that begin near a posture which reaches the goals of another draw
    instead."""
    inflate: float = 0.0
    """Obstacles are larger than the policy is told, by this much on every side [m].

    For training alone.
    """

    def __post_init__(self) -> None:
        object.__setattr__(self, "state_extras", tuple(self.state_extras))
        object.__setattr__(self, "locked", tuple(self.locked))
        for name in (
            "control_period",
            "speed",
            "shared_speed",
            "goal_radius",
            "boundary_radius",
            "tilt",
        ):
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name}: expected a positive number, got {getattr(self, name)}")
        if not 0 <= self.smoothing < 1:
            raise ConfigError(
                f"smoothing: expected a number from 0 to below 1, got {self.smoothing}"
            )
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, float) and not math.isfinite(value):
                raise ConfigError(f"{item.name}: expected a finite number, got {value}")
        for name in ("start_line", "start_random", "start_solved"):
            if not 0 <= getattr(self, name) <= 1:
                raise ConfigError(
                    f"{name}: expected a share from 0 to 1, got {getattr(self, name)}"
                )
        if self.start_line + self.start_random > 1:
            raise ConfigError(
                "start_line + start_random: expected at most 1, got "
                f"{self.start_line + self.start_random:g}"
            )
        if not 0 <= self.inflate <= FATTEST:
            raise ConfigError(f"inflate: expected 0 to {FATTEST} m, got {self.inflate}")
        if self.max_steps < 1:
            raise ConfigError(f"max_steps: expected at least 1, got {self.max_steps}")
        if self.balance not in BALANCE_CRITERIA:
            raise unknown("balance criterion", self.balance, BALANCE_CRITERIA)
        for extra in self.state_extras:
            if extra not in STATE_EXTRAS:
                raise unknown("state extra", extra, STATE_EXTRAS)

    def substeps(self, timestep: float) -> int:
        """Physics steps per control step.

        Raises:
            ConfigError: if the control period is not a whole number of timesteps.
        """
        count = round(min(self.control_period / timestep, MOST_SUBSTEPS + 1.0))
        if count > MOST_SUBSTEPS:
            raise ConfigError(
                f"control_period: expected at most {MOST_SUBSTEPS:,} timesteps of {timestep} s, "
                f"got {self.control_period} s"
            )
        if count < 1 or abs(count * timestep - self.control_period) > 1e-9:
            raise ConfigError(
                f"control_period: expected a multiple of the model's timestep {timestep} s, got "
                f"{self.control_period} s; give the model a timestep such as 0.002, or say "
                f"control_period = {max(count, 1) * timestep:.6g} in the [env] of a --config file"
            )
        return count


@dataclass(frozen=True)
class RewardConfig:
    """Constants of the paper's reward equation, r_i = -α dist_i - n1 cols - n2 instb + m1 gb_i + m2
    goal_i, and κ.
    """

    alpha: float = 1.0
    """Per metre between palm and goal."""
    n1: float = 0.3
    """Collision, per step, both arms."""
    n2: float = 10.0
    """Instability, both arms; it ends the episode."""
    m1: float = 0.1
    """Palm within the boundary radius, per step, its own arm."""
    m2: float = 0.3
    """Palm within the goal radius, per step, its own arm."""
    kappa: float = 30.0
    """Every palm within its goal radius and no collision or instability: replaces every arm's
    reward, and ends the episode."""

    def __post_init__(self) -> None:
        for item in fields(self):
            if not 0 <= getattr(self, item.name) < math.inf:
                raise ConfigError(
                    f"reward {item.name}: expected a number ≥ 0, got {getattr(self, item.name)}"
                )

    def doubts(self, *, gamma: float = 0.98, steps: int = 150, farthest: float = 0.8) -> list[str]:
        """Which constants might teach the wrong thing, one sentence each.

        Both conditions are sufficient, not necessary: S = (1 - γ^steps) / (1 - γ) discounted steps
        of loitering must not beat finishing (κ ≥ (m1 + m2) S), and S steps of standing still, which
        touches nothing, must not be worse than falling (n2 ≥ α d S).

        Args:
            gamma: Discount per step of the run.
            steps: Steps of an episode; they stand for a time through the control period.
            farthest: Distance of the palms from their goals while the robot stands still [m].
        """
        horizon = steps if gamma == 1 else (1 - gamma**steps) / (1 - gamma)
        loitering, standing = (self.m1 + self.m2) * horizon, self.alpha * farthest * horizon
        said = []
        if self.kappa < loitering:
            said.append(
                f"reward kappa = {self.kappa:g} is less than loitering at the goal can earn "
                f"({loitering:.1f} at γ = {gamma:g})"
            )
        if self.n2 < standing:
            said.append(
                f"reward n2 = {self.n2:g} is less than standing far away can cost ({standing:.1f} "
                f"at γ = {gamma:g}): falling may pay"
            )
        return said
