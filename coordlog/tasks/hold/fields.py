"""What the hold task logs of its own, for every step."""

from __future__ import annotations

from coordlog.spec import REACH, Field

FIELDS = (
    Field(
        "goals",
        "float64",
        "3*k",
        "m",
        "goal of each arm before the action, x, y, z",
        when="before",
        owner="hold",
    ),
    *(field._replace(owner="hold") for field in REACH),
)
