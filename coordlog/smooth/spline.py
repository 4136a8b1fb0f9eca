"""Weighted cubic smoothing splines of all joints in one banded solve.

A fit minimises, for every column of the samples, Σ w_i (y_i - f(t_i))² + λ ∫ f''² dt. Only 1/w
enters the equations, so an infinite weight is an exact equality and needs no trick. Time runs in
knots inside (one unit is the typical spacing), which keeps the small-p digits that seconds would
lose; λ and every result are in seconds.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.lapack import dpbsv

from coordlog.errors import SpecError
from coordlog.path import Floats, Path
from coordlog.smooth.times import spacing

# knots³; with clamped ends the equations are singular at λ = ∞, and nothing moves beyond this
_LAM_CLAMPED = 1e15


class Grid:
    """What the fit needs of the sample times alone, computed once and used for any samples, weights
    and λ.

    With Q taking second divided differences and R the Gram matrix of the hat functions, the fit
    solves (p R + (1 - p) Qᵀ W⁻¹ Q) u = Qᵀ y for u = f'' / p at the knots, and f = y - (1 - p) W⁻¹ Q
    u. Natural ends know that f'' = 0 there; clamped ends add two rows and keep the bandwidth.

    Source: Reinsch 1967, Numer. Math. 10; Green and Silverman 1994, section 2.3.
    """

    def __init__(self, time: Floats, *, clamped: bool) -> None:
        """Prepare fits over `time` [s], shape (n,), n ≥ 2, strictly increasing, with clamped or
        natural ends.
        """
        self.time, self.clamped = time, clamped
        self.unit = spacing(time)
        """Seconds in one knot: the typical spacing."""
        u = (time - time[0]) / self.unit
        h = np.diff(u)
        self._x, self._h, self._inverse = u / u[-1], h[:, None], 1.0 / h[:, None]
        self._first = 0 if clamped else 1
        self._inner = slice(self._first, len(time) - self._first)
        before, after = np.append(0.0, 1.0 / h)[self._inner], np.append(1.0 / h, 0.0)[self._inner]
        at = -before - after  # Q[i-1, i], Q[i, i], Q[i+1, i] are before, at, after
        self._q = (
            np.stack([before, at, after]) ** 2,
            np.stack([at[:-1] * before[1:], after[:-1] * at[1:]]),
            after[:-2] * before[2:],
        )
        self._r = (
            (np.append(0.0, h) + np.append(h, 0.0))[self._inner] / 3.0,
            h[self._first : h.size - self._first] / 6.0,
        )

    def fit(
        self, value: Floats, *, lam: float, weight: Floats, velocity: Floats | None = None
    ) -> Path:
        """Fit every column of `value`; arguments as of the function `fit`, unchecked, one λ."""
        span = self.time[-1] - self.time[0]
        slope = (value[-1] - value[0]) / span
        ends = np.stack([slope, slope]) if velocity is None else velocity
        # A straight line, or the Hermite cubic between exact and clamped ends, comes out as it went
        # in: fit the rest.
        position, speed = _hermite(self._x, value[[0, -1]], ends * span)
        rest, rate = self._solve(value - position, lam / self.unit**3, 1.0 / weight)
        exact = np.isinf(weight)[:, None] | (lam == 0.0)
        return Path(
            self.time, np.where(exact, value, position + rest), speed / span + rate / self.unit
        )

    def fit_each(
        self, value: Floats, *, lam: Floats, weight: Floats, velocity: Floats | None = None
    ) -> Path:
        """The same with one λ for each column, shape (n_j,)."""
        position, speed = np.empty_like(value), np.empty_like(value)
        for one in np.unique(lam):
            columns = lam == one
            ends = None if velocity is None else velocity[:, columns]
            part = self.fit(value[:, columns], lam=float(one), weight=weight, velocity=ends)
            position[:, columns], speed[:, columns] = part.position, part.velocity
        return Path(self.time, position, speed)

    def _solve(self, y: Floats, lam: float, spread: Floats) -> tuple[Floats, Floats]:
        """Values and slopes at the knots, in knot time.

        Λ in knots³, spread is 1/w, clamped ends have slope 0.
        """
        lam = min(lam, _LAM_CLAMPED) if self.clamped else lam
        p, rough = 1.0 / (1.0 + lam), (1.0 / (1.0 + 1.0 / lam) if lam > 0.0 else 0.0)
        u = np.zeros_like(y)
        if u[self._inner].size:
            u[self._inner] = self._curvature(self._second(y)[self._inner], p, rough, spread)
        y = y - rough * spread[:, None] * self._second(u)
        chord, bend = (y[1:] - y[:-1]) * self._inverse, p * u
        slope = np.empty_like(y)
        slope[:-1] = chord - self._h * (2.0 * bend[:-1] + bend[1:]) / 6.0
        slope[-1] = chord[-1] + self._h[-1] * (bend[-2] + 2.0 * bend[-1]) / 6.0
        if not self._first:
            slope[[0, -1]] = 0.0  # so they are; computed, they carry the rounding of u
        return y, slope

    def _second(self, y: Floats) -> Floats:
        """Q y, and by symmetry Qᵀ y: what the slopes of the chords gain at each knot, zero outside
        the ends.
        """
        chord = (y[1:] - y[:-1]) * self._inverse
        gain = np.empty_like(y)
        gain[0], gain[1:-1], gain[-1] = chord[0], chord[1:] - chord[:-1], -chord[-1]
        return gain

    def _curvature(self, second: Floats, p: float, rough: float, spread: Floats) -> Floats:
        """Solve (p R + rough Qᵀ W⁻¹ Q) u = second for u: pentadiagonal, positive definite, one
        LAPACK call.
        """
        size, first = len(second), self._first
        padded = np.concatenate([[0.0], spread, [0.0]])
        s = np.stack(
            [padded[first + i : first + i + size] for i in range(3)]
        )  # 1/w of the knot before, at and after
        (qq, qq1, qq2), (r, r1) = self._q, self._r
        band = np.zeros((3, size))
        band[2] = p * r + rough * (qq * s).sum(axis=0)
        band[1, 1:] = p * r1 + rough * (qq1 * s[1:, :-1]).sum(axis=0)
        band[0, 2:] = rough * qq2 * s[2, :-2]
        _, u, info = dpbsv(band, second)
        if info:
            raise SpecError(
                f"lam: too smooth for {self.time.size} knots in double precision; choose a higher "
                "cut-off"
            )
        return np.asarray(u)


def fit(
    time: ArrayLike,
    value: ArrayLike,
    *,
    lam: ArrayLike,
    weight: ArrayLike | None = None,
    velocity: ArrayLike | None = None,
) -> Path:
    """Fit a cubic smoothing spline to each column of the samples.

    Minimises Σ w_i (value_i - f(time_i))² + λ ∫ f''² dt. λ = 0 interpolates, λ = ∞ is the weighted
    straight line (between exact ends the chord, between clamped ones the Hermite cubic).

    Args:
        time: Sample times [s], shape (n,), n ≥ 2, strictly increasing.
        value: Samples, shape (n, n_j), rad or any unit.
        lam: λ ≥ 0 [s³] for all columns, or one for each, shape (n_j,); see
            `coordlog.smooth.cutoff`.
        weight: w > 0, shape (n,); infinite where the sample must be met exactly. None: ones, and
            infinite at both ends.
        velocity: Slopes at the first and the last time, shape (2, n_j), which asks for exact ends.
            None: natural ends.

    Returns:
        Path with one break point at each sample time.

    Raises:
        SpecError: if a shape is wrong, time does not increase, a value is not finite, or λ is
            beyond double precision.
    """
    time, value, lam = (np.asarray(each, dtype=float) for each in (time, value, lam))
    _require_samples(time, value, lam)
    w = _exact_ends(len(time)) if weight is None else np.asarray(weight, dtype=float)
    if w.shape != time.shape or not (w > 0.0).all():
        raise SpecError(
            f"weight: expected positive weights of shape {time.shape}; leave a missing sample out, "
            f"got {w}"
        )
    v = None if velocity is None else np.asarray(velocity, dtype=float)
    if v is not None and (
        v.shape != (2, value.shape[1]) or not np.isfinite(v).all() or np.isfinite(w[[0, -1]]).any()
    ):
        raise SpecError(
            f"velocity: expected finite slopes of shape (2, {value.shape[1]}) and infinite weights "
            f"at both ends, got {v}"
        )
    grid = Grid(time, clamped=v is not None)
    return grid.fit_each(value, lam=np.broadcast_to(lam, value.shape[1:]), weight=w, velocity=v)


def _require_samples(time: Floats, value: Floats, lam: Floats) -> None:
    """Refuse samples and λ of a wrong shape or range."""
    if (
        time.ndim != 1
        or len(time) < 2
        or not np.isfinite(time).all()
        or not (np.diff(time) > 0.0).all()
    ):
        raise SpecError(
            "time: expected at least two finite, strictly increasing times [s], got shape "
            f"{time.shape}"
        )
    if value.ndim != 2 or len(value) != len(time) or not np.isfinite(value).all():
        raise SpecError(
            f"value: expected finite samples of shape ({len(time)}, n_j), got shape {value.shape}"
        )
    if lam.shape not in ((), (value.shape[1],)) or not (lam >= 0.0).all():
        raise SpecError(f"lam: expected λ ≥ 0, one or {value.shape[1]} of them, got {lam}")


def _exact_ends(n: int) -> Floats:
    weight = np.ones(n)
    weight[[0, -1]] = np.inf
    return weight


def _hermite(x: Floats, value: Floats, slope: Floats) -> tuple[Floats, Floats]:
    """Value and slope, at x in [0, 1] of shape (n,), of the cubic with given end values and slopes,
    shape (2, n_j).
    """
    x = x[:, None]
    step = value[1] - value[0]
    bend, twist = 3.0 * step - 2.0 * slope[0] - slope[1], slope[0] + slope[1] - 2.0 * step
    return value[0] + x * (slope[0] + x * (bend + x * twist)), slope[0] + x * (
        2.0 * bend + x * 3.0 * twist
    )
