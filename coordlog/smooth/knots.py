"""A recorded joint path made fit to be fitted: finite samples at distinct times, ends exact."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from coordlog.errors import SpecError
from coordlog.smooth.arrays import Floats

_SAME = 1e-2  # of the median spacing: closer times are one sample, or the fit loses three digits and kinks there


@dataclass(frozen=True, eq=False)
class Knots:
    """Samples a path is fitted to."""

    time: Floats  # (K,) s, strictly increasing, K ≥ 2
    position: Floats  # (K, n_j) rad
    weight: Floats  # (K,) samples merged into each; infinite at both ends

    @property
    def unit(self) -> float:
        """Median spacing [s]."""
        return float(np.median(np.diff(self.time)))


def clean(time: ArrayLike, position: ArrayLike) -> Knots:
    """Drop incomplete samples and merge those at (nearly) the same time.

    A configuration with a NaN counts as missing. Times closer than a hundredth of the median
    spacing become one knot, the mean of its samples; the first and the last sample stay exactly as
    they are.

    Args:
        time: Sample times [s], shape (n,), not decreasing.
        position: Joint angles [rad], shape (n, n_j).

    Raises:
        SpecError: if a shape is wrong, a time is not finite or decreases, an angle is infinite, the
            first or last configuration has a NaN, or fewer than two distinct times remain.
    """
    time, position = np.asarray(time, dtype=float), np.asarray(position, dtype=float)
    if time.ndim != 1 or position.ndim != 2 or len(time) != len(position) or not position.shape[1]:
        raise SpecError(
            f"q: expected shape (n, n_j) and time of shape (n,), got {position.shape} and {time.shape}"
        )
    if len(time) < 2:
        raise SpecError(f"time: a path needs at least two samples, got {len(time)}")
    if not np.isfinite(time).all() or np.isinf(position).any():
        raise SpecError(
            "time, q: expected finite numbers; only NaN in q is read as a missing sample"
        )
    if (np.diff(time) < 0.0).any():
        raise SpecError(
            f"time: expected times that do not decrease, but sample {np.argmax(np.diff(time) < 0.0) + 1} is before the one ahead"
        )
    for name, row in (("first", position[0]), ("last", position[-1])):
        if np.isnan(row).any():
            raise SpecError(
                f"q: the {name} configuration must be complete, joint {np.argmax(np.isnan(row))} is NaN; cut the log there"
            )
    complete = ~np.isnan(position).any(axis=1)
    return _merge(time[complete], position[complete])


def _merge(time: Floats, position: Floats) -> Knots:
    gap = np.diff(time)
    if not gap.any():
        raise SpecError("time: expected at least two distinct times, all are the same")
    first = np.flatnonzero(np.append(True, gap >= _SAME * np.median(gap[gap > 0.0])))
    if len(first) < 2:
        raise SpecError(
            "time: expected at least two distinct times; all samples are nearly at once"
        )
    count = np.diff(np.append(first, len(time)))
    knot_time = np.add.reduceat(time, first) / count
    knot = np.add.reduceat(position, first, axis=0) / count[:, None]
    knot_time[[0, -1]], knot[[0, -1]] = time[[0, -1]], position[[0, -1]]
    weight = count.astype(float)
    weight[[0, -1]] = np.inf
    return Knots(knot_time, knot, weight)
