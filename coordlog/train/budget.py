"""How long a run goes on: updates that live steps have earned, and those that are owed next."""

from __future__ import annotations

from dataclasses import dataclass

from coordlog.errors import ConfigError
from coordlog.train.settings import Settings

ROUND = 50
"""Updates of a round without live steps: the longest wait for a stop."""


@dataclass(frozen=True)
class Budget:
    """What a run may spend, by its settings.

    Example:
        >>> from coordlog.train.settings import load_settings
        >>> Budget(load_settings("default"), live=False).owed(0, 0)
        50
    """

    settings: Settings
    live: bool
    """Whether there are simulations to step."""

    @classmethod
    def of(cls, settings: Settings, *, live: bool, logs: bool) -> Budget:
        """The budget of a run with simulations, logs, or both.

        Raises:
            ConfigError: if the settings do not fit what there is.
        """
        loop = settings.loop
        if live and loop.steps == 0:
            raise ConfigError(
                "loop.steps: expected a budget of live steps, got 0; leave out the simulations to "
                "train from logs alone"
            )
        if not live and loop.updates == 0:
            raise ConfigError(
                "loop.updates: expected a budget of updates, got 0; only live steps can earn them"
            )
        if not logs and loop.pretrain > 0:
            raise ConfigError(
                f"loop.pretrain: expected logs for {loop.pretrain} updates before the first live "
                "step, got none"
            )
        return cls(settings, live)

    def progress(self, updates: int, steps: int) -> float:
        """Share of the run that is over, counted in updates or in live steps, whichever is further
        on.
        """
        live = steps / self.settings.loop.steps if self.live else 0.0
        return min(1.0, max(live, updates / max(1, self.earned(self.settings.loop.steps))))

    def collects(self, updates: int, steps: int) -> bool:
        """Whether the next round steps the simulations."""
        loop = self.settings.loop
        spent = 0 < loop.updates <= updates or steps >= loop.steps
        return self.live and updates >= loop.pretrain and not spent

    def earned(self, steps: int) -> int:
        """Updates that the run may have made after so many live steps."""
        loop = self.settings.loop
        if not self.live:
            return loop.updates
        counted = max(0, steps - self.settings.replay.warmup)
        earned = loop.pretrain + int(loop.updates_per_step * counted)
        return min(earned, loop.updates) if loop.updates > 0 else earned

    def owed(self, updates: int, steps: int) -> int:
        """Updates of the next round: all that live steps have earned, or a few at a time without
        them.
        """
        loop, owed = self.settings.loop, self.earned(steps) - updates
        if self.collects(updates, steps):
            return owed
        intervals = (loop.metrics_every, loop.checkpoint_every, loop.evaluate_every or ROUND)
        return min(owed, ROUND, *(every - updates % every for every in intervals))
