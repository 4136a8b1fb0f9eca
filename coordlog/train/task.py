"""What training is told from outside: the task, a source of live steps, and what to do at the end
of an interval.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, Protocol

from coordlog.episode import Array, Json
from coordlog.policies.learned import Policy
from coordlog.tasks.reach.reward import ended
from coordlog.train.columns import Block
from coordlog.train.metrics import Event, Row
from coordlog.train.relabel import Ended, GoalView, RewardFunction, value_bounds


class Motion(NamedTuple):
    """Joint angles in a state, one per action in the order of actions, and how far an action moves
    them.
    """

    angles: slice
    stride: Array
    """Change of each entry in one step at action 1, (n_u,)."""


@dataclass(frozen=True, eq=False)
class Task:
    """One robot in one scene, as numbers: widths, which arm each action serves, and the reward."""

    n_x: int
    """Width of the state."""
    n_u: int
    """Number of actions."""
    arms: Mapping[str, Sequence[int]]
    """Action indices of each arm, shared ones in each of theirs.

    One critic head per arm, in this order.
    """
    reward: RewardFunction | None
    """The paper's reward with its constants bound; None for the rewards that were logged."""
    farthest: float = 0.0
    """Greatest distance between a palm and its goal [m], for the bounds of the return."""
    rewards: tuple[float, float] = (0.0, 0.0)
    """Least and greatest reward that was logged, where these are learnt from."""
    view: GoalView | None = None
    """Where palms and goals stand in the state; without it there are no goals in hindsight."""
    motion: Motion | None = None
    """What an action does to the state's joint angles.

    Without it, what was done is imitated as it was done.
    """
    ended: Ended = ended
    """The task's rule of what ends an episode."""
    spheres: int = 0
    """Number of spheres that the state tells of."""
    listed: Sequence[slice] = ()
    """Where it tells of one sphere after the other; their order means nothing."""

    @property
    def widths(self) -> tuple[int, int, int]:
        """n_x, n_u and k."""
        return self.n_x, self.n_u, len(self.arms)

    def bounds(self, gamma: float) -> tuple[float, float]:
        """Least and greatest return any policy can have, discounted by γ."""
        if self.reward is None:
            low, high = self.rewards
            return min(low, low / (1 - gamma)), max(high, high / (1 - gamma))
        return value_bounds(
            self.reward, k=len(self.arms), gamma=gamma, farthest=self.farthest, ended=self.ended
        )


class LiveSource(Protocol):
    """Simulations that are stepped together.

    Their steps follow from their own state and the policy alone.
    """

    lanes: int
    """Number of simulations."""

    def collect(self, steps: int, policy: Callable[[Array], Array]) -> Block:
        """Step every simulation `steps` times with actions from the policy ((lanes, n_x) → (lanes,
        n_u)), starting episodes as others end. Called from another thread, never twice at once.
        """
        ...

    def summary(self) -> Mapping[str, float]:
        """What happened since the last call (episodes, successes, …), for a row of metrics."""
        ...

    def state(self) -> dict[str, Array]:
        """All that the next `collect` and `summary` depend on, as arrays by name."""
        ...

    def load_state(self, arrays: Mapping[str, Array]) -> None:
        """Continue from a `state()`."""
        ...


@dataclass(frozen=True)
class Hooks:
    """What the loop calls between two rounds."""

    evaluate: Callable[[Policy, int], Mapping[str, float | str]] | None = None
    """Policy and number of updates to figures of merit on held-out goals, and words about them."""
    rank: tuple[str, ...] = ("clean", "score")
    """Figures by which the best policy is kept, greater is better, the first decides."""
    on_row: Callable[[Row], None] | None = None
    """Called with each row of metrics: progress bars, event files."""
    should_stop: Callable[[], bool] | None = None
    """Asked at least every few dozen updates; the run then saves itself and returns."""
    about: Json = field(default_factory=dict)
    """JSON-able words that every policy file of the run carries."""


class Outcome(NamedTuple):
    """How a run ended."""

    ending: Literal["finished", "stopped", "diverged"]
    updates: int
    steps: int
    best: Mapping[str, float] | None
    """Evaluation of the best policy, if there was one."""
    event: Event | None
    """What went wrong, if it diverged."""
