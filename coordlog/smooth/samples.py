"""The times at which candidate paths are looked at, coarse to fine, and the fast way to evaluate a
spline there.
"""

from __future__ import annotations

import numpy as np

from coordlog.path import Floats, Ints, Path
from coordlog.smooth.times import spacing

# knots between the first samples looked at; a smooth path that collides mostly shows it there
_COARSEST = 8


class Samples:
    """All knots but the ends, and at least `dense` samples per typical knot spacing, in levels.

    The end points belong to the log and are the same for every candidate, so they are judged once,
    elsewhere.
    """

    def __init__(self, knot_time: Floats, dense: int) -> None:
        """Lay out samples over knots at `knot_time` [s], shape (n,).

        Dense = 1 is the knots alone.
        """
        h = np.diff(knot_time)
        parts = dense * np.ceil(h / spacing(knot_time) - 1e-6).astype(int)
        piece = np.repeat(np.arange(len(h)), parts)
        part = np.arange(len(piece)) - np.repeat(np.cumsum(parts) - parts, parts)
        x = part / parts[piece]
        self.time: Floats = knot_time[piece] + x * h[piece]
        self._piece = piece
        self._basis = np.stack(
            [
                (1 + 2 * x) * (1 - x) ** 2,
                x * x * (3 - 2 * x),
                h[piece] * x * (1 - x) ** 2,
                h[piece] * x * x * (x - 1),
            ]
        )
        coarse, level = (
            _COARSEST,
            np.where(2 * part == parts[piece], _COARSEST.bit_length(), _COARSEST.bit_length() + 1),
        )
        for depth in range(_COARSEST.bit_length() - 1, -1, -1):
            level[(part == 0) & (piece % (coarse >> depth) == 0)] = depth
        level[0] = -1  # the first knot; the last is not among the samples
        self.levels: list[Ints] = [np.flatnonzero(level == each) for each in range(level.max() + 1)]
        """Indices into `time`, to be looked at in this order."""

    def __call__(self, spline: Path, index: Ints) -> Floats:
        """Positions of a spline over the same knots, shape (len(index), n_j)."""
        piece, (a, b, u, v) = self._piece[index], self._basis[:, index, None]
        return np.asarray(
            a * spline.position[piece]
            + b * spline.position[piece + 1]
            + u * spline.velocity[piece]
            + v * spline.velocity[piece + 1]
        )

    def nearest(self, time: Floats) -> Ints:
        """Index of the sample nearest to each time."""
        after = np.searchsorted(self.time, time).clip(1, len(self.time) - 1)
        return np.asarray(after - (time - self.time[after - 1] < self.time[after] - time))
