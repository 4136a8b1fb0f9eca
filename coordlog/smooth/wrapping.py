"""Joints that turn without end, logged in a range of one turn: unwrapped, or refused by name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coordlog.errors import SpecError
from coordlog.path import Floats, Ints

_TURN = 2.0 * np.pi


def unwrapped(sample: Floats, continuous: Sequence[int], names: Sequence[str]) -> Floats:
    """Unwrap continuous joints; refuse others that step by about a turn from sample to sample."""
    if any(not -sample.shape[1] <= joint < sample.shape[1] for joint in continuous):
        raise SpecError(f"continuous: expected columns of {sample.shape[1]} joints: {continuous}")
    turning = {joint % sample.shape[1] for joint in continuous}
    found = sample
    for joint, name in enumerate(names):
        rows = np.flatnonzero(np.isfinite(sample[:, joint]))
        column = sample[rows, joint]
        step = np.abs(np.diff(column))
        if not (step > np.pi).any():
            continue
        if joint in turning:
            found = found.copy() if found is sample else found
            found[rows, joint] = np.unwrap(column)
            continue
        wraps = _wraps(step)
        if len(wraps):
            at = rows[wraps[0]]
            raise SpecError(
                f"q: {name} steps by {step[wraps[0]]:.3g} rad, about a whole turn, from sample "
                f"{at} to {rows[wraps[0] + 1]} ({len(wraps)} such steps); if it turns without end, "
                f"unwrap it first (np.unwrap) or pass continuous=[{joint}]"
            )
    return found


def _wraps(step: Floats) -> Ints:
    """Steps that are a wrap by their size: small again once unwrapped, large beside the others."""
    others = step[step <= np.pi].max(initial=0.0)
    if len(step) < 3 and others == 0.0:
        return np.zeros(0, np.intp)  # two or three way points say nothing of what is usual
    rest = np.abs(step - _TURN * np.round(step / _TURN))
    return np.flatnonzero((step > np.pi) & (rest <= 1.2 * others + 0.05) & (step >= 2.0 * others))
