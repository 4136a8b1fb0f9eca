"""Other ways to smooth a joint path, each as its users would call it.

Arrays in, a spline out; None where the tool is not installed.
"""

from __future__ import annotations

import mujoco
import numpy as np
from csaps import csaps
from scipy.interpolate import make_smoothing_spline
from scipy.signal import butter, filtfilt, savgol_filter

from coordlog.smooth.spline import fit

ACCELERATION = 10.0  # rad/s², the limit given to toppra


def through(time, q):
    """The natural cubic through samples, which is how all of these are judged between samples."""
    return fit(time, q, lam=0.0)


def exponential(time, q, limits):
    """A moving average with weight 0.25 on the newest sample."""
    smoothed = q.copy()
    for i in range(1, len(q)):
        smoothed[i] = 0.25 * q[i] + 0.75 * smoothed[i - 1]
    return through(time, smoothed)


def savitzky_golay(time, q, limits):
    """Window 21, order 3."""
    return through(time, savgol_filter(q, min(21, len(q) // 2 * 2 - 1), 3, axis=0))


def butterworth(time, q, limits):
    """Second order, 3 Hz, forward and backward."""
    b, a = butter(2, 3.0, fs=1.0 / np.median(np.diff(time)))
    return through(time, filtfilt(b, a, q, axis=0))


def cross_validated(time, q, limits):
    """scipy's smoothing spline, λ by generalised cross-validation."""
    return through(
        time, np.stack([make_smoothing_spline(time, column)(time) for column in q.T], axis=1)
    )


def paper_plainly(time, q, scene):
    """The paper's Algorithms 2 to 4, word for word: csaps for one joint and step, a Python loop
    over all knots; the path and its p.
    """
    index, weight = np.arange(len(time)), np.ones(len(time))
    weight[[0, -1]] = np.inf
    path, ps = q.copy(), []
    for joint in range(q.shape[1]):
        lower, upper = 0.0, 1.0
        while upper - lower >= 1e-6:
            middle, candidate = 0.5 * (lower + upper), path.copy()
            candidate[:, joint] = csaps(index, q[:, joint], index, smooth=middle, weights=weight)
            if scene.all_free(candidate):
                upper = middle
            else:
                lower = middle
        path[:, joint] = csaps(index, q[:, joint], index, smooth=upper, weights=weight)
        ps.append(upper)
    return through(time, path), np.array(ps)


class PlainScene:
    """One configuration after the other, checked with MuJoCo from a Python loop."""

    def __init__(self, model, data, whole, places, limits, *, pairs, balanced):
        self.model, self.data, self.whole, self.places, self.limits = (
            model,
            data,
            whole,
            places,
            limits,
        )
        self.pairs, self.balanced = {tuple(pair) for pair in pairs.tolist()}, balanced

    def free(self, row, q):
        """Whether the action joints may stand at q while the rest is as in `row` of the log."""
        if (q < self.limits[:, 0] - 1e-3).any() or (q > self.limits[:, 1] + 1e-3).any():
            return False
        self.data.qpos[:] = self.whole[row]
        self.data.qpos[self.places] = q
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_collision(self.model, self.data)
        for contact in self.data.contact:
            if contact.dist < 0.0 and tuple(sorted(contact.geom.tolist())) in self.pairs:
                return False
        return self.balanced(self.data)

    def all_free(self, path):
        return all(self.free(i, q) for i, q in enumerate(path))


def ompl_simplify(time, q, limits, scene):
    """OMPL's simplification (shortcuts and B-spline) of the logged path, and the minimum-jerk time
    law over the log's duration.
    """
    try:
        from ompl import base, geometric, util
    except ImportError:
        return None
    util.setLogLevel(util.LogLevel.LOG_NONE) if hasattr(util, "LogLevel") else None
    n_j, middle = q.shape[1], len(q) // 2
    space = base.RealVectorStateSpace(n_j)
    bounds = base.RealVectorBounds(n_j)
    for j in range(n_j):
        bounds.setLow(j, float(min(limits[j, 0], q[:, j].min()) - 1e-3))
        bounds.setHigh(j, float(max(limits[j, 1], q[:, j].max()) + 1e-3))
    space.setBounds(bounds)
    space.setLongestValidSegmentFraction(0.02 / space.getMaximumExtent())
    info = base.SpaceInformation(space)
    info.setStateValidityChecker(
        lambda state: scene.free(middle, np.array([state[j] for j in range(n_j)]))
    )
    info.setup()
    path = geometric.PathGeometric(info)
    for row in q:
        state = space.allocState()
        for j in range(n_j):
            state[j] = float(row[j])
        path.append(state)
    geometric.PathSimplifier(info).simplifyMax(path)
    found = np.array([[state[j] for j in range(n_j)] for state in path.getStates()])
    found = found[np.append(True, np.abs(np.diff(found, axis=0)).max(axis=1) > 1e-9)]
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(found, axis=0), axis=1)))
    x = (time - time[0]) / (time[-1] - time[0])
    share = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    return through(
        time, np.stack([np.interp(share * along[-1], along, column) for column in found.T], axis=1)
    )


def toppra_raw(time, q, limits, speeds):
    """toppra on the log's own spline: the time-optimal law under speed and acceleration limits.

    Another duration.
    """
    try:
        import toppra
        import toppra.algorithm
        import toppra.constraint
    except ImportError:
        return None
    path = toppra.SplineInterpolator(time, q)
    rules = [
        toppra.constraint.JointVelocityConstraint(np.stack([-speeds, speeds], axis=1)),
        toppra.constraint.JointAccelerationConstraint(
            np.tile([-ACCELERATION, ACCELERATION], (q.shape[1], 1))
        ),
    ]
    timed = toppra.algorithm.TOPPRA(
        rules, path, parametrizer="ParametrizeSpline"
    ).compute_trajectory()
    if timed is None:
        return None
    samples = np.linspace(
        0.0, timed.duration, max(len(q), round(timed.duration / np.median(np.diff(time))) + 1)
    )
    return through(samples, timed(samples))
