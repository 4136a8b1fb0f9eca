"""Sample times as they come, turned into seconds, and the typical spacing of samples.

The spacing is a mean, not a median: where two publishers take turns, a median is the short or the
long half of the pattern, and neither says how many samples a second there are.
"""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from coordlog.errors import SpecError
from coordlog.path import Floats

GAP = 10.0
"""Spacings longer than this many typical ones do not count towards the typical one."""
_BLOCK = 8  # samples: publishers taking turns, up to so many, look uniform over such a stretch
_SELDOM = 1e3  # s: no joint is sampled so seldom; such numbers are microseconds or the like
_NEVER = (
    1e11  # s: three thousand years; such stamps count thousandths of seconds since 1970, or less
)
_INSTANT = 1e-12  # s: no joint is sampled so often, and cubes of such spacings vanish
_COARSE = 0.1  # of the spacing: a resolution of the stamps beyond which their order is noise


def spacing(time: Floats) -> float:
    """Typical spacing [s] of increasing times (n,), n ≥ 2: the mean over all that are no gaps."""
    between = np.diff(time)
    width = min(max(len(between) // _BLOCK, 2), _BLOCK, len(between))
    typical = float(np.median((time[width:] - time[:-width]) / width))
    usual = between[between <= GAP * typical]
    return float(usual.mean()) if len(usual) else typical


def seconds(time: ArrayLike) -> Floats:
    """Turn sample times into seconds.

    Args:
        time: Floats [s]; datetime64 or `datetime` (counted from the first sample), timedelta64 or
            `timedelta`.

    Returns:
        Times [s], shape (n,).

    Raises:
        SpecError: if they are integers, which have no unit, coarser than their spacing, masked,
            not finite, decreasing, or no times at all.
    """
    if np.ma.isMaskedArray(time):
        masked = int(np.ma.getmaskarray(time).sum())
        if masked:
            raise SpecError(
                f"time: {masked} of {np.size(time)} times are masked; leave those samples out"
            )
        time = np.ma.getdata(time)
    array = np.asarray(time)
    if array.ndim != 1:
        raise SpecError(f"time: expected shape (n,), got {array.shape}")
    if len(array) < 2:
        raise SpecError(f"time: a path needs at least two samples, got {len(array)}")
    found = _in_seconds(array)
    if not np.isfinite(found).all():
        bad = int((~np.isfinite(found)).sum())
        raise SpecError(
            f"time: expected finite numbers, but {bad} of {len(found)} are not "
            f"(the first is sample {int(np.argmin(np.isfinite(found)))})"
        )
    backwards = np.flatnonzero(np.diff(found) < 0.0)
    if len(backwards):
        raise SpecError(
            f"time: expected times that do not decrease, but sample {backwards[0] + 1} is before "
            f"the one ahead ({len(backwards)} such steps in all); sort the samples, or cut the log "
            "where the clock was set"
        )
    if found[0] == found[-1]:
        raise SpecError("time: expected at least two distinct times, all are the same")
    _require_resolution(found, was=array.dtype)
    return found


def _in_seconds(array: np.ndarray[Any, Any]) -> Floats:
    kind = array.dtype.kind
    if kind == "O":
        array, kind = _of_objects(array)
    if kind in "Mm":
        if np.isnat(array).any():
            raise SpecError(f"time: {int(np.isnat(array).sum())} times are NaT; leave them out")
        return np.asarray((array - array[0] if kind == "M" else array) / np.timedelta64(1, "s"))
    if kind in "iu":
        raise SpecError(
            "time: integers have no unit; pass seconds as floats (time * 1e-9 if they are "
            "nanoseconds), or say the unit with time.astype('timedelta64[ns]')"
        )
    if kind != "f":
        raise SpecError(
            f"time: expected seconds as floats, datetime64 or timedelta64, got {array.dtype}"
        )
    return array.astype(np.float64)


def _of_objects(array: np.ndarray[Any, Any]) -> tuple[np.ndarray[Any, Any], str]:
    first = array[0]
    if all(isinstance(each, timedelta) for each in array):
        return np.array([each.total_seconds() for each in array]), "f"
    if all(isinstance(each, datetime) for each in array):
        try:
            return np.array([(each - first).total_seconds() for each in array]), "f"
        except TypeError as error:
            raise SpecError(f"time: cannot compare these datetimes: {error}") from error
    if all(isinstance(each, float) for each in array):
        return array.astype(np.float64), "f"
    raise SpecError(
        "time: expected seconds as floats, datetime64 or timedelta64, got "
        f"{sorted({type(each).__name__ for each in array})}"
    )


def _require_resolution(time: Floats, *, was: np.dtype[Any]) -> None:
    """Refuse times that were rounded to few digits, or that cannot be seconds."""
    moved = time[np.append(True, np.diff(time) > 0.0)]
    typical, largest = spacing(moved), float(np.abs(time).max())
    if largest > _NEVER or not _INSTANT < typical < _SELDOM:
        raise SpecError(
            f"time: samples are {typical:.3g} apart, the largest is {largest:.3g}, which cannot be "
            "seconds; if these are nanoseconds, pass time * 1e-9 or "
            "time.astype('timedelta64[ns]'), milliseconds, time * 1e-3"
        )
    for kind in (np.float16, np.float32) if was == np.float16 else (np.float32,):
        _require_finer(time, kind, shared=len(time) - len(moved))


def _require_finer(time: Floats, kind: type[np.floating[Any]], *, shared: int) -> None:
    """Refuse times that are numbers of a narrow kind, if those lie far apart there."""
    narrow = time.astype(kind)
    step = float(np.spacing(np.abs(narrow).max()))
    if (narrow == time).all() and step > _COARSE * (time[-1] - time[0]) / (len(time) - 1):
        raise SpecError(
            f"time: these are {kind.__name__} numbers, which lie {step:.3g} s apart at "
            f"{time[-1]:.6g} s: {shared} of {len(time)} samples share a time with another "
            f"({len(time) - shared} distinct times); pass float64 seconds, or datetime64"
        )
