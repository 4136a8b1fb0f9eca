"""The rules of one path problem, asked in the order that costs least.

Limits and deviation come first, being free; then the samples that failed last, the knots from
coarse to fine, the samples between them, and the certificate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from coordlog.errors import ConfigError
from coordlog.path import Bools, Floats, Ints, Path
from coordlog.smooth.breach import NONE, Breaches, Kind, breaches
from coordlog.smooth.certificate import certify
from coordlog.smooth.config import Config
from coordlog.smooth.counted import Counted
from coordlog.smooth.feasibility import Checker
from coordlog.smooth.knots import Knots
from coordlog.smooth.limits import Limits, limit_breaches
from coordlog.smooth.raw import Raw
from coordlog.smooth.samples import Samples

_COARSE = 2  # levels of samples that are looked at before the certificate: every fourth knot


class Proof(NamedTuple):
    """What is known about one candidate."""

    found: Breaches
    """Breaches that rule it out, as far as was looked; none if it may be returned."""
    excused: Breaches
    """Breaches of the raw path that the candidate does not make worse."""
    certified: bool
    """Free between the samples too: at the clearance asked, or without touching for pairs excused
    from it."""


class Judge:
    """All rules of one problem."""

    def __init__(
        self, checker: Checker, knots: Knots, raw: Path, *, limits: Limits, config: Config
    ) -> None:
        """Prepare to judge candidates over the same knots as the raw path.

        Raises:
            SpecError: if the checker's answers or the limits do not fit the path.
            ConfigError: if a certificate is wanted of a checker that knows no distances.
        """
        self.asked = Counted(checker)
        if config.certify and not self.asked.measures:
            raise ConfigError(
                "certify: the checker lacks slack, reach or drift; add them, or pass certify=False to trust the samples"
            )
        self.widths = limits.widths(knots.position.shape[1])
        """Lower, upper, speed, acceleration: each (n_j,)."""
        self._pace = limits.paces(knots.position.shape[1])
        self.samples = Samples(knots.time, config.per_knot)
        self._knots, self._config = knots, config
        self._farthest = config.farthest(knots.position.shape[1])
        self.raw = Raw(
            raw, self.asked, self.samples, clearance=config.clearance, widths=self.widths
        )
        self.failed = NONE
        """Why the last candidate that was ruled out was ruled out."""

    def prove(self, spline: Path, *, hot: Ints | None = None, lenient: bool = False) -> Proof:
        """Judge a candidate, up to the first look that finds a breach without excuse.

        Args:
            spline: The candidate.
            hot: Indices of samples that are likely to fail, asked first.
            lenient: Excuse all that the raw path does wrong too, see `Raw.excuses`.
        """
        proof = self.sampled(spline, hot=hot, lenient=lenient)
        return proof if len(proof.found) else self.between(spline, proof, lenient=lenient)

    def early(self, spline: Path, *, hot: Ints | None = None, lenient: bool = False) -> Proof:
        """As `prove`, but the certificate is asked as soon as the hot samples and the coarse ones
        find nothing.

        It needs fewer answers than there are samples, and what it proves needs no further look.
        Where it fails the samples are asked after all, to name all that is wrong and not the first
        of it.
        """
        if not self._config.certify:
            return self.prove(spline, hot=hot, lenient=lenient)
        proof = self._noted(self._sampled(spline, hot, lenient, self.samples.levels[:_COARSE]))
        if len(proof.found):
            return proof
        proof = self.between(spline, proof, lenient=lenient)
        if proof.certified or (proof.found.kind == Kind.MOTION).any():
            return proof
        return self.prove(spline, hot=hot, lenient=lenient)

    def between(self, spline: Path, proof: Proof, *, lenient: bool) -> Proof:
        """Finish what `sampled` began: the certificate, and rules about motion."""
        proof = self._noted(
            self._between(
                spline, proof.excused, lambda found: self.raw.excuses(found, lenient=lenient)
            )
        )
        if len(proof.found):
            return proof
        look = self.asked.moving(spline)
        excuse = self.raw.excuses(look, lenient=lenient)
        if not excuse.all():
            return self._noted(Proof(look[~excuse], proof.excused, certified=False))
        return proof._replace(excused=proof.excused + look)

    def sampled(self, spline: Path, *, hot: Ints | None, lenient: bool) -> Proof:
        """As `prove`, but for the certificate: not yet a proof of what lies between the samples."""
        return self._noted(self._sampled(spline, hot, lenient, self.samples.levels))

    def _noted(self, proof: Proof) -> Proof:
        if len(proof.found):
            self.failed = proof.found
        return proof

    def _sampled(self, spline: Path, hot: Ints | None, lenient: bool, levels: list[Ints]) -> Proof:
        excused = self.raw.ends
        for look in self._looks(spline, [*([] if hot is None else [hot]), *levels]):
            excuse = self.raw.excuses(look, lenient=lenient)
            if (
                excuse & (look.kind == Kind.CONTACT)
            ).any():  # a pair that is excused may hide one that is not
                look = look[look.kind != Kind.CONTACT] + self._every(
                    spline, look.time[look.kind == Kind.CONTACT]
                )
                excuse = self.raw.excuses(look, lenient=lenient)
            if not excuse.all():
                return Proof(look[~excuse], excused, certified=False)
            excused = excused + look
        return Proof(NONE, excused, certified=False)

    def _every(self, spline: Path, time: Floats) -> Breaches:
        return self.asked.every(time, spline(time), self._config.clearance)

    def outpaces(self, spline: Path) -> bool:
        """Whether a joint is faster than `Limits.pace`."""
        return len(limit_breaches(spline, (*self.widths[:2], self._pace, self.widths[3]))) > 0

    def collides(self, spline: Path, found: Breaches) -> bool:
        """Whether a contact found is more than being closer than the clearance."""
        time = found.time[found.kind == Kind.CONTACT]
        if not len(time) or self._config.clearance == 0.0:
            return len(time) > 0
        return not self.asked.check(time, spline(time), 0.0).free.all()

    def survey(self, spline: Path) -> Proof:
        """Judge a path by all rules at all samples, whatever is found."""
        found = self.raw.ends
        for look in self._looks(spline, self.samples.levels):
            found = found + look
        found = found + self.asked.moving(spline)
        proof = self._between(spline, found, lambda found: found.kind == Kind.CONTACT)
        return Proof(proof.excused + proof.found, NONE, proof.certified)

    def _between(
        self, spline: Path, known: Breaches, excuses: Callable[[Breaches], Bools]
    ) -> Proof:
        """Certify a path of which these breaches are known.

        Pairs known to be too close need only not touch.
        """
        while self._config.certify:
            close = np.unique(known.what[known.kind == Kind.CONTACT])
            if len(close) and self.collides(spline, known):
                break
            allowed = np.zeros(len(self.asked.reach))
            allowed[close] = self._config.clearance
            found = certify(spline, self.asked, self._config.clearance, allowed=allowed)
            excuse = excuses(found)
            if not excuse.all():
                return Proof(found[~excuse], known, certified=False)
            if not len(found):
                return Proof(NONE, known, certified=True)
            known = known + found  # another pair each time, or a collision: this ends
        return Proof(NONE, known, certified=False)

    def _looks(self, spline: Path, levels: list[Ints]) -> Iterator[Breaches]:
        """Look after look, each at something new."""
        yield limit_breaches(spline, self.widths) + self._deviation(spline)
        fresh = np.ones(len(self.samples.time), bool)
        for index in levels:
            index = index[fresh[index]]
            if len(index):
                fresh[index] = False
                time = self.samples.time[index]
                yield self.asked.worst(time, self.samples(spline, index), self._config.clearance)

    def _deviation(self, spline: Path) -> Breaches:
        if self._config.max_deviation is None:
            return NONE
        over = self._knots.away(spline) - self._farthest  # NaN, where a joint has no sample
        over = np.where(over > 0.0, over, 0.0)
        bad = over.any(axis=1)
        what = (over / self._farthest).argmax(axis=1)[bad]
        return breaches(Kind.DEVIATION, self._knots.sample_time[bad], over[bad, what], what)
