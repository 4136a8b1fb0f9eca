"""The training loop: updates from logs, from live steps, or from both; metrics, evaluations,
checkpoints, exact resume.

Live, the loop is a pipeline of two stages. While the updates on blocks ≤ n run, block n + 1 is
simulated on another thread with the actor as it was before those updates; then the two meet.
Nothing depends on which stage is faster, so running them one after the other gives the same bits.
Between two rounds nothing is under way: that is when metrics, evaluations and checkpoints happen.
"""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from coordlog.episode import Array
from coordlog.errors import ConfigError, FormatError, SpecError, StorageError
from coordlog.policies.checkpoint import (
    generator_from_json,
    generator_to_json,
    load_arrays,
    save_arrays,
    under,
)
from coordlog.policies.learned import Policy
from coordlog.train.budget import Budget
from coordlog.train.columns import Block, Columns
from coordlog.train.digrad import Learner
from coordlog.train.exploration import Exploring, Noise
from coordlog.train.gradients import gradient_mask
from coordlog.train.metrics import Event, MetricsLog, Row, Tally, Watch
from coordlog.train.networks import Actor
from coordlog.train.replay import MixedReplay
from coordlog.train.settings import Settings, refuse_changes
from coordlog.train.stream import Stream
from coordlog.train.task import Hooks, LiveSource, Outcome, Task
from coordlog.train.transitions import Transitions

KIND = "coordlog checkpoint"


class Trainer:
    """One run in one folder: `metrics.jsonl`, `checkpoint.safetensors` and `buffer/`,
    `policy.safetensors`, `best.safetensors`.
    """

    def __init__(
        self,
        task: Task,
        settings: Settings,
        *,
        folder: Path,
        logs: Columns | Stream | None = None,
        source: LiveSource | None = None,
        hooks: Hooks | None = None,
        device: str = "cpu",
    ) -> None:
        """Put the parts of a run together; nothing is written yet.

        Args:
            task: Widths, arms and reward.
            settings: All constants.
            folder: Where the run's files go.
            logs: Logged transitions, if any; or a stream of them.
            source: Live simulations, if any.
            hooks: Evaluation, progress and stop, and what policies say of the run.
            device: Where the networks live.

        Raises:
            ConfigError: if there is nothing to train from, or the settings do not fit what there
                is.
            SpecError: if logs and task differ in layout.
        """
        self.task, self.settings, self.folder, self.source = task, settings, folder, source
        self.hooks, self._device = hooks or Hooks(), device
        _require_device(device)
        self._budget = Budget.of(settings, live=source is not None, logs=logs is not None)
        self.stream = logs if isinstance(logs, Stream) else None
        store = self._logged(logs)
        self.log_transitions = 0
        if store is not None:
            self.log_transitions = self.stream.transitions if self.stream else len(store)
        gamma, lanes = settings.learner.gamma, 0 if source is None else source.lanes
        self.buffer = None
        if source is not None:
            self.buffer = Transitions.ring(
                settings.replay.capacity, lanes, widths=task.widths, reward=task.reward
            )
        self.replay = MixedReplay(
            settings.replay, task, gamma=gamma, logs=store, live=self.buffer, device=device
        )
        bounds = task.bounds(gamma)
        self.learner = self._untaught(bounds)
        self.steps, self.best = 0, dict[str, float]()
        self._evaluated = -1  # updates at the last evaluation
        seed, noise = settings.loop.seed, settings.noise
        self._rng = np.random.default_rng([seed, 0])
        self._noise = Noise(lanes, task.n_u, correlation=noise.correlation, seed=[seed, 1])
        self._tally, self._watch = Tally(tuple(task.arms), device=device), Watch(bounds)
        self._elapsed, self._mark = 0.0, (0.0, 0, 0)

    def _untaught(self, bounds: tuple[float, float]) -> Learner:
        """The learner before its first update."""
        mask = gradient_mask(self.task.arms, self.task.n_u)
        return Learner(self.task.n_x, mask, self.settings, bounds=bounds, device=self._device)

    def _logged(self, logs: Columns | Stream | None) -> Transitions | None:
        """The store of logged transitions.

        Raises:
            SpecError: if they are of another layout than the task.
        """
        if isinstance(logs, Stream):
            replay, live = self.settings.replay, self.source is not None
            drawn = round(replay.log_fraction * replay.batch) if live else replay.batch
            return logs.open(self.task.widths, self.task.reward, drawn=drawn)
        store = None if logs is None else Transitions.of_logs(logs, self.task.reward)
        if store is not None and store.widths != self.task.widths:
            raise SpecError(
                f"logs: expected widths (n_x, n_u, k) = {self.task.widths}, got {store.widths}; "
                "they are of another robot or state"
            )
        return store

    @property
    def updates(self) -> int:
        """Gradient updates so far."""
        return self.learner.updates

    @property
    def progress(self) -> float:
        """Share of the run that is over."""
        return self._budget.progress(self.updates, self.steps)

    def run(self, *, resume: bool = False) -> Outcome:
        """Train until a budget is used up, the run diverges, or it is asked to stop; with `resume`,
        from the folder's checkpoint.

        Raises:
            StorageError: if the folder already holds a run and is not to be resumed, holds none but
                is, or cannot be written to.
            ConfigError: if the checkpoint was made with other settings.
        """
        # The other cores simulate; and sums are then ordered alike on every machine.
        torch.set_num_threads(1)
        checkpoint = self.folder / "checkpoint.safetensors"
        if resume:
            self._load(checkpoint)
        elif checkpoint.exists():
            raise StorageError(
                f"{self.folder} already holds a run; resume it or choose another folder"
            )
        self._log = MetricsLog(
            self.folder / "metrics.jsonl", resume_at=self.updates if resume else None
        )
        self._began = time.perf_counter() - self._elapsed
        self._mark = (self._elapsed, self.updates, self.steps)
        with ThreadPoolExecutor(max_workers=1) as pool, closing(self.stream or ExitStack()):
            while (count := self._budget.owed(self.updates, self.steps)) > 0 or self._collects:
                if self.hooks.should_stop is not None and self.hooks.should_stop():
                    return self._end("stopped")
                before = self.updates
                self._round(count, pool)
                event = self._pause(before)
                if event is not None:
                    return self._end("diverged", event)
        event = self._write_training_row() if self._tally.count > 0 else None
        if event is not None:
            return self._end("diverged", event)
        if self.settings.loop.evaluate_every > 0 and self._evaluated != self.updates:
            self._evaluate()
        return self._end("finished")

    def policy(self) -> Policy:
        """What the run has learnt so far, as a function and file of its own."""
        return self._policy(self.learner.average_actor)

    def _policy(self, actor: Actor) -> Policy:
        network = self.settings.network
        said = {
            **self.hooks.about,
            "activation": network.activation,
            "norm": network.actor_norm,
            "updates": self.updates,
            "steps": self.steps,
            "settings": self.settings.asdict(),
        }
        return Policy(actor.arrays(), said)

    @property
    def _collects(self) -> bool:
        return self._budget.collects(self.updates, self.steps)

    def _round(self, count: int, pool: ThreadPoolExecutor) -> None:
        """`count` updates, and one block of live steps with the actor as it was before them."""
        if not self._collects:
            self._update(count)
            return
        assert self.source is not None
        assert self.buffer is not None
        policy = Exploring(
            self._policy(self.learner.actor),
            self._noise,
            deviation=self.settings.noise.at(self.progress),
        )
        loop = self.settings.loop
        length = min(loop.block, -(-(loop.steps - self.steps) // self.source.lanes))
        if loop.overlap:
            under_way = pool.submit(self.source.collect, length, policy)
            self._update(count)
            block: Block = under_way.result()
        else:
            block = self.source.collect(length, policy)
            self._update(count)
        self.buffer.add(block)
        self.steps += block.step.size

    def _update(self, count: int) -> None:
        behaviour = self.settings.behaviour
        for _ in range(count):
            if self.stream is not None:
                self.stream.feed(self.updates)
            self.learner.slow_down(1.0 - (1.0 - self.settings.loop.final_rate) * self.progress)
            pull = {"behaviour_weight": behaviour.at(self.progress), "effort": behaviour.effort}
            for _ in range(behaviour.extra if self.source is None else 0):
                self.learner.imitate(self.replay.examples(self._rng), **pull)
            self._tally.add(self.learner.update(self.replay.sample(self._rng), **pull))

    def _pause(self, before: int) -> Event | None:
        """Whatever is due between two rounds."""
        loop, event = self.settings.loop, None

        def due(every: int) -> bool:
            return every > 0 and before // every != self.updates // every

        if due(loop.metrics_every) or not self._tally.finite:
            event = self._write_training_row()
        if event is None and due(loop.evaluate_every):
            self._evaluate()
        if event is None and due(loop.checkpoint_every):
            self._save("checkpoint")
        return event

    def _write_training_row(self) -> Event | None:
        """Write and clear the interval's averages; returns what is wrong with them."""
        averages = self._tally.row()
        self._tally.clear()
        elapsed = time.perf_counter() - self._began
        seconds, updates, steps = (
            now - then
            for now, then in zip((elapsed, self.updates, self.steps), self._mark, strict=True)
        )
        self._mark = (elapsed, self.updates, self.steps)
        row: Row = {
            "bound_low": self._watch.bounds[0],
            "bound_high": self._watch.bounds[1],
            **averages,
        }
        row |= {"behaviour_weight": self.settings.behaviour.at(self.progress)}
        if self.source is not None:
            row |= {"noise": self.settings.noise.at(self.progress), **self.source.summary()}
        row |= {
            "seconds": elapsed,
            "updates_per_second": updates / seconds,
            "steps_per_second": steps / seconds,
        }
        self._write("training", row)
        return self._watch.check(averages)

    def _evaluate(self) -> None:
        """Evaluate the actor, if there is a way to, and keep its policy file if it is the best so
        far.
        """
        if self.hooks.evaluate is None:
            return
        self._evaluated = self.updates
        policy = self.policy()
        found = self.hooks.evaluate(policy, self.updates)
        self._write("evaluation", dict(found))
        figures = {name: value for name, value in found.items() if not isinstance(value, str)}
        rank = self.hooks.rank
        if not self.best or [figures[name] for name in rank] > [self.best[name] for name in rank]:
            self.best = figures
            policy.save(self.folder / "best.safetensors")

    def _write(self, kind: str, values: Row) -> None:
        row: Row = {"kind": kind, "update": self.updates, "step": self.steps, **values}
        self._log.write(row)
        if self.hooks.on_row is not None:
            self.hooks.on_row(row)

    def _end(
        self, ending: Literal["finished", "stopped", "diverged"], event: Event | None = None
    ) -> Outcome:
        """Save the run; a diverged one beside its last good checkpoint, for a post-mortem."""
        if event is not None:
            self._write("event", {"name": event.name, "advice": event.advice})
        self._save("checkpoint" if event is None else "diverged")
        return Outcome(ending, self.updates, self.steps, self.best or None, event)

    def _save(self, name: str) -> None:
        """Write buffer, then checkpoint, then policy: whichever write is cut off, the folder holds
        a run that can be resumed.
        """
        arrays: dict[str, Array] = {
            f"learner.{key}": value.detach().cpu().numpy()
            for key, value in self.learner.state().items()
        }
        arrays |= {f"tally.{key}": value for key, value in self._tally.state().items()}
        noise, values = self._noise.state()
        arrays |= {f"noise.{key}": value for key, value in values.items()}
        slots = 0
        if self.source is not None and self.buffer is not None:
            arrays |= {f"source.{key}": value for key, value in self.source.state().items()}
            self.buffer.save(self.folder / "buffer")
            slots = self.buffer.total
        self._elapsed = time.perf_counter() - self._began
        meta = {
            "settings": self.settings.asdict(),
            "about": self.hooks.about,
            "log_transitions": self.log_transitions,
            "steps": self.steps,
            "slots": slots,
            "stream": self.stream.state() if self.stream is not None else {},
            "best": self.best,
            "evaluated": self._evaluated,
            "seconds": self._elapsed,
            "generators": [generator_to_json(self._rng), noise],
        }
        save_arrays(self.folder / f"{name}.safetensors", arrays, kind=KIND, meta=meta)
        if name == "checkpoint":
            self.policy().save(self.folder / "policy.safetensors")

    def _load(self, path: Path) -> None:
        """Continue from a checkpoint of `_save`.

        Raises:
            FormatError: if it is not one, or of another network.
        """
        try:
            self._restore(path)
        except (KeyError, TypeError, ValueError, IndexError, AttributeError, RuntimeError) as error:
            said = f"{type(error).__name__}: {error}".splitlines()[0][:200]
            raise FormatError(
                f"{path}: expected a checkpoint of this run, got another: {said}"
            ) from error

    def _restore(self, path: Path) -> None:
        arrays, meta = load_arrays(path, kind=KIND)
        refuse_changes(self.settings, meta["settings"])
        if meta["log_transitions"] != self.log_transitions:
            raise ConfigError(
                f"resume: expected the {meta['log_transitions']} log transitions of before, got "
                f"{self.log_transitions}"
            )
        self.learner.load_state(
            {key: torch.from_numpy(value) for key, value in under("learner.", arrays).items()}
        )
        self._tally.load_state(under("tally.", arrays))
        if self.source is not None and self.buffer is not None:
            self.source.load_state(under("source.", arrays))
            self.buffer.load(self.folder / "buffer", total=meta["slots"])
        if self.stream is not None:
            self.stream.load_state(meta["stream"])
        self.steps, self.best, self._elapsed = meta["steps"], meta["best"], meta["seconds"]
        self._evaluated = meta["evaluated"]
        self._rng = generator_from_json(meta["generators"][0])
        self._noise.load_state(meta["generators"][1], under("noise.", arrays))


def _require_device(name: str) -> None:
    """Refuse a device that networks cannot be put on."""
    try:
        torch.zeros(1, device=name)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise ConfigError(
            "device: expected cpu, or another that this machine and this build of torch have, got "
            f"'{name}': {reason}"
        ) from error
