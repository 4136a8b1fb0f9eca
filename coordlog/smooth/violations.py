"""Where a path breaks a rule: the same record for collisions, limits and deviation."""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import IntEnum

import numpy as np

from coordlog.path import Floats, Ints


class Kind(IntEnum):
    """The rule that is broken, and the unit of its depth."""

    CONTACT = 0  # m: a pair of the checker, the clearance counted
    RANGE = 1  # rad
    SPEED = 2  # rad/s
    ACCELERATION = 3  # rad/s²
    DEVIATION = 4  # rad
    UNPROVEN = 5  # m: free at every sample, but the certificate cannot be closed here
    MOTION = 6  # m: what a checker says about velocity and acceleration


@dataclass(frozen=True, eq=False)
class Violations:
    """All violations found in one look at a path, arrays of shape (m,)."""

    kind: Ints
    time: Floats  # s
    depth: Floats  # ≥ 0, unit as of the kind
    what: Ints  # index of the pair (CONTACT, UNPROVEN) or of the joint

    def __len__(self) -> int:
        """Number of violations m."""
        return len(self.kind)

    def __getitem__(self, index: object) -> Violations:
        """Those that a mask or index array picks."""
        return Violations(*(getattr(self, field.name)[index] for field in fields(self)))

    def __add__(self, other: Violations) -> Violations:
        """Both."""
        return Violations(
            *(
                np.concatenate([getattr(self, field.name), getattr(other, field.name)])
                for field in fields(self)
            )
        )


def violations(kind: Kind, time: Floats, depth: Floats, what: Ints) -> Violations:
    """Violations that are all of one kind."""
    return Violations(np.full(len(time), int(kind)), time, depth, what)


NONE = violations(Kind.CONTACT, np.zeros(0), np.zeros(0), np.zeros(0, np.intp))
"""No violation at all."""
