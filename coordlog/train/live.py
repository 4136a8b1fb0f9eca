"""Live simulations as a source of transitions. They run in `rollout`, like everything; an
environment that records, records them.

What a resumed run needs of the simulations is remembered as what was asked of them: each episode
under way is an index and its actions so far, and doing the same again gives the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import count

import numpy as np

from coordlog.contracts import Env, Outcome
from coordlog.episode import Array
from coordlog.sim.rollout import rollout
from coordlog.sim.scoring import Score, Scoreboard, figures
from coordlog.train.columns import Block

FLAGS = 6
"""Scalars of a Score in a row, before its values per arm."""


class _Actor:
    """The policy of the moment, as `rollout` wants one.

    Remembers what it was asked and what it answered.
    """

    def __init__(self, lanes: int, first: int, stride: int) -> None:
        self._first, self._stride = first, stride
        self.choose: Callable[[Array], Array] | None = None
        self.state: Array = np.zeros(0)
        self.action: Array = np.zeros(0)
        self.episode = np.full(lanes, -1)
        self.started = 0

    def begin(self, ids: Array, state: Array, rngs: list[np.random.Generator]) -> None:
        """Number the episodes as they start."""
        self.episode[ids] = self._first + self._stride * (self.started + np.arange(len(ids)))
        self.started += len(ids)

    def act(self, ids: Array, state: Array) -> Array:
        """What the policy says."""
        assert self.choose is not None, "collect() sets the policy"
        self.state, self.action = state.copy(), self.choose(state)
        return self.action

    def waiting(self) -> Iterator[int]:
        """Indices of the episodes that have not been started."""
        return count(self._first + self._stride * self.started, self._stride)

    def skip_to(self, episode: Array) -> None:
        """Number on from episodes that have been started."""
        self.episode = episode.copy()
        self.started = (int(episode.max()) - self._first) // self._stride + 1


class Simulations:
    """All simulations of an environment, one episode after another; a `task.LiveSource`."""

    def __init__(
        self,
        env: Env,
        *,
        seed: int,
        k: int,
        farthest: float,
        first: int = 0,
        stride: int = 1,
    ) -> None:
        """Start nothing yet.

        Args:
            env: Where to run; its number of simulations is the number of lanes.
            seed: Seed of the problems; they are of the split "train".
            k: Number of arms.
            farthest: Distance that a diverged step counts as [m].
            first: Index of the first episode.
            stride: From one index to the next.
        """
        self.lanes = env.n
        self._env, self._seed, self._k, self._farthest = env, seed, k, farthest
        self._actor, self._board = _Actor(env.n, first, stride), Scoreboard(env.n, k)
        self._ended = 0
        self._actions: list[list[Array]] = [[] for _ in range(env.n)]
        self._loop = self._start(running=None)

    def collect(self, steps: int, policy: Callable[[Array], Array]) -> Block:
        """Step every simulation `steps` times; see `task.LiveSource`."""
        self._actor.choose = policy
        rows = [self._step() for _ in range(steps)]
        return Block(*(np.stack(column) for column in zip(*rows, strict=True)))

    def summary(self) -> Mapping[str, float]:
        """Figures of the episodes that ended since the last call, and how many ever did."""
        fresh, self._board.scores = self._board.scores, []
        self._ended += len(fresh)
        return {"episodes_total": float(self._ended), **figures(fresh)}

    def state(self) -> dict[str, Array]:
        """Episodes under way as indices and actions so far, and the scores that no summary has told
        of.
        """
        flat = [action for actions in self._actions for action in actions]
        fresh = self._board.scores
        return {
            "episode": self._actor.episode.copy(),
            "length": np.array([len(actions) for actions in self._actions]),
            "action": np.stack(flat)
            if flat
            else np.zeros((0, 0), np.float32),  # none where every episode has just ended
            "ended": np.array([self._ended]),
            "scores": np.array([to_row(score) for score in fresh], dtype=np.float64).reshape(
                len(fresh), FLAGS + 2 * self._k
            ),
        }

    def load_state(self, arrays: Mapping[str, Array]) -> None:
        """Do again what led to a `state()`."""
        if (arrays["episode"] < 0).any():  # it was taken before the first step
            return
        lanes = np.flatnonzero(arrays["length"] > 0)
        problems = [
            self._env.problem(seed=self._seed, split="train", index=int(index))
            for index in arrays["episode"][lanes]
        ]
        if len(lanes):
            self._env.reset(lanes, problems)
        ends = np.cumsum(arrays["length"])
        self._actions = [
            list(arrays["action"][end - length : end])
            for end, length in zip(ends, arrays["length"], strict=True)
        ]
        self._board = Scoreboard(self.lanes, self._k)
        for step in range(int(arrays["length"].max())):
            ids = np.flatnonzero(arrays["length"] > step)
            self._board.add(
                ids, self._env.step(np.stack([self._actions[lane][step] for lane in ids]), ids)
            )
        self._ended = int(arrays["ended"][0])
        self._board.scores = [from_row(row, self._k) for row in arrays["scores"]]
        self._actor.skip_to(arrays["episode"])
        self._loop = self._start(
            running=lanes
        )  # the other lanes had ended their episode; they start their next one, as they would have

    def _start(self, *, running: Array | None) -> Iterator[tuple[Array, Outcome]]:
        return rollout(
            self._env, self._actor, self._actor.waiting(), seed=self._seed, running=running
        )

    def _step(self) -> tuple[Array, ...]:
        """One step of all lanes, as a row of each column of a Block."""
        ids, outcome = next(self._loop)
        actor, distance = self._actor, outcome.distance
        episode = actor.episode.copy()
        step = np.array([len(actions) for actions in self._actions])
        next_state, lost = self._env.state.copy(), outcome.diverged
        if lost.any():  # the state after it is no number: learnt from as a fall on the spot
            next_state[lost], distance = (
                actor.state[lost],
                np.where(lost[:, None], self._farthest, distance),
            )
        self._board.add(ids, outcome)
        over = outcome.terminated | outcome.truncated | lost
        for lane in ids:
            self._actions[lane] = [] if over[lane] else [*self._actions[lane], actor.action[lane]]
        near = outcome.boundary & ~lost[:, None], outcome.goal & ~lost[:, None]
        flags = (
            *near,
            outcome.collision & ~lost,
            outcome.instability | lost,
            outcome.terminated | lost,
        )
        return (actor.state, actor.action, next_state, distance, *flags, episode, step)


def to_row(score: Score) -> list[float]:
    """A score as numbers."""
    head = (score.length, score.success, score.clean, score.collided, score.fell, score.diverged)
    return [*map(float, head), *score.distance, *map(float, score.arrival)]


def from_row(row: Array, k: int) -> Score:
    """The score of `to_row`."""
    length, success, clean, collided, fell, diverged = row[:FLAGS]
    distance, arrival = (
        tuple(row[FLAGS : FLAGS + k].tolist()),
        tuple(int(step) for step in row[FLAGS + k :]),
    )
    return Score(
        int(length),
        bool(success),
        bool(clean),
        bool(collided),
        bool(fell),
        distance,
        arrival,
        bool(diverged),
    )
