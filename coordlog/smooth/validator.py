"""Validates candidate paths against all rules of one problem, cheapest rules first.

Limits and deviation come first, being free; then the samples that failed last, the knots from
coarse to fine, the samples between them, and the certificate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from coordlog.errors import ConfigError
from coordlog.path import Bools, Floats, Ints, Path
from coordlog.smooth.budget import CountedChecker
from coordlog.smooth.certificate import certify
from coordlog.smooth.config import Config
from coordlog.smooth.feasibility import Checker
from coordlog.smooth.knots import Knots
from coordlog.smooth.limits import Limits, limit_violations
from coordlog.smooth.reference import Reference
from coordlog.smooth.samples import Samples
from coordlog.smooth.violations import NONE, Kind, Violations, violations

_COARSE = 2  # levels of samples that are looked at before the certificate: every fourth knot


class Proof(NamedTuple):
    """What is known about one candidate."""

    found: Violations
    """Violations that rule it out, as far as was looked; none if it may be returned."""
    tolerated: Violations
    """Violations of the reference that the candidate does not make worse."""
    certified: bool
    """Free between the samples too: at the clearance asked, or without touching for pairs tolerated
    from it."""


class Validator:
    """All rules of one problem."""

    def __init__(
        self, checker: Checker, knots: Knots, reference: Path, *, limits: Limits, config: Config
    ) -> None:
        """Prepare to validate candidates over the same knots as the reference.

        Raises:
            SpecError: if the checker's answers or the limits do not fit the path.
            ConfigError: if a certificate is wanted of a checker that knows no distances.
        """
        self.queries = CountedChecker(checker)
        if config.certify and not self.queries.measures:
            raise ConfigError(
                "certify: the checker lacks slack, reach or drift; add them, or pass certify=False "
                "to trust the samples"
            )
        self.bounds = limits.bounds(knots.position.shape[1])
        """Lower, upper, speed, acceleration: each (n_j,)."""
        self._nominal_speed = limits.nominal_speeds(knots.position.shape[1])
        self.samples = Samples(knots.time, config.per_knot)
        self._knots, self._config = knots, config
        self._farthest = config.farthest(knots.position.shape[1])
        self.reference = Reference(
            reference, self.queries, self.samples, clearance=config.clearance, bounds=self.bounds
        )
        self.failed = NONE
        """Why the last candidate that was ruled out was ruled out."""

    def validate(self, spline: Path, *, hints: Ints | None = None, relaxed: bool = False) -> Proof:
        """Validate a candidate, up to the first look that finds a violation not allowed.

        Args:
            spline: The candidate.
            hints: Indices of samples that are likely to fail, asked first.
            relaxed: Allow every violation of the reference, see `Reference.allows`.
        """
        proof = self.sampled(spline, hints=hints, relaxed=relaxed)
        return proof if len(proof.found) else self.between(spline, proof, relaxed=relaxed)

    def early(self, spline: Path, *, hints: Ints | None = None, relaxed: bool = False) -> Proof:
        """As `validate`, but run the certificate right after the hints and the coarse samples pass.

        It needs fewer answers than there are samples, and what it proves needs no further look.
        Where it fails the samples are asked after all, to name all that is wrong and not the first
        of it.
        """
        if not self._config.certify:
            return self.validate(spline, hints=hints, relaxed=relaxed)
        proof = self._noted(self._sampled(spline, hints, relaxed, self.samples.levels[:_COARSE]))
        if len(proof.found):
            return proof
        proof = self.between(spline, proof, relaxed=relaxed)
        if proof.certified or (proof.found.kind == Kind.MOTION).any():
            return proof
        return self.validate(spline, hints=hints, relaxed=relaxed)

    def between(self, spline: Path, proof: Proof, *, relaxed: bool) -> Proof:
        """Finish what `sampled` began: the certificate, and rules about motion."""
        proof = self._noted(
            self._between(
                spline, proof.tolerated, lambda found: self.reference.allows(found, relaxed=relaxed)
            )
        )
        if len(proof.found):
            return proof
        look = self.queries.moving(spline)
        allowed = self.reference.allows(look, relaxed=relaxed)
        if not allowed.all():
            return self._noted(Proof(look[~allowed], proof.tolerated, certified=False))
        return proof._replace(tolerated=proof.tolerated + look)

    def sampled(self, spline: Path, *, hints: Ints | None, relaxed: bool) -> Proof:
        """As `validate`, but for the certificate: no proof yet of what lies between the samples."""
        return self._noted(self._sampled(spline, hints, relaxed, self.samples.levels))

    def _noted(self, proof: Proof) -> Proof:
        if len(proof.found):
            self.failed = proof.found
        return proof

    def _sampled(
        self, spline: Path, hints: Ints | None, relaxed: bool, levels: list[Ints]
    ) -> Proof:
        tolerated = self.reference.ends
        for look in self._looks(spline, [*([] if hints is None else [hints]), *levels]):
            allowed = self.reference.allows(look, relaxed=relaxed)
            if (
                allowed & (look.kind == Kind.CONTACT)
            ).any():  # a pair that is tolerated may hide one that is not
                look = look[look.kind != Kind.CONTACT] + self._every(
                    spline, look.time[look.kind == Kind.CONTACT]
                )
                allowed = self.reference.allows(look, relaxed=relaxed)
            if not allowed.all():
                return Proof(look[~allowed], tolerated, certified=False)
            tolerated = tolerated + look
        return Proof(NONE, tolerated, certified=False)

    def _every(self, spline: Path, time: Floats) -> Violations:
        return self.queries.every(time, spline(time), self._config.clearance)

    def exceeds_nominal_speed(self, spline: Path) -> bool:
        """Whether a joint is faster than `Limits.nominal_speed`."""
        return (
            len(limit_violations(spline, (*self.bounds[:2], self._nominal_speed, self.bounds[3])))
            > 0
        )

    def collides(self, spline: Path, found: Violations) -> bool:
        """Whether a contact found is more than being closer than the clearance."""
        time = found.time[found.kind == Kind.CONTACT]
        if not len(time) or self._config.clearance == 0.0:
            return len(time) > 0
        return not self.queries.check(time, spline(time), 0.0).free.all()

    def report(self, spline: Path) -> Proof:
        """Validator a path by all rules at all samples, whatever is found."""
        found = self.reference.ends
        for look in self._looks(spline, self.samples.levels):
            found = found + look
        found = found + self.queries.moving(spline)
        proof = self._between(spline, found, lambda found: found.kind == Kind.CONTACT)
        return Proof(proof.tolerated + proof.found, NONE, proof.certified)

    def _between(
        self, spline: Path, known: Violations, allows: Callable[[Violations], Bools]
    ) -> Proof:
        """Certify a path of which these violations are known.

        Pairs known to be too close need only not touch.
        """
        while self._config.certify:
            close = np.unique(known.what[known.kind == Kind.CONTACT])
            if len(close) and self.collides(spline, known):
                break
            spare = np.zeros(len(self.queries.reach))
            spare[close] = self._config.clearance
            found = certify(spline, self.queries, self._config.clearance, allowed=spare)
            allowed = allows(found)
            if not allowed.all():
                return Proof(found[~allowed], known, certified=False)
            if not len(found):
                return Proof(NONE, known, certified=True)
            known = known + found  # another pair each time, or a collision: this ends
        return Proof(NONE, known, certified=False)

    def _looks(self, spline: Path, levels: list[Ints]) -> Iterator[Violations]:
        """Look after look, each at something new."""
        yield limit_violations(spline, self.bounds) + self._deviation(spline)
        fresh = np.ones(len(self.samples.time), bool)
        for index in levels:
            index = index[fresh[index]]
            if len(index):
                fresh[index] = False
                time = self.samples.time[index]
                yield self.queries.worst(time, self.samples(spline, index), self._config.clearance)

    def _deviation(self, spline: Path) -> Violations:
        if self._config.max_deviation is None:
            return NONE
        over = self._knots.away(spline) - self._farthest  # NaN, where a joint has no sample
        over = np.where(over > 0.0, over, 0.0)
        bad = over.any(axis=1)
        what = (over / self._farthest).argmax(axis=1)[bad]
        return violations(Kind.DEVIATION, self._knots.sample_time[bad], over[bad, what], what)
