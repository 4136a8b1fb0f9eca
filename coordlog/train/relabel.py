"""Rewards, flags and endings recomputed from what was logged: for other reward constants, and for
goals in hindsight.

A goal that was reached later in an episode is a goal the actions before it led to, so a transition
may be learnt from as if that had been asked for (Andrychowicz et al. 2017). Everything that depends
on goals is then recomputed, `terminated` too; collision and instability do not depend on goals and
stay as logged. Valid because the object to be grasped is not an obstacle.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple, Protocol

import numpy as np

from coordlog.episode import Array
from coordlog.errors import SpecError
from coordlog.tasks.reach.reward import distances, ended, within

AXES = 3
Ended = Callable[[Array, Array], Array]
"""ended(goal (n, k), instability (n,)) → (n,) bool: which steps end an episode for good."""


class RewardFunction(Protocol):
    """The paper's reward with its constants bound: one value per arm from distances, flags per arm,
    and flags of all arms.
    """

    def __call__(
        self, distance: Array, boundary: Array, goal: Array, collision: Array, instability: Array
    ) -> Array:
        """Rewards (n, k) from (n, k) distances [m], boundary and goal flags, and (n,) collision and
        instability.
        """
        ...


@dataclass(frozen=True, eq=False)
class GoalView:
    """Where palms and goals stand in a state, in what scale, and when a palm has arrived.

    Entry = (metres - offset) / scale. Palms, goals and differences are k points of three
    coordinates each, arm by arm.
    """

    palms: slice
    goals: slice
    difference: slice | None
    """Goal minus palm, if the state has it."""
    offset: Array  # (n_x,)
    scale: Array  # (n_x,)
    goal_radius: float
    """Closer than this [m] is at the goal."""
    boundary_radius: float
    """Closer than this [m] is within the goal's boundary."""
    ended: Ended = ended
    """The task's rule of what ends an episode."""

    def __post_init__(self) -> None:
        """Check that the three places are of one width.

        Raises:
            SpecError: if they are not, or the width is not a whole number of points.
        """
        widths = {
            place.stop - place.start
            for place in (self.palms, self.goals, self.difference)
            if place is not None
        }
        if len(widths) != 1 or min(widths) % AXES or min(widths) == 0:
            raise SpecError(
                f"goal view: expected palms, goals and difference of one width, {AXES} per arm; "
                f"got widths {sorted(widths)}"
            )

    @property
    def k(self) -> int:
        """Number of arms."""
        return int(self.palms.stop - self.palms.start) // AXES

    def points(self, state: Array, place: slice) -> Array:
        """Points of a state in metres, (n, n_x) → (n, k, 3) float64."""
        flat = state[:, place].astype(np.float64) * self.scale[place] + self.offset[place]
        return np.asarray(flat.reshape(len(state), -1, AXES))

    def write(self, state: Array, place: slice, points: Array) -> None:
        """Put points (n, k, 3) in metres into a state (n, n_x), in place."""
        state[:, place] = (points.reshape(len(state), -1) - self.offset[place]) / self.scale[place]


class Outcome(NamedTuple):
    """What actions led to, given goals."""

    distance: Array  # (n, k) m
    boundary: Array  # (n, k) bool
    goal: Array  # (n, k) bool
    reward: Array  # (n, k)
    terminated: Array  # (n,) bool


def set_goals(view: GoalView, state: Array, goals: Array) -> None:
    """Ask for other goals (n, k, 3) [m] in states (n, n_x), in place: goals, and differences to the
    palms if there are any.
    """
    view.write(state, view.goals, goals)
    if view.difference is not None:
        view.write(state, view.difference, goals - view.points(state, view.palms))


def outcome(
    view: GoalView,
    reward: RewardFunction,
    *,
    palms: Array,
    goals: Array,
    collision: Array,
    instability: Array,
) -> Outcome:
    """Distances, flags, rewards and endings of n transitions that brought the palms (n, k, 3)
    there, for goals (n, k, 3).

    Rewards and endings are the task's: in the reach task κ overrides the rewards where every goal
    holds without collision or instability, and an episode ends on instability or when every goal
    holds (Algorithm 1), so `terminated` is recomputed with the goals.
    """
    distance = distances(palms, goals)
    boundary, goal = within(distance, boundary=view.boundary_radius, goal=view.goal_radius)
    rewards = reward(distance, boundary, goal, collision, instability)
    return Outcome(distance, boundary, goal, rewards, view.ended(goal, instability))


def draw_later(rng: np.random.Generator, now: Array, last: Array, horizon: int = 0) -> Array:
    """For each index, one drawn uniformly from itself to the last of its episode (the "future"
    strategy). All (n,) integers.

    With a horizon, at most that many indices are drawn from; 0 for all of them.
    """
    span = last - now + 1
    if horizon > 0:
        span = np.minimum(span, horizon)
    return np.asarray(now + (rng.random(len(now)) * span).astype(now.dtype))


def reorder(rng: np.random.Generator, count: int, places: Sequence[slice], *states: Array) -> None:
    """List the spheres of each row in an order of chance, in place, the same in all of these states
    (n, n_x).

    Args:
        rng: Chance.
        count: Number of spheres.
        places: Parts of a state that tell of one sphere after the other.
        states: The states.
    """
    order = rng.permuted(np.broadcast_to(np.arange(count), (len(states[0]), count)), axis=1)[
        :, :, None
    ]
    for state in states:
        for place in places:
            each = state[:, place].reshape(len(state), count, -1)
            state[:, place] = np.take_along_axis(each, order, axis=1).reshape(len(state), -1)


def value_bounds(
    reward: RewardFunction, *, k: int, gamma: float, farthest: float, ended: Ended = ended
) -> tuple[float, float]:
    """Least and greatest discounted return any policy can have.

    A return is a mixture of r/(1 - γ) for rewards that go on and of one reward that ends the
    episode, so its extremes are at one or the other. They are found by asking for the reward of
    every combination of flags at no distance and at the farthest.

    Args:
        reward: The reward.
        k: Number of arms.
        gamma: Discount, below 1.
        farthest: Greatest distance between palm and goal [m].
        ended: What ends an episode.
    """
    cases = np.array(list(product((False, True), repeat=2 * k + 3)))
    boundary, goal = cases[:, :k], cases[:, k : 2 * k]
    collision, instability, far = cases[:, 2 * k], cases[:, 2 * k + 1], cases[:, 2 * k + 2]
    distance = np.where(far, farthest, 0.0)[:, None] * np.ones(k)
    rewards = reward(distance, boundary, goal, collision, instability)
    ends = ended(goal, instability)
    going, ending = rewards[~ends] / (1 - gamma), rewards[ends]
    return float(min(going.min(), ending.min())), float(max(going.max(), ending.max()))
