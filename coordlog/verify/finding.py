"""What a check reports: one thing that is not as it should be."""

from __future__ import annotations

from typing import NamedTuple


class Finding(NamedTuple):
    """One divergence: where, what was wanted, what was there."""

    path: str
    level: str
    """file, content or replay"""
    step: int | None
    """The control step it belongs to; None if to none."""
    field: str
    wanted: str
    got: str

    def __str__(self) -> str:
        step = "" if self.step is None else f" step {self.step}:"
        return f"{self.path}:{step} {self.field}: expected {self.wanted}, got {self.got}"


class Problem(NamedTuple):
    """A finding before it is known in which file and at which level."""

    step: int | None
    field: str
    wanted: str
    got: str
