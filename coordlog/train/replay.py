"""Batches of tensors drawn from logs, from live steps, or from both, some of them with goals in hindsight."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
import torch

from coordlog.episode import Array
from coordlog.errors import ConfigError
from coordlog.train.config import ReplayConfig
from coordlog.train.digrad import Batch
from coordlog.train.relabel import GoalView, RewardFunction, outcome, set_goals


class Arrays(NamedTuple):
    """A batch as arrays that stores write into, float32."""

    state: Array  # (B, n_x)
    action: Array  # (B, n_u)
    reward: Array  # (B, k)
    next_state: Array  # (B, n_x)
    terminated: Array  # (B, 1)

    def rows(self, part: slice) -> Arrays:
        """Views of some of the rows."""
        return Arrays(*(array[part] for array in self))


class Store(Protocol):
    """Transitions that can be drawn from by row number."""

    def __len__(self) -> int:
        """Number of transitions."""
        ...

    def draw(self, rng: np.random.Generator, size: int) -> Array:
        """Row numbers, uniform with replacement, (size,) int64."""
        ...

    def read(self, rows: Array, out: Arrays) -> None:
        """Write the transitions of these rows."""
        ...

    def later(self, rng: np.random.Generator, rows: Array) -> Array:
        """Next states (n, n_x) of a row drawn uniformly from each row to the last stored one of its episode."""
        ...

    def mishaps(self, rows: Array) -> tuple[Array, Array]:
        """Collision and instability of these rows, (n,) bool each."""
        ...

    @property
    def widths(self) -> tuple[int, int, int]:
        """n_x, n_u and k."""
        ...


class MixedReplay:
    """Half logs that are never evicted, half live steps (Ball et al. 2023, RLPD), or all of whichever there is."""

    def __init__(
        self,
        config: ReplayConfig,
        *,
        reward: RewardFunction,
        view: GoalView | None = None,
        logs: Store | None = None,
        live: Store | None = None,
        device: str = "cpu",
    ) -> None:
        """Draw from the stores given.

        Args:
            config: Sizes and shares.
            reward: The reward, for goals in hindsight.
            view: Where goals stand in a state; needed for hindsight.
            logs: Immutable transitions; the behaviour term applies to these.
            live: Transitions of the run itself.
            device: Where batches go.

        Raises:
            ConfigError: if there is no store, the stores differ in layout, or hindsight lacks a view.
        """
        stores = [store for store in (logs, live) if store is not None]
        if not stores:
            raise ConfigError("replay: expected logs, live steps or both, got neither")
        if len({store.widths for store in stores}) > 1:
            raise ConfigError(
                f"replay: logs have widths (n_x, n_u, k) = {stores[0].widths}, live steps {stores[1].widths}; train them apart"
            )
        if config.hindsight > 0 and view is None:
            raise ConfigError("replay.hindsight: expected to know where goals stand in the state; set it to 0 for this task")
        self._config, self._reward, self._view, self._logs, self._live = config, reward, view, logs, live
        self._device = torch.device(device)
        self._widths = stores[0].widths

    def sample(self, rng: np.random.Generator) -> Batch:
        """A batch: log transitions first, then live ones; in each part, those with goals in hindsight first."""
        size, logged = self._config.batch, self._logged()
        n_x, n_u, k = self._widths
        out = Arrays(*(np.empty((size, width), np.float32) for width in (n_x, n_u, k, n_x, 1)))
        if self._logs is not None and logged > 0:
            self._fill(rng, self._logs, out.rows(slice(0, logged)))
        if self._live is not None and logged < size:
            self._fill(rng, self._live, out.rows(slice(logged, size)))
        mark = torch.zeros(size, 1)
        mark[:logged] = 1
        tensors = (torch.from_numpy(array) for array in out)
        return Batch(*(tensor.to(self._device) for tensor in (*tensors, mark)))

    def _logged(self) -> int:
        """Number of log transitions in the next batch."""
        if self._logs is None:
            return 0
        if self._live is None or len(self._live) == 0:
            return self._config.batch
        return round(self._config.log_fraction * self._config.batch)

    def _fill(self, rng: np.random.Generator, store: Store, out: Arrays) -> None:
        rows = store.draw(rng, len(out.state))
        store.read(rows, out)
        count = round(self._config.hindsight * len(rows))
        if count > 0:
            assert self._view is not None
            relabel(
                self._view,
                self._reward,
                out.rows(slice(0, count)),
                goals=store.later(rng, rows[:count]),
                mishaps=store.mishaps(rows[:count]),
            )


def relabel(view: GoalView, reward: RewardFunction, batch: Arrays, *, goals: Array, mishaps: tuple[Array, Array]) -> None:
    """Ask n transitions for what was reached elsewhere, in place: goals, differences, rewards and endings.

    Args:
        view: Where goals stand.
        reward: The reward.
        batch: The transitions.
        goals: States (n, n_x) whose palms become the goals.
        mishaps: Collision and instability of the transitions, (n,) each, as logged.
    """
    wanted = view.points(goals, view.palms)
    set_goals(view, batch.state, wanted)
    set_goals(view, batch.next_state, wanted)
    palms = view.points(batch.next_state, view.palms)
    result = outcome(view, reward, palms=palms, goals=wanted, collision=mishaps[0], instability=mishaps[1])
    batch.reward[:] = result.reward
    batch.terminated[:, 0] = result.terminated
