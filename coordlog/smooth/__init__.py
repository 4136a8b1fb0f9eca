"""Joint trajectories made smooth, and proven no less safe than they were."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from coordlog.verbs import make_verb

if TYPE_CHECKING:
    from coordlog.path import Path
    from coordlog.smooth.feasibility import (
        Checker,
        DistanceChecker,
        MovingChecker,
        Unobstructed,
        Verdict,
    )
    from coordlog.smooth.limits import Limits
    from coordlog.smooth.result import Result, Violation
    from coordlog.smooth.smoother import smooth
    from coordlog.smooth.spline import fit

_HOME = {
    "fit": "smooth.spline",
    "smooth": "smooth.smoother",
    "Limits": "smooth.limits",
    "Path": "path",
    "Result": "smooth.result",
    "Violation": "smooth.result",
}
_HOME |= dict.fromkeys(
    ("Checker", "DistanceChecker", "MovingChecker", "Unobstructed", "Verdict"), "smooth.feasibility"
)

__all__ = [
    "Checker",
    "DistanceChecker",
    "Limits",
    "MovingChecker",
    "Path",
    "Result",
    "Unobstructed",
    "Verdict",
    "Violation",
    "fit",
    "smooth",
]


def __getattr__(name: str) -> Any:
    """Load scipy only once something is used."""
    if name not in _HOME:
        raise AttributeError(f"module 'coordlog.smooth' has no attribute '{name}'")
    return getattr(import_module(f"coordlog.{_HOME[name]}"), name)


make_verb(__name__)
