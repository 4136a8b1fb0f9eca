"""Other ways to smooth a joint path, each as its users would call it: times (n,), angles (n, n_j) and
whether a configuration is allowed in, a path out.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from csaps import csaps
from scipy.interpolate import make_smoothing_spline
from scipy.signal import butter, filtfilt, savgol_filter

from coordlog.episode import Array
from coordlog.smooth.spline import fit
from experiments.ompl_plan import space_within, state_of

PRECISION = 1e-6
"""Of p, as the paper has it."""


def through(time: Array, q: Array) -> Any:
    """The natural cubic through samples, which is how all of these are judged between samples."""
    return fit(time, q, lam=0.0)


def exponential(time: Array, q: Array) -> Any:
    """A moving average with weight 0.25 on the newest sample."""
    smoothed = q.copy()
    for i in range(1, len(q)):
        smoothed[i] = 0.25 * q[i] + 0.75 * smoothed[i - 1]
    return through(time, smoothed)


def savitzky_golay(time: Array, q: Array) -> Any:
    """Window 21, order 3."""
    return through(time, savgol_filter(q, min(21, len(q) // 2 * 2 - 1), 3, axis=0))


def butterworth(time: Array, q: Array) -> Any:
    """Second order, 3 Hz, forward and backward."""
    b, a = butter(2, 3.0, fs=1.0 / np.median(np.diff(time)))
    return through(time, filtfilt(b, a, q, axis=0))


def cross_validated(time: Array, q: Array) -> Any:
    """Scipy's smoothing spline, λ by generalised cross-validation."""
    columns = [make_smoothing_spline(time, column)(time) for column in q.T]
    return through(time, np.stack(columns, axis=1))


def paper_plainly(time: Array, q: Array, all_free: Callable[[Array], bool]) -> tuple[Any, Array]:
    """The paper's Algorithms 2 to 4, word for word: csaps for one joint and step, and every knot
    asked about; the path and its p.
    """
    index, weight = np.arange(float(len(time))), np.ones(len(time))
    weight[[0, -1]] = np.inf
    path, ps = q.copy(), []
    for joint in range(q.shape[1]):

        def fitted(p: float, joint: int = joint) -> Array:
            return np.asarray(csaps(index, q[:, joint], index, smooth=p, weights=weight))

        lower, upper = 0.0, 1.0
        while upper - lower >= PRECISION:
            middle, candidate = 0.5 * (lower + upper), path.copy()
            candidate[:, joint] = fitted(middle)
            lower, upper = (lower, middle) if all_free(candidate) else (middle, upper)
        path[:, joint] = fitted(upper)
        ps.append(upper)
    return through(time, path), np.array(ps)


def ompl_simplify(time: Array, q: Array, limits: Array, free: Callable[[Array], bool]) -> Any:
    """OMPL's simplification (shortcuts and B-spline) of the logged path, and the minimum-jerk time
    law over the log's duration.
    """
    from ompl import geometric

    info, space = space_within(limits, free, q.min(axis=0), q.max(axis=0))
    path = geometric.PathGeometric(info)
    for row in q:
        path.append(state_of(space, row))
    geometric.PathSimplifier(info).simplifyMax(path)
    found = np.array([[state[j] for j in range(q.shape[1])] for state in path.getStates()])
    found = found[np.append(True, np.abs(np.diff(found, axis=0)).max(axis=1) > 1e-9)]
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(found, axis=0), axis=1)))
    x = (time - time[0]) / (time[-1] - time[0])
    at = x**3 * (10.0 - 15.0 * x + 6.0 * x**2) * along[-1]
    return through(time, np.stack([np.interp(at, along, column) for column in found.T], axis=1))
