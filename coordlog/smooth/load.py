"""How hard a path is on the servos and on the balance, from the path alone: what its execution is
measured for as well.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coordlog.kinematics.inverse_dynamics import Inverse
from coordlog.path import Path
from coordlog.smooth.metrics import torque_peak, torque_rate

_REST = 2  # samples of rest ahead and behind: the differences of the outer one see rest alone


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
