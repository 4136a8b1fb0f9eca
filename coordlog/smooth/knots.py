"""Recorded joint samples made fit to be fitted: one time grid, every joint on its own samples.

The file format calls the points a spline is fitted to *knots*; in the language of splines they are
data points (the break points of the result are its knots). A joint that has no sample at a knot,
because another publisher sent that row, is interpolated there between its own samples, by the cubic
spline through all of them. Whatever is merged, held or interpolated is counted and said, and every
distance is measured to each finite sample as it came in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from coordlog.errors import SpecError
from coordlog.path import Bools, Floats, Ints, Path
from coordlog.smooth.spline import fit
from coordlog.smooth.times import GAP, seconds, spacing
from coordlog.smooth.wrapping import unwrapped

_SAME = 1e-2  # of the spacing: closer times are one sample, or the fit loses three digits and kinks
_CUT = 100.0  # spacings without a sample, beyond which nothing is known of what lies between
_REPEATED = 0.1  # of the samples that share a time and disagree: more are no stray repetitions


@dataclass(frozen=True, eq=False)
class Knots:
    """Data points a path is fitted to, and the samples they were made of."""

    time: Floats  # (K,) s, strictly increasing, K ≥ 2
    position: Floats  # (K, n_j) rad, m for slides
    weight: Floats  # (K,) samples merged into each; infinite at both ends
    sample_time: Floats  # (n,) s, as they came
    sample: Floats  # (n, n_j), as they came, continuous joints unwrapped; NaN where there is none
    notes: tuple[str, ...] = ()
    """What was done to the samples, with counts; empty if each was taken as it came."""
    sound: bool = True
    """Whether no joint had to be held, and none interpolated over more than a few samples."""

    @cached_property
    def unit(self) -> float:
        """Typical spacing [s]."""
        return spacing(self.time)

    @cached_property
    def complete(self) -> bool:
        """Whether the knots are the samples."""
        return self.sample is self.position

    @cached_property
    def _basis(self) -> tuple[Ints, Floats]:
        piece = np.searchsorted(self.time, self.sample_time, side="right") - 1
        piece = piece.clip(0, len(self.time) - 2)
        h = np.diff(self.time)[piece]
        x = ((self.sample_time - self.time[piece]) / h).clip(0.0, 1.0)
        cubes = (
            (1 + 2 * x) * (1 - x) ** 2,
            x * x * (3 - 2 * x),
            h * x * (1 - x) ** 2,
            h * x * x * (x - 1),
        )
        return piece, np.stack(cubes)[..., None]

    def away(self, path: Path) -> Floats:
        """Distance of a path over these knots from every sample, (n, n_j); NaN without a sample."""
        if self.complete:
            return np.abs(path.position - self.position)
        piece, (a, b, u, v) = self._basis
        here = a * path.position[piece] + b * path.position[piece + 1]
        here += u * path.velocity[piece] + v * path.velocity[piece + 1]
        return np.asarray(np.abs(here - self.sample))


class _Report(NamedTuple):
    """Sentences about what was done to the samples."""

    notes: list[str]
    doubts: list[str]
    """Those that leave the path less than `smoothed`."""


def clean(
    time: ArrayLike,
    position: ArrayLike,
    *,
    continuous: Sequence[int] = (),
    joints: Sequence[str] = (),
) -> Knots:
    """Bring recorded samples to one time grid.

    A NaN or a masked entry is a missing sample of that joint alone. Times closer than a hundredth
    of the typical spacing become one knot, the mean of its samples; the first and the last sample
    of each joint there stay exactly as they are.

    Args:
        time: Sample times, shape (n,), not decreasing: seconds as floats, datetime64, timedelta64.
        position: Joint positions, shape (n, n_j).
        continuous: Columns of joints that turn without end [rad], which are unwrapped.
        joints: Names of the columns, for messages.

    Raises:
        SpecError: if a shape is wrong, a time is unusable (see `seconds`), an angle is infinite, a
            stretch of more than 100 spacings has no sample of a joint, more than a tenth of the
            samples share their time with one that says otherwise, or a joint wraps around.
    """
    sample, shape = _numbers(position), np.shape(time)
    if sample.ndim != 2 or shape != sample.shape[:1] or not sample.shape[1]:
        raise SpecError(
            f"q: expected shape (n, n_j) and time of shape (n,), got {sample.shape} and {shape}"
        )
    names = list(joints) or [f"joint {i}" for i in range(sample.shape[1])]
    when = seconds(time)
    if np.isinf(sample).any():
        raise SpecError(
            "time, q: expected finite numbers; only NaN in q is read as a missing sample"
        )
    sample = unwrapped(sample, continuous, names)
    finite = np.isfinite(sample)
    if finite.all() and _regular(when):
        return _knots(when, sample, when, sample, np.ones(len(when)), _Report([], []))
    return _gridded(when, sample, finite, names)


def _numbers(position: Any) -> Floats:
    """Positions as floats, masked entries as NaN."""
    try:
        if np.ma.isMaskedArray(position):
            return np.asarray(np.ma.filled(position.astype(np.float64), np.nan))
        found = np.asarray(position)
        if found.dtype.kind not in "fiuO":
            raise SpecError(f"q: expected numbers, got {found.dtype}")
        return found.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise SpecError(f"q: expected numbers of shape (n, n_j): {error}") from error


def _regular(time: Floats) -> bool:
    between, typical = np.diff(time), spacing(time)
    return bool((between >= _SAME * typical).all() and (between <= GAP * typical).all())


def _gridded(time: Floats, sample: Floats, finite: Bools, names: Sequence[str]) -> Knots:
    """The general case: some samples are missing, some share a time, some are far apart."""
    report, some = _Report([], []), np.asarray(finite.any(axis=1))
    if some.sum() < 2:
        raise SpecError(f"q: a path needs at least two samples, got {int(some.sum())}")
    if not some.all():
        report.notes.append(f"{int((~some).sum())} of {len(some)} samples hold no number at all")
        time, sample, finite = time[some], sample[some], finite[some]
    rows = np.flatnonzero(some)
    moved = time[np.append(True, np.diff(time) > 0.0)]
    if len(moved) < 2:
        raise SpecError("time: expected at least two distinct times; all the others are missing")
    typical = spacing(moved)
    first = np.flatnonzero(np.append(True, np.diff(time) >= _SAME * typical))
    if len(first) < 2:
        raise SpecError(
            "time: expected at least two distinct times; all samples are nearly at once"
        )
    cluster = np.zeros(len(time), np.intp)
    cluster[first[1:]] = 1
    cluster = np.cumsum(cluster)
    _require_no_gap(time, typical, rows, report)
    merged, count = _merged(sample, finite, cluster, len(first), report)
    members = np.bincount(cluster)
    knot_time = np.bincount(cluster, time - time[0]) / members + time[0]
    knot_time[[0, -1]] = time[[0, -1]]
    position = _filled(knot_time, merged, typical, names, report)
    weight = np.maximum(count.sum(axis=1) / np.maximum((count > 0).sum(axis=1), 1), 1.0)
    return _knots(knot_time, position, time, sample, weight, report)


def _knots(
    time: Floats,
    position: Floats,
    sample_time: Floats,
    sample: Floats,
    weight: Floats,
    report: _Report,
) -> Knots:
    weight = weight.copy()
    weight[[0, -1]] = np.inf
    notes = tuple(report.doubts + report.notes)
    return Knots(time, position, weight, sample_time, sample, notes, not report.doubts)


def _require_no_gap(time: Floats, typical: float, rows: Ints, report: _Report) -> None:
    """Refuse a gap over which nothing is known; name a shorter one."""
    between = np.diff(time)
    wide = np.flatnonzero(between > GAP * typical)
    if not len(wide):
        return
    worst = wide[between[wide].argmax()]
    gap = (
        f"a gap of {between[worst]:.6g} s between samples {rows[worst]} and "
        f"{rows[worst + 1]}, where the "
        f"usual spacing is {typical:.3g} s"
    )
    more = f" ({len(wide)} gaps in all)" if len(wide) > 1 else ""
    if between[worst] > _CUT * typical:
        raise SpecError(f"time: {gap}{more}; cut the log there and smooth each part")
    report.doubts.append(f"{gap}{more}: the path there is interpolated")


def _merged(
    sample: Floats, finite: Bools, cluster: Ints, n: int, report: _Report
) -> tuple[Floats, Ints]:
    """Mean of the samples of each joint at each knot, NaN without any, and how many; (n, n_j)."""
    shape = (n, sample.shape[1])
    count, total = np.zeros(shape, np.intp), np.zeros(shape)
    np.add.at(count, cluster, finite)
    np.add.at(total, cluster, np.where(finite, sample, 0.0))
    mean = np.divide(total, count, out=np.full(shape, np.nan), where=count > 0)
    for joint in range(shape[1]):  # ends stay as they are, and one sample is not its mean
        rows = np.flatnonzero(finite[:, joint])
        single = rows[count[cluster[rows], joint] == 1]
        mean[cluster[single], joint] = sample[single, joint]
        begun, ended = rows[cluster[rows] == 0], rows[cluster[rows] == n - 1]
        if len(begun):
            mean[0, joint] = sample[begun[0], joint]
        if len(ended):
            mean[-1, joint] = sample[ended[-1], joint]
    shared = np.flatnonzero((finite & (count[cluster] > 1)).any(axis=1))
    if len(shared):
        agree = ~(np.abs(sample[shared] - mean[cluster[shared]]) > 1e-12).any(axis=1)
        differ, places = int((~agree).sum()), len(np.unique(cluster[shared]))
        total_rows = len(sample)
        if differ > max(_REPEATED * total_rows, 2.0):
            raise SpecError(
                f"time: {len(shared)} of {total_rows} samples share {places} times, and {differ} "
                "of them differ from the others there; are the stamps rounded or float32? pass "
                "the times at full resolution, one per sample"
            )
        report.notes.append(
            f"{len(shared)} of {total_rows} samples share {places} times and were averaged there"
        )
    return mean, count


def _filled(
    time: Floats, merged: Floats, typical: float, names: Sequence[str], report: _Report
) -> Floats:
    """Each joint at every knot, from its own samples alone."""
    found = merged.copy()
    for joint, name in enumerate(names):
        known = np.flatnonzero(np.isfinite(merged[:, joint]))
        if len(known) == len(time):
            continue
        if len(known) < 2:
            raise SpecError(
                f"q: {name} has {len(known)} samples, expected at least two; leave it out"
            )
        lacking = f"{name} has samples at {len(known)} of {len(time)} times"
        own, values = time[known], merged[known, joint]
        held = max(own[0] - time[0], time[-1] - own[-1])
        widest = float(np.diff(own).max())
        if max(held, widest) > _CUT * typical:
            raise SpecError(
                f"q: {lacking}, and none for {max(held, widest):.3g} s, where the usual spacing is "
                f"{typical:.3g} s; leave it out, or cut the log to where it has samples"
            )
        if held > 0.0:
            report.doubts.append(f"{lacking}; it is held where it has none at the ends")
        elif widest > GAP * typical:
            report.doubts.append(f"{lacking}; it is interpolated over {widest:.3g} s")
        else:
            report.notes.append(f"{lacking}; it is interpolated at the others")
        through = fit(own, values[:, None], lam=0.0)
        found[:, joint] = through(time.clip(own[0], own[-1]))[:, 0]
        found[known, joint] = values
    return found
