"""Batches of tensors drawn from logs, from live steps, or from both, some of them with goals in
hindsight.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch

from coordlog.episode import Array
from coordlog.errors import ConfigError
from coordlog.train.config import ReplayConfig
from coordlog.train.digrad import Batch, Examples
from coordlog.train.relabel import GoalView, RewardFunction, outcome, reorder, set_goals
from coordlog.train.returns import Return, n_step
from coordlog.train.task import Motion, Task
from coordlog.train.transitions import Transitions


class Arrays(NamedTuple):
    """A batch as arrays that are written into, float32."""

    state: Array  # (B, n_x)
    action: Array  # (B, n_u)
    reward: Array  # (B, k)
    next_state: Array  # (B, n_x)
    discount: Array  # (B, 1)
    imitated: Array  # (B, 1)
    wanted: Array  # (B, n_u)

    @classmethod
    def empty(cls, size: int, widths: tuple[int, int, int]) -> Arrays:
        """Room for `size` transitions of widths n_x, n_u and k."""
        n_x, n_u, k = widths
        return cls(
            *(np.empty((size, width), np.float32) for width in (n_x, n_u, k, n_x, 1, 1, n_u))
        )

    def rows(self, part: slice) -> Arrays:
        """Views of some of the rows."""
        return Arrays(*(array[part] for array in self))


class Horizon(NamedTuple):
    """How returns over several steps are formed."""

    n: int
    gamma: float
    cut: bool = False
    """End them before a mishap that a later action led to."""

    def of(self, store: Transitions, rows: Array) -> tuple[Array, Array]:
        """Rows of the steps from each row on, (size, n), and which of them count."""
        index, within = store.ahead(rows, self.n)
        if self.cut and self.n > 1:
            later = index[:, 1:]
            mishap = store.take("collision", later) | store.take("instability", later)
            within = within.copy()
            within[:, 1:] &= ~np.logical_or.accumulate(mishap, axis=1)
        return index, within


def transitions(store: Transitions, rows: Array, out: Arrays, horizon: Horizon) -> None:
    """Write transitions over n steps as they were; `imitated` and `wanted` are left alone."""
    index, within = horizon.of(store, rows)
    found = n_step(
        store.take("reward", index), store.take("terminated", index), within, gamma=horizon.gamma
    )
    store.take("state", rows, out.state)
    store.take("action", rows, out.action)
    _lead(store, index, found, out)


class Asked(NamedTuple):
    """What transitions are to be learnt from as if it had been wanted."""

    goals: Array  # (B, k, 3) m
    view: GoalView
    reward: RewardFunction


def in_hindsight(
    store: Transitions, rows: Array, out: Arrays, asked: Asked, horizon: Horizon
) -> None:
    """Write transitions over n steps as if other goals had been asked for; `imitated` and `wanted`
    are left alone.

    Goals, differences, rewards and endings are those of the new goals; collision and instability
    are as stored.
    """
    goals, view, reward = asked
    index, within = horizon.of(store, rows)
    every = index.ravel()
    palms = view.points(store.next_state(every), view.palms)
    mishaps = {name: store.take(name, every) for name in ("collision", "instability")}
    result = outcome(
        view, reward, palms=palms, goals=np.repeat(goals, horizon.n, axis=0), **mishaps
    )
    found = n_step(
        result.reward.reshape(*index.shape, -1),
        result.terminated.reshape(index.shape),
        within,
        gamma=horizon.gamma,
    )
    store.take("state", rows, out.state)
    store.take("action", rows, out.action)
    _lead(store, index, found, out)
    set_goals(view, out.state, goals)
    set_goals(view, out.next_state, goals)


def moved(motion: Motion, state: Array, reached: Array, steps: Array) -> Array:
    """The steady action whose motion leads from states to states some steps later, (B, n_u): what
    was done without its detours.

    Pushing against a stop moves nothing, and so is not imitated.
    """
    distance = reached[:, motion.angles] - state[:, motion.angles]
    return np.asarray(np.clip(distance / (motion.stride * steps[:, None]), -1.0, 1.0))


def _lead(store: Transitions, index: Array, found: Return, out: Arrays) -> None:
    out.reward[:], out.discount[:, 0] = found.reward, found.discount
    store.next_state(
        index[np.arange(len(index)), found.last] if index.shape[1] > 1 else index[:, 0],
        out.next_state,
    )


class MixedReplay:
    """Half logs that are never evicted, half live steps (Ball et al. 2023, RLPD), or all of
    whichever there is.
    """

    def __init__(
        self,
        config: ReplayConfig,
        task: Task,
        *,
        gamma: float,
        logs: Transitions | None = None,
        live: Transitions | None = None,
        device: str = "cpu",
    ) -> None:
        """Draw from the stores given.

        Args:
            config: Sizes and shares.
            task: The reward, and where goals and spheres stand in a state.
            gamma: Discount per step.
            logs: Immutable transitions; the behaviour term applies to these.
            live: Transitions of the run itself; it applies to those in hindsight, times
                `config.imitation`.
            device: Where batches go.

        Raises:
            ConfigError: if there is no store, the stores differ in layout, or the task has no goals
                for hindsight.
        """
        stores = [store for store in (logs, live) if store is not None]
        if not stores:
            raise ConfigError("replay: expected logs, live steps or both, got neither")
        if len({store.widths for store in stores}) > 1:
            raise ConfigError(
                f"replay: logs have widths (n_x, n_u, k) = {stores[0].widths}, live steps "
                f"{stores[1].widths}; train them apart"
            )
        for name, store in (("hindsight", live), ("log_hindsight", logs)):
            if store is not None and getattr(config, name) > 0 and task.view is None:
                raise ConfigError(
                    f"replay.{name}: expected to know where goals stand in the state; set it to 0 "
                    "for this task"
                )
        self._config, self._task, self._horizon = (
            config,
            task,
            Horizon(config.n_step, gamma, config.cut),
        )
        self._logs, self._live, self._device, self._widths = (
            logs,
            live,
            torch.device(device),
            stores[0].widths,
        )

    def sample(self, rng: np.random.Generator) -> Batch:
        """A batch: log transitions first, then live ones.

        In each part, those with goals in hindsight first.
        """
        size, logged = self._config.batch, self._logged()
        out = Arrays.empty(size, self._widths)
        if self._logs is not None and logged > 0:
            self._fill(
                rng,
                self._logs,
                out.rows(slice(0, logged)),
                share=self._config.log_hindsight,
                far=0.0,
                imitation=(1.0, 1.0),
            )
        if self._live is not None and logged < size:
            live = out.rows(slice(logged, size))
            config = self._config
            self._fill(
                rng,
                self._live,
                live,
                share=config.hindsight,
                far=config.far,
                imitation=(config.imitation, 0.0),
            )
        if self._config.reorder and self._task.spheres:
            reorder(rng, self._task.spheres, self._task.listed, out.state, out.next_state)
        return Batch(*(torch.from_numpy(array).to(self._device) for array in out))

    def examples(self, rng: np.random.Generator) -> Examples:
        """What was done in logs, as it was done; what something went wrong soon after weighs 0."""
        assert self._logs is not None
        rows = self._logs.draw(rng, self._config.batch)
        state = np.array(self._logs.take("state", rows))
        if self._config.reorder and self._task.spheres:
            reorder(rng, self._task.spheres, self._task.listed, state)
        clean = self._logs.clean(rows, self._config.horizon)[:, None].astype(np.float32)
        arrays = (state, np.array(self._logs.take("action", rows)), clean)
        return Examples(*(torch.from_numpy(array).to(self._device) for array in arrays))

    def _logged(self) -> int:
        """Number of log transitions in the next batch."""
        if self._logs is None:
            return 0
        if self._live is None or len(self._live) == 0:
            return self._config.batch
        return round(self._config.log_fraction * self._config.batch)

    def _fill(
        self,
        rng: np.random.Generator,
        store: Transitions,
        out: Arrays,
        *,
        share: float,
        far: float,
        imitation: tuple[float, float],
    ) -> None:
        """A part of a batch, a share of it in hindsight, and of that a share `far`; `imitation`
        weighs the behaviour term in hindsight and as it was, where nothing went wrong soon after.
        """
        config = self._config
        rows = store.draw(rng, len(out.state))
        count = round(share * len(rows))
        if count > 0:
            view, reward = self._task.view, self._task.reward
            assert view is not None
            assert reward is not None  # a task with goals has one
            then, steps = store.later(rng, rows[:count], config.horizon)
            distant = round(far * count)
            if distant > 0:
                then[:distant], steps[:distant] = store.later(rng, rows[:distant], 0)
            reached = store.next_state(then)
            part, asked = (
                out.rows(slice(0, count)),
                Asked(view.points(reached, view.palms), view, reward),
            )
            in_hindsight(store, rows[:count], part, asked, self._horizon)
            part.wanted[:] = (
                part.action
                if self._task.motion is None
                else moved(self._task.motion, part.state, reached, steps)
            )
        if count < len(rows):
            part = out.rows(slice(count, None))
            transitions(store, rows[count:], part, self._horizon)
            part.wanted[:] = part.action
        out.imitated[:count, 0], out.imitated[count:, 0] = imitation
        out.imitated[: round(far * count), 0] = 0.0
        if any(imitation):
            out.imitated[:, 0] *= store.clean(rows, config.horizon)
