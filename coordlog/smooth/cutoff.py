"""Three names of one smoothing parameter: the paper's p, the penalty λ, and the cut-off frequency
in Hz.

p weighs fidelity against roughness over the *step index* (one knot is one unit of time), λ [s³]
weighs roughness over *seconds* (scipy's `lam`), and the cut-off [Hz] is where uniform samples of
period dt are passed at half amplitude:

    p = 1 / (1 + λ / dt³)        cut-off = (λ dt)^(-1/4) / 2π        p = 1 ↔ λ = 0 ↔ ∞ Hz        p =
    0 ↔ λ = ∞ ↔ 0 Hz

With dt = 1 the first line is the p of csaps and MATLAB for an abscissa in seconds. λ is what the
fit computes with: near p = 1 a float cannot tell one p from the next, and in Hz equal steps are
equally audible everywhere.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from coordlog.path import Floats


def lam_from_p(p: ArrayLike, dt: float) -> Floats:
    """λ [s³] of the paper's p in [0, 1] at a knot spacing dt [s]."""
    p = np.asarray(p, dtype=float)
    with np.errstate(divide="ignore"):
        return np.asarray((1.0 - p) / p * dt**3)


def p_from_lam(lam: ArrayLike, dt: float) -> Floats:
    """The paper's p of λ [s³] at a knot spacing dt [s]."""
    return np.asarray(1.0 / (1.0 + np.asarray(lam, dtype=float) / dt**3))


def cutoff_from_lam(lam: ArrayLike, dt: float) -> Floats:
    """Half-amplitude frequency [Hz] of λ [s³] for unit weights at a knot spacing dt [s]."""
    with np.errstate(divide="ignore"):
        return np.asarray((np.asarray(lam, dtype=float) * dt) ** -0.25 / (2.0 * np.pi))


def lam_from_cutoff(cutoff: ArrayLike, dt: float) -> Floats:
    """λ [s³] that passes `cutoff` [Hz] at half amplitude, for unit weights at a knot spacing dt
    [s].
    """
    with np.errstate(divide="ignore"):
        return np.asarray((2.0 * np.pi * np.asarray(cutoff, dtype=float)) ** -4.0 / dt)
