"""A two-armed toy in NumPy: each palm is a shared base plus a hand of its own, and every action is
a velocity."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping

import numpy as np

from coordlog.episode import Array
from coordlog.policies.checkpoint import generator_from_json, generator_to_json
from coordlog.spec import LEARNT, names
from coordlog.tasks.config import EnvConfig, RewardConfig
from coordlog.tasks.reach.reward import Flags, rewards
from coordlog.train.columns import Block, Columns
from coordlog.train.relabel import GoalView
from coordlog.train.task import Task

SPEED = 0.2
RADIUS, BOUNDARY = 0.15, 0.4
ARMS = {"left": [0, 1, 2, 3, 4, 5], "right": [0, 1, 2, 6, 7, 8]}
N_U, N_X = 9, 18
ENV = EnvConfig(goal_radius=RADIUS, boundary_radius=BOUNDARY)
CONSTANTS = RewardConfig()


def reward(
    distance: Array, boundary: Array, goal: Array, collision: Array, instability: Array
) -> Array:
    return rewards(distance, Flags(boundary, goal, collision, instability), CONSTANTS)


def view() -> GoalView:
    offset, scale = np.zeros(N_X), np.ones(N_X)
    offset[:12], scale[:12], scale[12:] = 0.1, 1.5, 0.7
    return GoalView(slice(0, 6), slice(6, 12), slice(12, 18), offset, scale, RADIUS, BOUNDARY)


def task() -> Task:
    return Task(N_X, N_U, ARMS, reward, farthest=4.0, view=view())


def observed(palms: Array, goals: Array) -> Array:
    """Palms and goals (n, 2, 3) as states."""
    state, places = np.zeros((len(palms), N_X), np.float32), view()
    for place, points in (
        (places.palms, palms),
        (places.goals, goals),
        (places.difference, goals - palms),
    ):
        places.write(state, place, points)
    return state


class ToySource:
    """Lanes of toy episodes of at most `limit` steps."""

    def __init__(self, lanes: int = 8, *, seed: int = 0, limit: int = 20) -> None:
        self.lanes, self.limit = lanes, limit
        self._rng = np.random.default_rng(seed)
        self.base, self.hands, self.goals = (
            np.zeros((lanes, 3)),
            np.zeros((lanes, 2, 3)),
            np.zeros((lanes, 2, 3)),
        )
        self.episode, self.step, self.started = (
            np.zeros(lanes, np.int64),
            np.zeros(lanes, np.int64),
            0,
        )
        self.ended, self.won = 0, 0
        self._begin(np.arange(lanes))

    def _begin(self, ids: Array) -> None:
        self.base[ids], self.hands[ids] = 0, 0
        self.goals[ids] = self._rng.uniform(-0.8, 0.8, (len(ids), 2, 3))
        self.episode[ids] = self.started + np.arange(len(ids))
        self.step[ids] = 0
        self.started += len(ids)

    @property
    def palms(self) -> Array:
        return self.base[:, None] + self.hands

    def collect(self, steps: int, policy: Callable[[Array], Array]) -> Block:
        return Block(
            *(
                np.stack(column)
                for column in zip(*(self._advance(policy) for _ in range(steps)), strict=True)
            )
        )

    def _advance(self, policy: Callable[[Array], Array]) -> tuple[Array, ...]:
        state = observed(self.palms, self.goals)
        action = policy(state)
        self.base += SPEED * action[:, :3]
        self.hands += SPEED * action[:, 3:].reshape(-1, 2, 3)
        distance = np.linalg.norm(self.goals - self.palms, axis=2)
        boundary, goal = distance < BOUNDARY, distance < RADIUS
        collision, instability = self.base[:, 2] < -1.2, np.abs(self.base).max(axis=1) > 1.5
        terminated = instability | goal.all(axis=1)
        after = observed(self.palms, self.goals)
        columns = (
            state,
            action,
            after,
            distance,
            boundary,
            goal,
            collision,
            instability,
            terminated,
            self.episode.copy(),
            self.step.copy(),
        )
        self.step += 1
        over = np.flatnonzero(terminated | (self.step >= self.limit))
        self.ended += len(over)
        self.won += int((goal.all(axis=1) & ~instability)[over].sum())
        self._begin(over)
        return columns

    def summary(self) -> Mapping[str, float]:
        said = {"episodes": float(self.ended), "success": self.won / max(1, self.ended)}
        self.ended, self.won = 0, 0
        return said

    def state(self) -> dict[str, Array]:
        names = ("base", "hands", "goals", "episode", "step")
        counts = np.array([self.started, self.ended, self.won])
        rng = np.frombuffer(json.dumps(generator_to_json(self._rng)).encode(), np.uint8)
        return {**{name: getattr(self, name) for name in names}, "counts": counts, "rng": rng}

    def load_state(self, arrays: Mapping[str, Array]) -> None:
        for name in ("base", "hands", "goals", "episode", "step"):
            getattr(self, name)[:] = arrays[name]
        self.started, self.ended, self.won = (int(count) for count in arrays["counts"])
        self._rng = generator_from_json(json.loads(arrays["rng"].tobytes()))


def expert(state: Array) -> Array:
    """Half of the way with the base (the mean of both gaps), the rest with each hand."""
    gap = view().points(state, view().difference or slice(0))
    base = gap.mean(axis=1) / 2
    hands = (gap - base[:, None]).reshape(-1, 6)
    return np.clip(np.concatenate((base, hands), axis=1) / SPEED, -1, 1).astype(np.float32)


def success(policy: Callable[[Array], Array], *, lanes: int = 64, limit: int = 20) -> float:
    """Share of fresh episodes in which both palms reach their goals."""
    source = ToySource(lanes, seed=10_000, limit=limit)
    block = source.collect(limit, policy)
    first = block.episode < lanes
    return float((block.goal.all(axis=2) & ~block.instability & first).any(axis=0).mean())


def logs(episodes: int = 40, *, seed: int = 1, limit: int = 20, noise: float = 0.5) -> Columns:
    """Whole episodes of the expert with noise, as columns."""
    rng = np.random.default_rng(seed)
    source = ToySource(episodes, seed=seed, limit=limit)
    block = source.collect(
        limit,
        lambda state: np.clip(
            expert(state) + noise * rng.standard_normal((episodes, N_U)), -1, 1
        ).astype(np.float32),
    )
    parts: dict[str, list[Array]] = {}
    length = []
    for lane in range(episodes):
        steps = int((block.episode[:, lane] == lane).sum())
        length.append(steps)
        for name in names(LEARNT):
            parts.setdefault(name, []).append(getattr(block, name)[:steps, lane])
        parts.setdefault("final", []).append(block.next_state[steps - 1, lane][None])
    whole = {name: np.concatenate(arrays) for name, arrays in parts.items()}
    return Columns(whole, final=whole.pop("final"), length=np.array(length))
