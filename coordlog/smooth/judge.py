"""The rules of one path problem, asked in the order that costs least.

Limits and deviation come first, being free; then the samples that failed last, the knots from coarse to fine, the samples
between them, and the certificate.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from coordlog.errors import ConfigError
from coordlog.smooth.arrays import Bools, Floats, Ints
from coordlog.smooth.breach import NONE, Breaches, Kind, breaches
from coordlog.smooth.certificate import certify
from coordlog.smooth.config import Config
from coordlog.smooth.counted import Counted
from coordlog.smooth.feasibility import Checker, Verdict
from coordlog.smooth.knots import Knots
from coordlog.smooth.limits import Limits, limit_breaches
from coordlog.smooth.samples import Samples
from coordlog.smooth.spline import Spline

_STRETCH = 8  # knots around a breach of the raw path over which its worst depth is looked for
_ALIKE = 1e-6  # m: depths that count as the same
_LIMITS = (Kind.RANGE, Kind.SPEED, Kind.ACCELERATION)


class Proof(NamedTuple):
    """What is known about one candidate."""

    found: Breaches
    """Breaches that rule it out, as far as was looked; none if it may be returned."""
    excused: Breaches
    """Breaches of the raw path that the candidate does not make worse."""
    certified: bool
    """Free between the samples too: at the clearance asked or, where the raw path has less, without touching."""


class Judge:
    """All rules of one problem."""

    def __init__(self, checker: Checker, knots: Knots, raw: Spline, *, limits: Limits, config: Config) -> None:
        """Prepare to judge candidates over the same knots as the raw path.

        Raises:
            SpecError: if the checker's answers or the limits do not fit the path.
            ConfigError: if a certificate is wanted of a checker that knows no distances.
        """
        self.asked = Counted(checker)
        if config.certify and not self.asked.measures:
            raise ConfigError("certify: the checker lacks slack, reach or drift; add them, or pass certify=False to trust the samples")
        self.widths = limits.widths(knots.position.shape[1])
        """Lower, upper, speed, acceleration: each (n_j,)."""
        self.samples = Samples(knots.time, config.per_knot)
        self._knots, self._raw, self._config = knots, raw, config
        self._raw_limits = limit_breaches(raw, self.widths)
        self._raw_depth = np.full(len(self.samples.time), np.nan)  # NaN: not asked yet
        self._raw_what = np.full(len(self.samples.time), -1)
        ends = slice(None, None, len(knots.time) - 1)
        verdict = self.asked.try_on(knots.time[ends], knots.position[ends], config.clearance)
        self.ends = _contacts(knots.time[ends], verdict)
        """Breaches of the end points, which no candidate can mend."""
        self.failed = NONE
        """Why the last candidate that was ruled out was ruled out."""

    def prove(self, spline: Spline, *, hot: Ints | None = None, lenient: bool = False) -> Proof:
        """Judge a candidate, up to the first look that finds a breach without excuse.

        Args:
            spline: The candidate.
            hot: Indices of samples that are likely to fail, asked first.
            lenient: Excuse breaches that the raw path commits too, and no less deeply; called for if the ends break a rule.
        """
        proof = self._prove(spline, hot=hot, lenient=lenient)
        if len(proof.found):
            self.failed = proof.found
        return proof

    def _prove(self, spline: Spline, *, hot: Ints | None, lenient: bool) -> Proof:
        excused = self.ends if lenient else NONE
        for look in self._looks(spline, hot):
            excuse = self.excuses(look) if lenient else np.zeros(len(look), bool)
            if not excuse.all():
                return Proof(look[~excuse], excused, certified=False)
            excused = excused + look
        between, certified = self._between(spline, excused)
        return Proof(between, excused, certified)

    def collides(self, spline: Spline, found: Breaches) -> bool:
        """Whether a contact found is more than being closer than the clearance."""
        time = found.time[found.kind == Kind.CONTACT]
        if not len(time) or self._config.clearance == 0.0:
            return len(time) > 0
        return not self.asked.check(time, spline(time), 0.0).free.all()

    def survey(self, spline: Spline) -> Proof:
        """Judge a path by all rules at all samples, whatever is found."""
        found = self.ends
        for look in self._looks(spline, None):
            found = found + look
        between, certified = self._between(spline, found)
        return Proof(found + between, NONE, certified)

    def _between(self, spline: Spline, found: Breaches) -> tuple[Breaches, bool]:
        """Breaches between samples, and whether there are proven to be none; at no clearance where the samples lack it."""
        contact = (found.kind == Kind.CONTACT).any()
        if not self._config.certify or (contact and self.collides(spline, found)):
            return NONE, False
        between = certify(spline, self.asked, 0.0 if contact else self._config.clearance)
        return between, not len(between)

    def excuses(self, found: Breaches) -> Bools:
        """Which breaches the raw path commits too, and no less deeply; no smoothing could be asked to mend them."""
        excused = np.zeros(len(found), bool)
        for i in np.flatnonzero(np.isin(found.kind, _LIMITS)):
            same = (self._raw_limits.kind == found.kind[i]) & (self._raw_limits.what == found.what[i])
            excused[i] = found.depth[i] <= self._raw_limits.depth[same].max(initial=0.0)
        contact = np.flatnonzero(found.kind == Kind.CONTACT)
        excused[contact] = self._excuses_contact(found[contact])
        return excused

    def _excuses_contact(self, found: Breaches) -> Bools:
        nearest = self.samples.nearest(found.time)
        self._ask_about_raw(nearest)
        too: Bools = self._raw_what[nearest] == found.what
        if too.any():
            self._ask_about_raw(self.samples.near(found.time[too], _STRETCH * self._knots.unit))
        for i in np.flatnonzero(too):
            too[i] = found.depth[i] <= np.nanmax(self._raw_depth[self._raw_what == found.what[i]]) + _ALIKE
        return too

    def _ask_about_raw(self, index: Ints) -> None:
        """Ask about the raw path, at most once for each sample."""
        index = np.unique(index[np.isnan(self._raw_depth[index])])
        if len(index):
            verdict = self.asked.check(self.samples.time[index], self.samples(self._raw, index), self._config.clearance)
            self._raw_depth[index], self._raw_what[index] = verdict.depth, verdict.what

    def _looks(self, spline: Spline, hot: Ints | None) -> Iterator[Breaches]:
        """Look after look, each at something new."""
        yield limit_breaches(spline, self.widths) + self._deviation(spline)
        fresh = np.ones(len(self.samples.time), bool)
        for index in [*([] if hot is None else [hot]), *self.samples.levels]:
            index = index[fresh[index]]
            if len(index):
                fresh[index] = False
                time = self.samples.time[index]
                yield _contacts(time, self.asked.check(time, self.samples(spline, index), self._config.clearance))

    def _deviation(self, spline: Spline) -> Breaches:
        if self._config.max_deviation is None:
            return NONE
        away = abs(spline.position - self._knots.position)
        over = away.max(axis=1) - self._config.max_deviation
        bad = over > 0.0
        return breaches(Kind.DEVIATION, self._knots.time[bad], over[bad], away.argmax(axis=1)[bad])


def _contacts(time: Floats, verdict: Verdict) -> Breaches:
    free, depth, what = verdict
    return breaches(Kind.CONTACT, time[~free], depth[~free], what[~free])
