"""How smooth a motion is: figures that lower is better of, except SPARC, which is better the closer
to zero.

All take uniform samples. Where a motion begins and ends at rest the jumps at its ends count, so
jerk, acceleration and LDLJ see the samples padded with rest on both sides.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from coordlog.path import Floats, Path
from coordlog.smooth.knots import Knots

if TYPE_CHECKING:
    from coordlog.kinematics.inverse_dynamics import Inverse

_REST = 2  # samples of rest ahead and behind: the differences of the outer one see rest alone


class Metrics(NamedTuple):
    """Figures of one path over all joints."""

    jerk: float
    """Root mean square over time of |q'''| [rad/s³], rest-padded."""
    acceleration: float
    """Root mean square over time of |q''| [rad/s²], rest-padded."""
    sparc: float
    """Spectral arc length of the speed |q'|, ≤ 0."""
    ldlj: float
    """Log dimensionless jerk, rest-padded; lower is smoother."""
    path_length: float
    """Σ |Δq| [rad]."""
    max_deviation: float
    """Largest distance of any joint from any sample that came in, in the unit of the joint."""
    end_error: float
    """Largest distance of a joint from the log at either end [rad]."""


class PathLoad(NamedTuple):
    """Figures of inverse dynamics along a path, rest-padded as its jerk is: a path that jumps off
    pays for the jump.
    """

    rate: float
    """Root mean square over time of |Δτ| / Δt of the action joints [Nm/s]."""
    floor: float
    """|τ_last - τ_first| / duration: no path between the same end points in the same time has a
    smaller rate [Nm/s]."""
    peak: float
    """Largest |τ| of any action joint [Nm]."""
    balance: float
    """Least signed distance of the zero-moment point to the edge of the support polygon [m].

    Infinite for a robot without feet.
    """

    @classmethod
    def of(cls, path: Path, inverse: Inverse, period: float) -> PathLoad:
        """Of a path of the episode that `inverse` is of, sampled every `period` seconds.

        Velocities and accelerations by differences.
        """
        n = max(2, round((path.time[-1] - path.time[0]) / period) + 1)
        time, step = np.linspace(path.time[0], path.time[-1], n, retstep=True)
        dt = float(step)
        q = np.pad(path(time), ((_REST, _REST), (0, 0)), mode="edge")
        velocity, acceleration = (
            (q[2:] - q[:-2]) / (2.0 * dt),
            (q[2:] - 2.0 * q[1:-1] + q[:-2]) / dt**2,
        )
        torque, balance = inverse(
            np.pad(time, _REST - 1, mode="edge"), q[1:-1], velocity, acceleration
        )
        floor = float(np.linalg.norm(torque[-1] - torque[0])) / (dt * (len(torque) - 1))
        return cls(torque_rate(torque, dt), floor, torque_peak(torque), float(balance.min()))


def measure(path: Path, knots: Knots) -> Metrics:
    """Figures of a path, sampled at the log's typical period, and how far it lies from the log."""
    (q, dt), away = _uniform(path, knots), knots.away(path)
    ends = np.abs(path.position[[0, -1]] - knots.position[[0, -1]])
    return Metrics(
        jerk=jerk(q, dt),
        acceleration=acceleration(q, dt),
        sparc=sparc(speed(q, dt), dt),
        ldlj=log_dimensionless_jerk(q, dt),
        path_length=path_length(q),
        max_deviation=float(np.nanmax(away)),
        end_error=float(ends.max()),
    )


def jerk_of(path: Path, knots: Knots) -> float:
    """The jerk of `Metrics` alone."""
    return jerk(*_uniform(path, knots))


def _uniform(path: Path, knots: Knots) -> tuple[Floats, float]:
    n = max(2, round((path.time[-1] - path.time[0]) / knots.unit) + 1)
    time, dt = np.linspace(path.time[0], path.time[-1], n, retstep=True)
    return path(time), float(dt)


def jerk(q: Floats, dt: float) -> float:
    """Root mean square of the third difference over dt³ of samples (n, n_j), rest-padded."""
    return _rms(q, dt, 3)


def acceleration(q: Floats, dt: float) -> float:
    """Root mean square of the second difference over dt² of samples (n, n_j), rest-padded."""
    return _rms(q, dt, 2)


def speed(q: Floats, dt: float) -> Floats:
    """Speed |Δq| / dt between samples (n, n_j), shape (n - 1,)."""
    return np.asarray(np.linalg.norm(np.diff(q, axis=0), axis=1) / dt)


def path_length(q: Floats) -> float:
    """Length of the polyline through samples (n, n_j), of joints [rad] or of a hand [m]."""
    return float(np.linalg.norm(np.diff(q, axis=0), axis=1).sum())


def log_dimensionless_jerk(q: Floats, dt: float) -> float:
    """Log of ∫ |q'''|² dt · T³ / max |q'|², rest-padded; -∞ for a motion that does not move.

    Source: Balasubramanian et al. 2015, J. NeuroEng. Rehabil. 12:112 (there with the opposite
    sign).
    """
    fastest, duration = speed(q, dt).max(), dt * (len(q) - 1)
    if fastest == 0.0:
        return -np.inf
    energy = (_padded_difference(q, dt, 3) ** 2).sum() * dt
    return float(np.log(energy * duration**3 / fastest**2))


def sparc(speed: Floats, dt: float, *, cutoff: float = 10.0, threshold: float = 0.05) -> float:
    """Spectral arc length: the length of the normalised spectrum of a speed profile, negated.

    Args:
        speed: Speed at uniform times, shape (n,).
        dt: Sample period [s].
        cutoff: Highest frequency looked at [Hz].
        threshold: The spectrum is cut where it stays below this share of its peak.

    Source: Balasubramanian et al. 2015, J. NeuroEng. Rehabil. 12:112.
    """
    if not speed.any():
        return 0.0
    n = 2 ** (int(np.ceil(np.log2(len(speed)))) + 4)
    frequency, size = np.fft.rfftfreq(n, dt), abs(np.fft.rfft(speed, n))
    low = frequency <= cutoff
    frequency, size = frequency[low], size[low] / size.max()
    above = np.flatnonzero(size >= threshold)
    frequency, size = frequency[above[0] : above[-1] + 1], size[above[0] : above[-1] + 1]
    if len(frequency) < 2:
        return 0.0
    return float(
        -np.hypot(np.diff(frequency) / (frequency[-1] - frequency[0]), np.diff(size)).sum()
    )


def torque_rate(torque: Floats, dt: float) -> float:
    """Root mean square over time of |Δτ| / dt [Nm/s] of torques (n, n_u)."""
    return float(np.sqrt((np.diff(torque, axis=0) ** 2).sum() / (len(torque) - 1)) / dt)


def torque_peak(torque: Floats) -> float:
    """Largest |τ| of any joint [Nm], torques (n, n_u)."""
    return float(abs(torque).max())


def _rms(q: Floats, dt: float, order: int) -> float:
    return float(np.sqrt((_padded_difference(q, dt, order) ** 2).sum() / len(q)))


def _padded_difference(q: Floats, dt: float, order: int) -> Floats:
    padded = np.concatenate([np.repeat(q[:1], order, axis=0), q, np.repeat(q[-1:], order, axis=0)])
    return np.asarray(np.diff(padded, order, axis=0) / dt**order)
