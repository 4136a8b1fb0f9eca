"""The ten statistics that LeRobot keeps of every feature, per episode and of the whole set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from coordlog.episode import Array

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
NAMES = ("min", "max", "mean", "std", "count", *QUANTILES)

Stats = dict[str, Any]
"""Lists by the names of `NAMES`; `count` is a list of one number."""


def of_columns(columns: Mapping[str, Array]) -> dict[str, Stats]:
    """Statistics of every column over its rows, all computed in one pass.

    Args:
        columns: Numbers or truth values, each (n,) or (n, width); n > 0.
    """
    widths = {name: 1 if values.ndim == 1 else values.shape[1] for name, values in columns.items()}
    n = len(next(iter(columns.values())))
    table = np.concatenate(
        [np.asarray(values, np.float64).reshape(n, -1) for values in columns.values()], axis=1
    )
    ordered = np.sort(table, axis=0)
    rows = {
        "min": ordered[0],
        "max": ordered[-1],
        "mean": table.mean(axis=0),
        "std": table.std(axis=0),
    }
    rows |= {name: _quantile(ordered, share) for name, share in QUANTILES.items()}
    found: dict[str, Stats] = {}
    start = 0
    for name, width in widths.items():
        cut = slice(start, start + width)
        stats = {key: values[cut].tolist() for key, values in rows.items()}
        found[name] = {key: [n] if key == "count" else stats[key] for key in NAMES}
        start += width
    return found


def of_images(frames: Sequence[Array]) -> Stats:
    """Statistics of each colour channel in [0, 1], shape (3, 1, 1) as LeRobot has them.

    Args:
        frames: RGB images (height, width, 3) uint8, a sample of a video's.
    """
    pixels = np.concatenate([frame[::4, ::4].reshape(-1, 3) for frame in frames]) / 255.0
    flat = of_columns({"image": pixels})["image"]
    shaped = {name: [[[value]] for value in flat[name]] for name in NAMES if name != "count"}
    return {name: [len(frames)] if name == "count" else shaped[name] for name in NAMES}


def pooled(parts: Sequence[Stats]) -> Stats:
    """Statistics of several parts together.

    Counts, extremes, means and deviations are exact; a quantile is the mean of the parts' ones by
    their counts, as LeRobot pools them.
    """
    counts = np.array([part["count"][0] for part in parts], np.float64)
    share = counts / counts.sum()

    def weighted(name: str) -> Array:
        values = np.array([part[name] for part in parts], np.float64)
        return np.asarray(np.tensordot(share, values, axes=1))

    mean = weighted("mean")
    second = np.array(
        [np.square(part["std"]) + np.square(np.array(part["mean"]) - mean) for part in parts]
    )
    found: Stats = {
        "min": np.min([part["min"] for part in parts], axis=0).tolist(),
        "max": np.max([part["max"] for part in parts], axis=0).tolist(),
        "mean": mean.tolist(),
        "std": np.sqrt(np.tensordot(share, second, axes=1)).tolist(),
        "count": [int(counts.sum())],
    }
    return found | {name: weighted(name).tolist() for name in QUANTILES}


def _quantile(ordered: Array, share: float) -> Array:
    """Linear interpolation between the two neighbours in sorted rows, as NumPy's default."""
    at = share * (len(ordered) - 1)
    low = int(at)
    high = min(low + 1, len(ordered) - 1)
    return np.asarray(ordered[low] + (ordered[high] - ordered[low]) * (at - low))
