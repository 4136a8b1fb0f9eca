"""What became of a batch of episodes: counts, medians, and a row for each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from coordlog.episode import Json
    from coordlog.record.files import Files

SKIPPED = "skipped"
STATUSES = ("smoothed", "partly", "kept_raw", "raw_infeasible", SKIPPED)


def summary(
    rows: Sequence[Json], settings: Json, files: Files, *, wanted: int, seconds: float
) -> Json:
    """Counts, medians of the ratios after/before over what was made anew, and every row.

    Args:
        rows: Of `smooth_file`, one for each episode.
        settings: All options.
        files: What else was found: unfinished parts, and what could not be read.
        wanted: Episodes that there were to smooth.
        seconds: What it took.
    """
    done = [row["parameters"] for row in rows if row["parameters"].get("steps_of", "log") != "log"]
    counts = Counter(row["status"] for row in rows)
    fresh = [row for row in rows if not row["resumed"] and row["status"] != SKIPPED]

    def ratio(name: str, *keys: str) -> float | None:
        return _median([_ratio(each, name, *keys) for each in done])

    return {
        "settings": settings,
        "wanted": wanted,
        "episodes": len(rows),
        "statuses": {name: counts[name] for name in STATUSES if counts[name]},
        "resumed": sum(row["resumed"] for row in rows),
        "certified": sum(bool(row["parameters"].get("certified")) for row in rows),
        "median": {
            "jerk": ratio("", "jerk"),
            "acceleration": ratio("", "acceleration"),
            "torque_rate": ratio("torque", "rate"),
            "path_torque_rate": ratio("path_torque", "rate"),
            "torque_peak": ratio("torque", "peak"),
            "max_deviation": _median([each["after"]["max_deviation"] for each in done]),
            "cpu": _median([row["cpu"] for row in fresh]),
        },
        "cpu": sum(row["cpu"] for row in rows),
        "seconds": seconds,
        "rows": list(rows),
        "unfinished": [str(part) for part in files.parts],
        "skipped": [f"{item.path}: {item.reason}" for item in files.skipped],
    }


def _ratio(parameters: Json, section: str, key: str) -> float | None:
    """What a figure became, of what it was; None where either is not known."""
    figures = parameters.get(section) if section else parameters
    if not figures or not figures.get("before") or not figures.get("after"):
        return None
    before, after = figures["before"][key], figures["after"][key]
    return after / before if before and after is not None else None


def _median(values: list[float | None]) -> float | None:
    known = sorted(value for value in values if value is not None)
    if not known:
        return None
    middle = len(known) // 2
    return known[middle] if len(known) % 2 else (known[middle - 1] + known[middle]) / 2
