"""How episodes went: success, clean success, score, falls, counted while they run."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from coordlog.contracts import Env, Outcome, Policy
from coordlog.episode import Array
from coordlog.sim.rollout import rollout

NEAREST = 1e-4
"""e₁ + e₂ is clamped to this [m], so that a score stays finite."""


class Score(NamedTuple):
    """One episode that ended."""

    length: int
    success: bool
    """As the task means it (tasks/progress.py); reach: every palm at its goal at the same step."""
    clean: bool
    """Success, and nothing went wrong in the whole episode."""
    collided: bool
    fell: bool
    distance: tuple[float, ...]
    """Palm to goal of each arm at the last step [m]."""
    arrival: tuple[int, ...]
    """Step at which each arm first was at its goal; -1 for one that never was."""
    diverged: bool
    """The physics broke down: counted apart, and in no rate."""

    @property
    def score(self) -> float:
        """-ln(e₁ + e₂) in metres, at the last step (the paper's §V-B)."""
        return -math.log(max(sum(self.distance), NEAREST))


class Scoreboard:
    """Scores of the episodes that run in N slots; feed it every step that `rollout` yields."""

    def __init__(self, n: int, k: int) -> None:
        self.scores: list[Score] = []
        self.touches: Counter[tuple[int, int]] = Counter()
        """Pairs of geom ids that touched first in an episode, and in how many. Of several within
        one control step, the one that was deepest first.
        """
        self._length = np.zeros(n, dtype=np.int64)
        self._collided = np.zeros(n, dtype=bool)
        self._arrival = np.full((n, k), -1)
        self._distance = np.zeros((n, k))

    def add(self, ids: Array, outcome: Outcome) -> None:
        """Count one step of the slots `ids`; episodes that end with it are appended to `scores`."""
        arrived = (self._arrival[ids] < 0) & outcome.goal
        self._arrival[ids] = np.where(arrived, self._length[ids, None], self._arrival[ids])
        self._length[ids] += 1
        for row in np.flatnonzero(outcome.collision & ~self._collided[ids]):
            contacts = outcome.contacts[row]
            first = contacts[contacts["substep"].argmin()]
            self.touches[int(first["geom1"]), int(first["geom2"])] += 1
        self._collided[ids] |= outcome.collision
        for row in np.flatnonzero(outcome.terminated | outcome.truncated | outcome.diverged):
            self.scores.append(self._ended(int(ids[row]), outcome, int(row)))

    def _ended(self, slot: int, outcome: Outcome, row: int) -> Score:
        diverged, fell = bool(outcome.diverged[row]), bool(outcome.instability[row])
        collided = bool(self._collided[slot])
        score = Score(
            length=int(self._length[slot]),
            success=bool(outcome.success[row]) and not diverged,
            clean=bool(outcome.clean[row]) and not diverged,
            collided=collided,
            fell=fell,
            distance=tuple(outcome.distance[row].tolist()),
            arrival=tuple(self._arrival[slot].tolist()),
            diverged=diverged,
        )
        self._length[slot], self._collided[slot], self._arrival[slot] = 0, False, -1
        return score


def figures(scores: Sequence[Score]) -> dict[str, float]:
    """Figures of merit over episodes; rates are shares of the episodes that did not diverge, and
    all are 0 for none.

    Keys: episodes, diverged, success, clean, collisions, falls, score (mean), error (median e₁ +
    e₂, m), length (mean).
    """
    sound = [score for score in scores if not score.diverged]

    def mean(values: list[float]) -> float:
        return sum(values) / len(values) if values else 0.0

    return {
        "episodes": len(sound),
        "diverged": len(scores) - len(sound),
        "success": mean([score.success for score in sound]),
        "clean": mean([score.clean for score in sound]),
        "collisions": mean([score.collided for score in sound]),
        "falls": mean([score.fell for score in sound]),
        "score": mean([score.score for score in sound]),
        "error": float(np.median([sum(score.distance) for score in sound])) if sound else 0.0,
        "length": mean([score.length for score in sound]),
    }


def evaluate(
    env: Env, policy: Policy, *, episodes: int, k: int, seed: int, split: str = "test"
) -> list[Score]:
    """Run a policy on the problems 0 … episodes - 1 of a seed and split, and score them, in the
    order they end.
    """
    return judged(env, policy, episodes=episodes, k=k, seed=seed, split=split).scores


def judged(
    env: Env, policy: Policy, *, episodes: int, k: int, seed: int, split: str = "test"
) -> Scoreboard:
    """As `evaluate`, with what was touched first."""
    board = Scoreboard(env.n, k)
    for ids, outcome in rollout(env, policy, range(episodes), seed=seed, split=split):
        board.add(ids, outcome)
    return board
