"""Violations of the input path; results may repeat but not worsen them."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from coordlog.path import Bools, Floats, Path
from coordlog.smooth.budget import CountedChecker
from coordlog.smooth.limits import limit_violations
from coordlog.smooth.samples import Samples
from coordlog.smooth.times import spacing
from coordlog.smooth.violations import NONE, Kind, Violations

_ABOUT = 4  # knots by which a collision may come earlier or later than in the reference
_ALIKE = 1e-4  # m: depths that count as the same
_BLOCK = 512  # samples looked at together; each costs a number for every pair
_LIMITS = (Kind.RANGE, Kind.SPEED, Kind.ACCELERATION, Kind.MOTION)


class Reference:
    """The reference path's violations, computed when first needed."""

    def __init__(
        self,
        spline: Path,
        queries: CountedChecker,
        samples: Samples,
        *,
        clearance: float,
        bounds: tuple[Floats, Floats, Floats, Floats],
    ) -> None:
        """Note limits and end points now, contacts between them when first wanted."""
        self._spline, self._queries, self._samples, self._clearance = (
            spline,
            queries,
            samples,
            clearance,
        )
        self._unit = spacing(spline.time)
        ends = slice(None, None, len(spline.time) - 1)
        self.ends = queries.try_on(spline.time[ends], spline.position[ends], clearance)
        """Contacts of the end points, which no candidate can mend."""
        self._limits = limit_violations(spline, bounds)

    def allows(self, found: Violations, *, relaxed: bool) -> Bools:
        """Which violations a candidate may keep.

        Being closer to something than the clearance, as long as it is no closer than the end points
        are (if relaxed: than the reference is anywhere). If relaxed, also a collision of a pair
        that collides in the reference about then and as deeply, and a limit of a joint, or a rule
        about motion, that the reference exceeds by as much.
        """
        if not relaxed:
            near: Bools = (found.kind == Kind.CONTACT) & (
                found.depth <= np.minimum(self._clearance, _worst(self.ends, found))
            )
            return near
        tolerated = np.zeros(len(found), bool)
        for i in np.flatnonzero(np.isin(found.kind, _LIMITS)):
            known = self._motion if found.kind[i] == Kind.MOTION else self._limits
            same = (known.kind == found.kind[i]) & (known.what == found.what[i])
            tolerated[i] = found.depth[i] <= known.depth[same].max(initial=0.0)
        contact = found.kind == Kind.CONTACT
        if contact.any():
            deep = found.depth > self._clearance
            tolerated |= (
                contact
                & (found.depth <= _worst(self.contacts + self.ends, found))
                & (~deep | self._then(found))
            )
        return tolerated

    @cached_property
    def contacts(self) -> Violations:
        """Contacts of the reference at all samples, of every pair if the checker can tell."""
        found, every = (
            NONE,
            np.concatenate(self._samples.levels) if self._samples.levels else np.zeros(0, np.intp),
        )
        for index in (every[i : i + _BLOCK] for i in range(0, len(every), _BLOCK)):
            found = found + self._queries.every(
                self._samples.time[index], self._samples(self._spline, index), self._clearance
            )
        return found

    @cached_property
    def _motion(self) -> Violations:
        return self._queries.moving(self._spline)

    def _then(self, found: Violations) -> Bools:
        """Which pairs are in contact in the reference at about the same time too."""
        raw = self.contacts
        close = [
            abs(raw.time[raw.what == what] - time).min(initial=np.inf)
            for time, what in zip(found.time, found.what, strict=True)
        ]
        return np.array(close) <= _ABOUT * self._unit


def _worst(known: Violations, found: Violations) -> Floats:
    """Greatest known depth of each pair found, (m,); below zero if it is not known to be short."""
    worst = np.full(max(known.what.max(initial=-1), found.what.max(initial=-1)) + 1, -1.0)
    np.maximum.at(worst, known.what, known.depth + _ALIKE)
    return np.asarray(worst[found.what])
