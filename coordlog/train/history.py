"""What runs have measured, as curves: one per run, and their mean and deviation over the runs that
differ in nothing but the seed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from coordlog.episode import Array, Json
from coordlog.train.metrics import read_metrics
from coordlog.train.run import recall
from coordlog.train.settings import UNSAID

Against = Literal["episodes", "updates", "steps"]
Kind = Literal["evaluation", "training"]
"""Figures on held-out problems, or of the episodes that were learnt from, exploration included."""
IDLE = ("loop.seed", "loop.evaluate_every", "loop.checkpoint_every")
"""Settings that do not set runs apart: they learn the same."""
MODES = {"logs": "from logs", "live": "live", "both": "logs and live"}
DIFFERENCES = 3
"""A label names at most this many settings."""


class Line(NamedTuple):
    """y over x, x increasing; both (n,)."""

    x: Array
    y: Array


class Band(NamedTuple):
    """Mean over runs, and the sample standard deviation (0 of one run); all (n,)."""

    x: Array
    mean: Array
    deviation: Array


@dataclass(frozen=True)
class History:
    """One run folder."""

    folder: Path
    said: Json
    """run.json."""
    rows: list[Json]
    """metrics.jsonl."""

    def line(self, name: str, *, kind: Kind, against: Against) -> Line:
        """A figure of merit; intervals in which no episode ended have none.

        Empty where there is nothing.
        """
        rows = [
            row
            for row in self.rows
            if row.get("kind") == kind and row.get("episodes") and row.get(name) is not None
        ]
        x = np.array([self._place(row, against) for row in rows], dtype=np.float64)
        y = np.array([row[name] for row in rows], dtype=np.float64)
        last = (
            len(x) - 1 - np.unique(x[::-1], return_index=True)[1]
        )  # of rows at one place, the latest
        return Line(x[last], y[last])

    @property
    def live(self) -> bool:
        """Whether the run has taken live steps."""
        return any(row.get("step") for row in self.rows)

    def _place(self, row: Json, against: Against) -> float:
        if against != "episodes":
            return float(row["update"] if against == "updates" else row.get("step", 0))
        if "episodes_total" in row:
            return float(row["episodes_total"])
        counted = [other for other in self.rows if "episodes_total" in other]
        places = [float(other["update"]) for other in counted]
        return (
            float(np.interp(row["update"], places, [other["episodes_total"] for other in counted]))
            if counted
            else 0.0
        )


def load_history(folder: Path) -> History:
    """Read a run folder, finished or not.

    Raises:
        StorageError: if it holds no run, or one without a row of metrics.
        ConfigError: if its run.json is damaged.
        FormatError: if its metrics are.
    """
    return History(folder, recall(folder), read_metrics(folder / "metrics.jsonl"))


def band(lines: Sequence[Line]) -> Band:
    """Mean and deviation as far as all the lines go, at every x of any of them."""
    low, high = max(line.x[0] for line in lines), min(line.x[-1] for line in lines)
    x = np.unique(np.concatenate([line.x for line in lines]))
    x = x[(x >= low) & (x <= high)]
    values = np.array([np.interp(x, line.x, line.y) for line in lines])
    deviation = values.std(axis=0, ddof=1) if len(lines) > 1 else np.zeros(len(x))
    return Band(x, values.mean(axis=0), deviation)


def grouped(histories: Sequence[History]) -> dict[str, list[History]]:
    """Runs of one scene that differ in nothing but the seed, by a label that says what sets them
    apart from the other groups.
    """
    groups: dict[str, list[History]] = {}
    for history in histories:
        groups.setdefault(repr(sorted(_constants(history.said).items())), []).append(history)
    members = list(groups.values())
    labels: dict[str, list[History]] = {}
    for group in members:
        own = str(group[0].said["mode"])
        rivals = [_constants(other[0].said) for other in members if other[0].said["mode"] == own]
        label = ", ".join([MODES.get(own, own), *_differences(_constants(group[0].said), rivals)])
        labels[label if label not in labels else f"{label} ({group[0].folder.name})"] = group
    return labels


def _differences(
    own: Mapping[str, object], all_of_them: Sequence[Mapping[str, object]]
) -> list[str]:
    keys = [key for key in own if any(other.get(key) != own[key] for other in all_of_them)]
    shown = [f"{key} = {str(own[key])[:12]}" for key in keys[:DIFFERENCES]]
    return [*shown, "…"] if len(keys) > DIFFERENCES else shown


def _constants(said: Json) -> dict[str, object]:
    """Everything but the seed that the outcome of a run depends on, flat."""
    env = said.get("env", {})
    sections = {**said["settings"], "env": env.get("config", {}), "reward": env.get("reward", {})}
    flat = {
        f"{name}.{key}": value
        for name, section in sections.items()
        if isinstance(section, dict)
        for key, value in section.items()
    }
    for key in IDLE:
        flat.pop(key, None)
    for (section, name), value in UNSAID.items():
        flat.setdefault(f"{section}.{name}", value)
    return {
        "mode": said["mode"],
        **flat,
        **{key: said[key] for key in ("envs", "where", "data") if said.get(key)},
    }
