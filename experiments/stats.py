"""Figures of many episodes: rates with intervals, percentiles, and numbers as text that never
flatter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

CONFIDENCE = 0.95
DRAWS = 2000
"""Resamples of a bootstrap interval."""


def rate(count: int, of: int) -> dict[str, Any]:
    """A share with its Wilson interval."""
    from scipy.stats import binomtest

    interval = binomtest(count, of).proportion_ci(CONFIDENCE, method="wilson")
    return {
        "count": count,
        "of": of,
        "rate": count / of,
        "low": float(interval.low),
        "high": float(interval.high),
    }


def spread(values: Sequence[float], **percentiles: float) -> dict[str, float] | None:
    """Percentiles by name; None of no values."""
    known = [value for value in values if math.isfinite(value)]
    if not known:
        return None
    return {name: float(np.percentile(known, at)) for name, at in percentiles.items()}


def median_interval(values: Sequence[float], seed: int = 0) -> dict[str, float] | None:
    """Median with its bootstrap interval; None of no values."""
    known = np.array([value for value in values if math.isfinite(value)])
    if not len(known):
        return None
    drawn = np.median(
        known[np.random.default_rng(seed).integers(len(known), size=(DRAWS, len(known)))], axis=1
    )
    low, high = np.percentile(drawn, [50 * (1 - CONFIDENCE), 50 * (1 + CONFIDENCE)])
    return {
        "median": float(np.median(known)),
        "low": float(low),
        "high": float(high),
        "n": len(known),
    }


def percent_down(count: int, of: int) -> str:
    """A share that is better the greater it is, in per cent: cut off, not rounded, so 99.49 % is
    99.4 %.
    """
    return _tenths(1000 * count // of)


def percent_up(count: int, of: int) -> str:
    """A share that is better the smaller it is, in per cent: 0.01 % is 0.1 %."""
    return _tenths(-(-1000 * count // of))


def down(value: float, digits: int = 1) -> str:
    """A number that is better the greater it is, cut off."""
    return f"{math.floor(_snapped(value, digits)) / 10**digits:.{digits}f}"


def up(value: float, digits: int = 1) -> str:
    """A number that is better the smaller it is, rounded up."""
    return f"{math.ceil(_snapped(value, digits)) / 10**digits:.{digits}f}"


def _snapped(value: float, digits: int) -> float:
    scaled = value * 10**digits
    whole = float(round(scaled))
    return whole if abs(scaled - whole) < 1e-9 else scaled  # 0.3 * 10 is not 3 in binary


def _tenths(tenths: int) -> str:
    return f"{tenths // 10}.{tenths % 10} %"
