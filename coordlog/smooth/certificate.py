"""Proof that a path is free between its samples too.

Slack s at a time t cannot be lost before t + s / (Σ_j reach_j max |q'_j| + drift). Each
stretch of the path is asked about in its middle; what that covers on either side is cut off, and
what is left is asked about in its own middle, all stretches at once, until nothing is left.

Source: after the adaptive bisection of Schwarzer, Saha, Latombe 2005, IEEE Trans. Robotics 21(3).
"""

from __future__ import annotations

import numpy as np

from coordlog.path import Floats, Path
from coordlog.smooth.feasibility import DistanceChecker
from coordlog.smooth.times import spacing
from coordlog.smooth.violations import NONE, Kind, Violations, violations

_WIDEST = 8  # knots in a stretch at first: far from everything a smooth path needs no more
# knots: a path so close to trouble that an answer covers less than this counts as unproven
_FINEST = 1e-4
# times the finest: only in stretches this short, for in longer ones it is the bound that is coarse
_SHORT = 16


def certify(
    spline: Path, checker: DistanceChecker, clearance: float, *, allowed: Floats | None = None
) -> Violations:
    """Prove that every point of a path is free, or say where that fails.

    Args:
        spline: The path.
        checker: Gives slacks, reach and drift.
        clearance: Distance to keep [m].
        allowed: Metres by which each pair may fall short of it, (P,).

    Returns:
        No violations if the path is proven free; otherwise the first ones found, all CONTACT or all
        UNPROVEN.
    """
    fastest, last = _Fastest(spline), len(spline.time) - 1
    cut = np.arange(0, last, _WIDEST)
    start, stop = spline.time[cut], spline.time[np.minimum(cut + _WIDEST, last)]
    finest = _FINEST * spacing(spline.time)
    while len(start):
        middle, half = 0.5 * (start + stop), 0.5 * (stop - start)
        slack = checker.slack(middle, spline(middle), clearance) + (
            0.0 if allowed is None else allowed
        )
        if not slack.shape[1]:
            return NONE
        bad = ~(slack.min(axis=1) >= 0.0)  # a NaN is bad
        if bad.any():
            return violations(
                Kind.CONTACT, middle[bad], -slack[bad].min(axis=1), slack[bad].argmin(axis=1)
            )
        before = _covered(slack, fastest(start, middle), checker, start, middle)
        after = _covered(slack, fastest(middle, stop), checker, middle, stop)
        more_before, more_after = before < 1.0, after < 1.0
        small = (
            np.minimum(
                np.where(more_before, before * half, np.inf),
                np.where(more_after, after * half, np.inf),
            )
            < finest
        )
        stuck = small & (half < _SHORT * finest)
        if stuck.any():
            return violations(
                Kind.UNPROVEN, middle[stuck], np.zeros(stuck.sum()), slack[stuck].argmin(axis=1)
            )
        left, right = (middle - before * half)[more_before], (middle + after * half)[more_after]
        start, stop = (
            np.concatenate([start[more_before], right]),
            np.concatenate([left, stop[more_after]]),
        )
    return NONE


def _covered(
    slack: Floats, fastest: Floats, checker: DistanceChecker, start: Floats, stop: Floats
) -> Floats:
    """Share in [0, 1] of each stretch that the slacks (m, P) at one end of it cover; fastest bounds
    |q'_j|, (m, n_j).

    Slack is lost at no more than a constant rate, so the part it covers is free whatever lies
    beyond.
    """
    loss = (fastest @ checker.reach.T + checker.drift(start, stop)) * (stop - start)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(loss > 0.0, slack / loss, np.inf).min(axis=1)
    return np.where(share > 1.0, 1.0, share * (1.0 - 1e-9))


class _Fastest:
    """Bounds on |q'_j| over any stretch of a spline."""

    def __init__(self, spline: Path) -> None:
        self._time = spline.time
        u, v = spline.velocity[:-1], spline.velocity[1:]
        middle = 3.0 * np.diff(spline.position, axis=0) / np.diff(spline.time)[:, None] - u - v
        fastest = abs(np.stack([u, middle, v])).max(
            axis=0
        )  # the speed lies in the hull of its Bernstein coefficients
        self._piece = np.concatenate(
            [fastest, fastest[-1:]]
        )  # reduceat wants every index inside the array

    def __call__(self, start: Floats, stop: Floats) -> Floats:
        """Largest speed [rad/s] in each [start, stop], shape (m, n_j).

        Exact for no piece, too small for none.
        """
        last = len(self._time) - 1
        first = np.clip(np.searchsorted(self._time, start, side="right") - 1, 0, last - 1)
        end = np.clip(np.searchsorted(self._time, stop, side="left"), first + 1, last)
        return np.asarray(
            np.maximum.reduceat(self._piece, np.stack([first, end], axis=1).ravel())[::2]
        )
