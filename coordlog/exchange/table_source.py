"""CSV and Parquet in: a row per sample, a column (or list) of positions per joint.

Columns are found by name: the clock as `clock` says, `episode` or `episode_index` cuts; of the
others those that are told with --columns, or those that are named as positions, or all that are
numbers. What is not taken is named in the notes.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa

from coordlog.episode import Array
from coordlog.errors import ConfigError, FormatError
from coordlog.exchange import clock as clocks
from coordlog.exchange.csv_source import number_text, read_csv
from coordlog.exchange.motion import NS, Motion
from coordlog.exchange.parquet_source import flat, is_number, read_parquet

CUTS = ("episode", "episode_index", "episode_id")
NUMBERS = re.compile(
    r"step|frame|frame_index|index|row|task_index|(unnamed: |__index_level_)?\d*(__)?", re.I
)
"""Columns that count rows: pandas' index, LeRobot's indexes."""
POSITIONS = ("qpos.", "observation.state.", "position.", "positions.", "joint_positions.")
"""Beginnings of columns that are joint positions whatever else is in the table."""
_DEGREES = re.compile(r"(_in)?[\s_./]*[\[(]?(\bdeg|(?<=[_\W])deg|degs|degrees?|°)[\])]?$", re.I)
_DEGREES_FIRST = re.compile(r"^deg(rees?)?[\s_.]+", re.I)
_POSITION = re.compile(r"[._ ]pos(ition)?s?$", re.I)
_UNIT = re.compile(r"\s*(_rad|\[rad\]|\(rad\)|\[m\]|\(m\)|[._]pos(ition)?s?)$", re.I)
_PAIRS = ((".sec", ".nanosec"), (".secs", ".nsecs"), ("_sec", "_nanosec"), ("_sec", "_nsec"))
"""Ends of two columns that are one ROS stamp."""


def motions(
    path: Path,
    *,
    columns: tuple[str, ...] = (),
    clock: str = "",
    rate: float = 0.0,
    degrees: bool = False,
) -> Iterator[Motion]:
    """The episodes in a table.

    Args:
        path: `.csv`, `.tsv` or `.parquet`.
        columns: Those with joint positions; () to find them.
        clock: The column with the time, and its unit: `t` or `t:ms`; "" to find it.
        rate: Samples a second, for a table without a clock.
        degrees: Whether a person has said that angles are in degrees.

    Raises:
        FormatError: if the table cannot be read, naming line or column.
        ConfigError: if clock or columns must be named and are not.
    """
    notes: tuple[str, ...] = ()
    if path.suffix.lower() == ".parquet":
        raw, kind = read_parquet(path), "parquet"
    else:
        (raw, notes), kind = read_csv(path), "csv"
    table = _stamped(flat(path, raw))
    named, unit = _clock(path, table, clock, rate)
    if not len(table):
        raise FormatError(f"{path}: expected a row per sample, got not a single one")
    chosen = _positions(path, table, columns, named)
    _require_radians(path, raw.schema, chosen, degrees)
    position = np.stack([_numbers(path, table, name) for name in chosen], axis=1)
    stamps, said = _stamps(path, table, named, unit, rate)
    notes += clocks.suspected(stamps, said, named) if named else ()
    notes += _left_out(table, chosen, named)
    names = tuple(_joint(name) for name in chosen)
    for number, first, stop in _episodes(path, table):
        rows = slice(first, stop)
        yield Motion(
            path,
            kind,
            number,
            names,
            stamps[rows],
            position[rows],
            clock=f"column '{named}' {said}".rstrip() if named else "row number over rate",
            where={"columns": list(chosen), "clock": named, "rows": [first, stop]},
            notes=notes,
        )


def _stamped(table: pa.Table) -> pa.Table:
    """Seconds and nanoseconds of a ROS stamp, in two columns, as the one column `stamp`."""
    names = table.column_names
    for sec, nanosec in _PAIRS:
        for name in names:
            other = name.removesuffix(sec) + nanosec
            if not name.endswith(sec) or other not in names:
                continue
            whole = np.asarray(table.column(name)).astype(np.int64) * NS
            whole += np.asarray(table.column(other)).astype(np.int64)
            rest = table.drop_columns([name, other])
            return rest.add_column(0, "stamp", pa.array(whole, pa.timestamp("ns")))
    return table


def _clock(path: Path, table: pa.Table, clock: str, rate: float) -> tuple[str, str]:
    if rate:
        return "", ""
    if clock:
        return clocks.named(clock, table.column_names)
    found = clocks.find(table.column_names)
    temporal = [item.name for item in table.schema if pa.types.is_temporal(item.type)]
    if not found and len(temporal) == 1:
        return temporal[0], ""
    if not found:
        raise ConfigError(
            f"{path}: no column of time; name it with --clock, or say --rate HZ: the columns are "
            f"{', '.join(table.column_names)}"
        )
    return found, ""


def _positions(
    path: Path, table: pa.Table, columns: tuple[str, ...], clock: str
) -> tuple[str, ...]:
    missing = [name for name in columns if name not in table.column_names]
    if missing:
        raise ConfigError(
            f"{path}: no column '{missing[0]}'; the columns are {', '.join(table.column_names)}"
        )
    if columns:
        return columns
    free = [name for name in table.column_names if name != clock and not _is_other(name)]
    for beginning in POSITIONS:
        if any(name.startswith(beginning) for name in free):
            return tuple(name for name in free if name.startswith(beginning))
    by_name = [name for name in free if _POSITION.search(name)]
    if by_name:
        return tuple(by_name)
    for name in free:
        if pa.types.is_string(table.column(name).type):
            number_text(path, table, name)
    found = [name for name in free if is_number(table.column(name).type)]
    if not found:
        had = ", ".join(f"{item.name} ({item.type})" for item in table.schema)
        raise FormatError(f"{path}: no column of joint positions; the columns are {had}")
    return tuple(found)


def _is_other(name: str) -> bool:
    return name.lower() in CUTS or clocks.is_clock(name) or bool(NUMBERS.fullmatch(name))


def _left_out(table: pa.Table, chosen: Sequence[str], clock: str) -> tuple[str, ...]:
    """Columns that hold something and were not taken, but for those that count."""
    lost = [
        name or "a column without a name"
        for name in table.column_names
        if name not in (*chosen, clock)
        and name.lower() not in CUTS
        and not (name and NUMBERS.fullmatch(name))
    ]
    return (f"columns that were not taken: {', '.join(lost)}",) if lost else ()


def _require_radians(path: Path, schema: pa.Schema, chosen: Sequence[str], degrees: bool) -> None:
    """Hold columns to be in radians, by their names and by the unit in their metadata."""
    for name in chosen:
        place = schema.get_field_index(name)
        about = (schema.field(place).metadata or {}) if place >= 0 else {}
        unit = about.get(b"unit", b"").decode("utf-8", "replace")
        marked = _DEGREES.search(name) or _DEGREES_FIRST.search(name) or _DEGREES.search(" " + unit)
        if marked and not degrees:
            raise FormatError(
                f"{path}: column '{name}': expected radians, its name says degrees; pass "
                "--degrees to turn them"
            )


def _joint(name: str) -> str:
    """The joint that a column is of: its name without what says unit and kind."""
    bare = _UNIT.sub("", _DEGREES_FIRST.sub("", _DEGREES.sub("", name)))
    for beginning in POSITIONS:
        bare = bare.removeprefix(beginning)
    return bare.split(".position.")[-1] or name


def _numbers(path: Path, table: pa.Table, name: str) -> Array:
    column = table.column(name)
    if column.null_count:
        row = int(np.flatnonzero(np.asarray(column.is_null()))[0])
        raise FormatError(f"{path}: column '{name}', row {row}: expected a number, got nothing")
    try:
        return np.asarray(column.to_numpy(), np.float64)
    except (ValueError, TypeError) as error:
        raise FormatError(
            f"{path}: column '{name}': expected numbers, got {column.type}"
        ) from error


def _stamps(path: Path, table: pa.Table, clock: str, unit: str, rate: float) -> tuple[Array, str]:
    if not clock:
        return np.asarray(np.rint(np.arange(len(table)) / rate * NS), np.int64), ""
    return clocks.nanoseconds(table.column(clock), f"{path}: column '{clock}'", clock, unit)


def _episodes(path: Path, table: pa.Table) -> Iterator[tuple[str, int, int]]:
    """Name, first row and end of each episode.

    Raises:
        FormatError: if the rows of an episode do not stand together.
    """
    cut = next((name for name in table.column_names if name.lower() in CUTS), "")
    if not cut:
        yield "all rows", 0, len(table)
        return
    numbers = np.asarray(table.column(cut))
    edges = [0, *(np.flatnonzero(numbers[1:] != numbers[:-1]) + 1).tolist(), len(table)]
    seen = set()
    for first, stop in itertools.pairwise(edges):
        if numbers[first] in seen:
            raise FormatError(
                f"{path}: column '{cut}', row {first}: {numbers[first]} comes again after others; "
                "sort the rows by it first"
            )
        seen.add(numbers[first])
        yield f"{cut} {numbers[first]}", first, stop
