"""A policy on held-out problems, and all that can be said about how it did."""

from __future__ import annotations

from time import process_time
from typing import Any, NamedTuple

import numpy as np

from coordlog.contracts import Policy
from coordlog.episode import Array
from coordlog.sim.env import BatchEnv
from coordlog.sim.rollout import rollout
from coordlog.sim.scoring import Score, Scoreboard
from experiments.nearest import Nearest
from experiments.stats import rate, spread

SEED = 1
"""Problems are those of this seed and the split "test". Training never draws from "test"; choosing
the best policy of a run looks at seed 0 of it, so the results are on another."""
SPLIT = "test"
TIMED = 10
"""Episodes over which decisions are timed."""


class Run(NamedTuple):
    """Scores of the episodes in the order they ended, and how close each came to an obstacle [m]
    (inf without obstacles).
    """

    scores: list[Score]
    clearance: list[float]


def run(env: BatchEnv, policy: Policy, *, episodes: int, seed: int = SEED) -> Run:
    """Run a policy on the first problems of the held-out split."""
    board, nearest = Scoreboard(env.n, env.layout.k), Nearest(env)
    least = np.full(env.n, np.inf)
    clearance: list[float] = []
    for ids, outcome in rollout(env, policy, range(episodes), seed=seed, split=SPLIT):
        if nearest.known:
            for row, sim in enumerate(ids.tolist()):
                least[sim] = min(
                    least[sim],
                    nearest.of(sim) if not outcome.diverged[row] else np.inf,
                    _touched(env, outcome, row),
                )
        board.add(ids, outcome)
        over = ids[outcome.terminated | outcome.truncated | outcome.diverged]
        clearance += least[over].tolist()
        least[over] = np.inf
    return Run(board.scores, clearance)


def _touched(env: BatchEnv, outcome: Any, row: int) -> float:
    """Depth of contacts with obstacles during the step, negative: what passed between two control
    steps counts too.
    """
    rows = outcome.contacts[row]
    solid = {
        *env.task.sphere_geoms,
        *(env.task.model.geom(panel.name).id for panel in env.scene.panels),
    }
    depths = [
        float(each["depth"])
        for each in rows
        if int(each["geom1"]) in solid or int(each["geom2"]) in solid
    ]
    return -max(depths, default=-np.inf)


def figures(found: Run) -> dict[str, Any]:
    """Rates with intervals and percentiles; episodes whose physics broke down count as failures."""
    scores = found.scores
    n, sound = len(scores), [score for score in scores if not score.diverged]
    won = [score for score in scores if score.success]

    def share(name: str) -> dict[str, Any]:
        return rate(sum(bool(getattr(score, name)) for score in scores), n)

    errors = [sum(score.distance) for score in sound]
    return {
        "success": share("success"),
        "clean": share("clean"),
        "collisions": share("collided"),
        "falls": share("fell"),
        "diverged": n - len(sound),
        "error": spread(errors, median=50, p95=95),
        "score": {"mean": float(np.mean([score.score for score in sound]))} if sound else None,
        "clearance": spread(found.clearance, least=0, p05=5, median=50),
        "steps": spread([score.length for score in won], median=50, p95=95),
        "apart": spread(
            [max(score.arrival) - min(score.arrival) for score in won], median=50, p95=95
        ),
    }


class Timed:
    """A policy, and the processor time of its calls [s]."""

    def __init__(self, policy: Policy) -> None:
        self._policy = policy
        self.begun: list[float] = []
        self.acted: list[float] = []

    def begin(self, ids: Array, state: Array, rngs: list[np.random.Generator]) -> None:
        """Begin, timed."""
        began = process_time()
        self._policy.begin(ids, state, rngs)
        self.begun.append(process_time() - began)

    def act(self, ids: Array, state: Array) -> Array:
        """Act, timed."""
        began = process_time()
        action = self._policy.act(ids, state)
        self.acted.append(process_time() - began)
        return action


def decisions(
    env: BatchEnv, policy: Policy, *, episodes: int = TIMED, seed: int = SEED
) -> dict[str, Any]:
    """Processor time of one decision for one state, on one core, and of what comes before the first
    one [s].
    """
    timed = Timed(policy)
    for _ in rollout(env, timed, range(episodes), seed=seed, split=SPLIT):
        pass
    return {
        "act": spread(timed.acted, median=50, p95=95),
        "begin": spread(timed.begun, median=50, p95=95),
        "calls": len(timed.acted),
        "control_period": env.task.config.control_period,
    }
