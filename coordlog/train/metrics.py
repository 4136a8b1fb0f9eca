"""What a run says about itself: averages over an interval, rows of a JSON-lines file, and the event
of a divergence.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from coordlog.episode import Array, Json
from coordlog.errors import FormatError, StorageError
from coordlog.train.digrad import Update

Row = dict[str, float | int | str | None]

MOST = 512 << 20
"""Largest file of metrics that is read [bytes]."""
WORDS = ("kind", "name", "advice", "touched")
"""Keys of a row that hold a text."""
COUNTS = ("update", "step")
"""Keys that are counts."""
LARGEST = 1e300

TIMING = ("seconds", "updates_per_second", "steps_per_second")
"""Keys of a row that two runs from one seed do not share."""


class Tally:
    """Means and extremes over the updates of an interval.

    Nothing is read from the device until the row is.
    """

    def __init__(self, arms: tuple[str, ...], *, device: str = "cpu") -> None:
        """Start an interval for arms of these names."""
        self._device = torch.device(device)
        self._names = (
            "critic_loss",
            *(f"q_{arm}" for arm in arms),
            *(f"value_{arm}" for arm in arms),
            "behaviour",
            "saturation",
        )
        self.clear()

    def clear(self) -> None:
        """Start another interval."""
        self.count = 0
        self._sum = torch.zeros(len(self._names), device=self._device)
        self._low, self._high = (
            torch.tensor(limit, device=self._device) for limit in (math.inf, -math.inf)
        )

    def add(self, update: Update) -> None:
        """Count one update."""
        scalars = (
            update.critic_loss[None],
            update.q,
            update.actor_value,
            update.behaviour[None],
            update.saturation[None],
        )
        self._sum += torch.cat(scalars)
        self._low, self._high = (
            torch.minimum(self._low, update.q_low),
            torch.maximum(self._high, update.q_high),
        )
        self.count += 1

    @property
    def finite(self) -> bool:
        """Whether nothing so far was NaN or infinite."""
        return bool(torch.isfinite(self._sum).all())

    def row(self) -> Row:
        """Means by name, and the least and greatest Q, in units of the unscaled return.

        Empty without updates.
        """
        if self.count == 0:
            return {}
        means = (self._sum / self.count).tolist()
        return {
            **dict(zip(self._names, means, strict=True)),
            "q_low": self._low.item(),
            "q_high": self._high.item(),
        }

    def state(self) -> dict[str, Array]:
        """The interval so far."""
        tensors = {"sum": self._sum, "low": self._low, "high": self._high}
        return {
            "count": np.array(self.count),
            **{name: tensor.cpu().numpy() for name, tensor in tensors.items()},
        }

    def load_state(self, arrays: Mapping[str, Array]) -> None:
        """Continue an interval."""
        self._sum, self._low, self._high = (
            torch.tensor(arrays[name], device=self._device) for name in ("sum", "low", "high")
        )
        self.count = int(arrays["count"])


@dataclass(frozen=True)
class Event:
    """A run that should not go on, by name."""

    name: str
    """"not_finite", "q_out_of_bounds" or "saturated"."""
    advice: str
    """One sentence: what was seen and what to try."""


@dataclass(frozen=True)
class Watch:
    """Looks at every row for the ways in which actor-critic learning goes wrong."""

    bounds: tuple[float, float]
    """Least and greatest return any policy can have."""
    slack: float = 1.0
    """Q may leave the bounds by this share of their distance: a network overshoots a little without
    diverging."""
    saturation: float = 0.95
    """More than this share of action entries at their limits is a saturated actor: its gradient
    through tanh is gone."""

    def check(self, row: Mapping[str, object]) -> Event | None:
        """The first thing that is wrong with a row of a `Tally`, if any."""
        values = {name: value for name, value in row.items() if isinstance(value, float)}
        broken = sorted(name for name, value in values.items() if not math.isfinite(value))
        if broken:
            return Event(
                "not_finite",
                f"{', '.join(broken)} not finite; lower the learning rates, and check the logs "
                "for wild states with `check`",
            )
        low, high = self.bounds
        room = self.slack * (high - low)
        if values.get("q_low", low) < low - room or values.get("q_high", high) > high + room:
            seen = (
                f"Q spans [{values['q_low']:.4g}, {values['q_high']:.4g}] but no return lies "
                f"outside [{low:.4g}, {high:.4g}]"
            )
            return Event(
                "q_out_of_bounds",
                f"{seen}; set learner.clip_targets = true, use critic_norm = 'layer', or lower "
                "learner.critic_rate",
            )
        if values.get("saturation", 0.0) > self.saturation:
            seen = f"{values['saturation']:.0%} of the actions are at their limits"
            return Event(
                "saturated",
                f"{seen}; lower learner.actor_rate, raise behaviour.weight, or check how the "
                "state is scaled",
            )
        return None


class MetricsLog:
    """One JSON object per line, each appended by a single write, so that a crash costs at most the
    last line.
    """

    def __init__(self, path: Path, *, resume_at: int | None = None) -> None:
        """Start a file, or go on with one after dropping every row later than update `resume_at`
        and a torn last line.

        Raises:
            StorageError: if the file system refuses.
            FormatError: if a line before the last is not a row.
        """
        self.path = path
        kept = (
            b""
            if resume_at is None
            else b"".join(line for line, row in _rows(path) if int(row["update"]) <= resume_at)
        )
        part = path.with_name(path.name + ".part")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            part.write_bytes(kept)
            os.replace(part, path)
        except OSError as error:
            raise StorageError(f"{path} cannot be written: {error.strerror}") from error

    def write(self, row: Row) -> None:
        """Append a row; a value that is not finite is written as null.

        Raises:
            StorageError: if the file system refuses.
        """
        finite = {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in row.items()
        }
        line = json.dumps(finite, allow_nan=False) + "\n"
        try:
            with self.path.open("ab", buffering=0) as file:
                file.write(line.encode())
        except OSError as error:
            raise StorageError(f"{self.path} cannot be written: {error.strerror}") from error


def read_metrics(path: Path) -> list[Json]:
    """All rows of a metrics file; a torn last line is left out.

    Raises:
        StorageError: if it cannot be read.
        FormatError: if a line before the last is not a row.
    """
    return [row for _, row in _rows(path)]


def _rows(path: Path) -> list[tuple[bytes, Json]]:
    try:
        with path.open("rb") as stream:
            data = stream.read(MOST + 1)
    except OSError as error:
        raise StorageError(f"{path} cannot be read: {error.strerror}") from error
    if len(data) > MOST:
        raise FormatError(f"{path}: expected at most {MOST:,} bytes of metrics, got more")
    rows = []
    for number, line in enumerate(data.splitlines(keepends=True), start=1):
        if not line.endswith(b"\n"):
            break
        try:
            rows.append((line, _row(json.loads(line))))
        except (ValueError, RecursionError) as error:
            reason = "too deep" if isinstance(error, RecursionError) else str(error)
            raise FormatError(f"{path}: line {number} is not a row of metrics: {reason}") from None
    return rows


def _row(row: object) -> Json:
    """A row, if it is one: a kind, an update and a step, and figures that are numbers or null.

    Raises:
        ValueError: saying what is wrong.
    """
    if not isinstance(row, dict) or not isinstance(row.get("kind", ""), str):
        raise ValueError("expected an object whose kind is a text")
    for name, value in row.items():
        if name in WORDS:
            continue
        number = isinstance(value, int | float) and abs(value) <= LARGEST
        if not number and (value is not None or name in COUNTS):
            raise ValueError(f"'{name}': expected a number, got {str(value)[:40]!r}")
    if "update" not in row:
        raise ValueError("'update' is missing")
    return row
