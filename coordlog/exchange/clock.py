"""Which column of a table is the clock, in which unit, and what its entries are in nanoseconds."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from coordlog.episode import Array
from coordlog.errors import ConfigError, FormatError
from coordlog.exchange.motion import NS

CLOCKS = ("time", "timestamp", "stamp", "t", "%time", "observation.time", "datetime", "elapsed")
"""Names that are a clock's, most likely first; a unit may follow: `time_ms`, `t [s]`."""
UNITS = {"s": NS, "ms": NS // 1000, "us": 1000, "ns": 1}
"""Nanoseconds in each unit."""
_SPELLED = {
    "s": ("s", "sec", "secs", "second", "seconds"),
    "ms": ("ms", "msec", "millis", "milliseconds"),
    "us": ("us", "µs", "usec", "micros", "microseconds"),
    "ns": ("ns", "nsec", "nanos", "nanosec", "nanoseconds"),
}
_UNIT_OF = {word: unit for unit, words in _SPELLED.items() for word in words}
_UNIT = re.compile(rf"[\s_.]*[\[(]?({'|'.join(_UNIT_OF)})[\])]?$")
EPOCHS = (("ns", 1e17), ("us", 1e14), ("ms", 1e11))
"""From which number on a time is one since 1970 in this unit; today is 1.7e9 s."""
SLOW = 2.0
"""Seconds between two samples from which on another unit is suspected."""


def find(names: Sequence[str]) -> str:
    """The column that is most likely the clock; "" if none is."""
    stems = {name: _split(name)[0] for name in names}
    for wanted in CLOCKS:
        for name in names:
            if stems[name] == wanted:
                return name
    return next((name for name in names if name.lower() in _SPELLED["s"][1:]), "")


def is_clock(name: str) -> bool:
    """Whether a column is named as a clock."""
    return bool(find([name]))


def named(asked: str, names: Sequence[str]) -> tuple[str, str]:
    """Column and unit that `--clock COLUMN[:UNIT]` asks for; the unit is "" where it says none.

    Raises:
        ConfigError: if there is no such column or unit.
    """
    if asked in names:
        return asked, ""
    name, _, unit = asked.rpartition(":")
    if name in names and unit in UNITS:
        return name, unit
    if name in names:
        raise ConfigError(f"--clock {asked}: expected a unit of {', '.join(UNITS)}, got '{unit}'")
    raise ConfigError(f"--clock {asked}: the columns are {', '.join(names)}")


def nanoseconds(column: pa.ChunkedArray, where: str, name: str, unit: str) -> tuple[Array, str]:
    """Stamps [ns] of a column, and what was understood of it.

    Args:
        column: Numbers, times, or text in ISO 8601.
        where: File and column, for a message.
        name: Of the column, whose end may be a unit.
        unit: What a person said; "" for what the name or the size of the numbers says.

    Raises:
        FormatError: naming the first row that is no time.
    """
    kind = column.type
    if column.null_count:
        row = int(np.flatnonzero(np.asarray(column.is_null()))[0])
        raise FormatError(f"{where}, row {row}: expected a time, got nothing")
    if pa.types.is_string(kind) or pa.types.is_large_string(kind):
        column, kind = _of_text(column, where)
    if pa.types.is_temporal(kind):
        return _of_times(column, where), "dates and times"
    try:
        values = np.asarray(column.to_numpy())
        seconds = values.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise FormatError(f"{where}: expected times, got {kind}") from error
    bad = np.flatnonzero(~np.isfinite(seconds))
    if len(bad):
        raise FormatError(f"{where}, row {bad[0]}: expected a time, got {values[bad[0]]}")
    largest = float(np.abs(seconds).max(initial=0.0))
    since = next((each for each, least in EPOCHS if largest >= least), "s")
    used = unit or _split(name)[1] or since
    if largest * UNITS[used] >= 2.0**63:
        raise FormatError(f"{where}: expected times in {used}, got {largest:.6g}: another unit")
    whole = np.issubdtype(values.dtype, np.integer)
    stamps = values.astype(np.int64) * UNITS[used] if whole else np.rint(seconds * UNITS[used])
    said = f"in {used}" if unit or _split(name)[1] or used != "s" else ""
    return np.asarray(stamps, np.int64), said


def suspected(stamps: Array, said: str, name: str) -> tuple[str, ...]:
    """A note where nothing names the unit and the samples are too far apart for seconds."""
    steps = np.diff(stamps)
    period = float(np.median(steps)) / NS if len(steps) else 0.0
    if said or period < SLOW:
        return ()
    return (
        f"a sample every {period:.4g} s: '{name}' may be in another unit; --clock {name}:ms (or "
        "us, ns) says so",
    )


def _split(name: str) -> tuple[str, str]:
    """A column's name without its unit, and the unit; "" if it names none."""
    lower = name.lower().strip()
    found = _UNIT.search(lower)
    if found is None or lower in CLOCKS or not found.start():
        return lower, ""
    return lower[: found.start()].rstrip(" _."), _UNIT_OF[found[1]]


def _of_text(column: pa.ChunkedArray, where: str) -> tuple[pa.ChunkedArray, pa.DataType]:
    """Dates and times that were written as text."""
    points = pc.replace_substring(column, ",", ".")
    for kind in (pa.timestamp("ns"), pa.timestamp("ns", "UTC")):
        try:
            return points.cast(kind), kind
        except pa.ArrowInvalid:
            continue
    texts = column.to_pylist()
    raise FormatError(
        f"{where}: expected seconds, or dates and times written alike (ISO 8601), got "
        f"'{texts[0]}' to '{texts[-1]}'"
    )


def _of_times(column: pa.ChunkedArray, where: str) -> Array:
    kind = column.type
    try:
        if pa.types.is_timestamp(kind):
            column = column.cast(pa.timestamp("ns", kind.tz))
        elif pa.types.is_duration(kind):
            column = column.cast(pa.duration("ns"))
        elif pa.types.is_time(kind):
            column = column.cast(pa.time64("ns"))
        else:
            raise FormatError(f"{where}: expected times, got {kind}")
        return np.asarray(column.cast(pa.int64()).to_numpy(), np.int64)
    except pa.ArrowInvalid as error:
        raise FormatError(f"{where}: {str(error).splitlines()[0]}") from error
