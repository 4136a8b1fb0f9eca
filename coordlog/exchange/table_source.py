"""CSV and Parquet in: a row per sample, a column (or list) of positions per joint.

Columns are found by name: `time`, `timestamp` or `stamp` is the clock, `episode` or `episode_index`
cuts; of the others those that are told with --columns, or all of `qpos`, or all that are
numbers. Time is in seconds, or in nanoseconds where it is whole and that large.
"""

from __future__ import annotations

import io
import itertools
import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc
import pyarrow.parquet as pq

from coordlog.episode import Array
from coordlog.errors import ConfigError, FormatError
from coordlog.exchange.motion import NS, Motion

CLOCKS = ("time", "timestamp", "stamp", "t", "time_s", "time [s]", "observation.time")
CUTS = ("episode", "episode_index", "episode_id")
NUMBERS = ("step", "frame", "frame_index", "index", "row")
_DEGREES = re.compile(r"(_deg|_degrees|\[deg\]|\(deg\)|\[°\]|\(°\)|°)$", re.IGNORECASE)
_UNIT = re.compile(r"\s*(_rad|\[rad\]|\(rad\)|\[m\]|\(m\)|[._]pos(ition)?)$", re.IGNORECASE)
_DECIMAL_COMMA = re.compile(rb'(^|[;\t"])-?\d+,\d+($|[;\t"\r])', re.MULTILINE)
MANY_NS = 1e15
"""Whole times above this are nanoseconds since some epoch, not seconds."""


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
        clock: The column with the time; "" to find it.
        rate: Samples a second, for a table without a clock.
        degrees: Whether a person has said that angles are in degrees.

    Raises:
        FormatError: if the table cannot be read, naming line or column.
        ConfigError: if clock or columns must be named and are not.
    """
    table = _flat(_parquet(path) if path.suffix == ".parquet" else _csv(path))
    named = _clock(path, table, clock, rate)
    chosen = _positions(path, table, columns, named)
    marked = [name for name in chosen if _DEGREES.search(name)]
    if marked and not degrees:
        raise FormatError(
            f"{path}: column '{marked[0]}': expected radians, its name says degrees; pass "
            "--degrees to turn them"
        )
    position = np.stack([_numbers(path, table, name) for name in chosen], axis=1)
    stamps = _stamps(path, table, named, rate)
    names = tuple(_UNIT.sub("", _DEGREES.sub("", name)).removeprefix("qpos.") for name in chosen)
    cut = next((name for name in CUTS if name in table.column_names), "")
    numbers = np.asarray(table.column(cut)) if cut else np.zeros(len(table), np.int64)
    edges = [0, *(np.flatnonzero(numbers[1:] != numbers[:-1]) + 1).tolist(), len(table)]
    for first, stop in itertools.pairwise(edges):
        rows = slice(first, stop)
        yield Motion(
            path,
            "parquet" if path.suffix == ".parquet" else "csv",
            f"{cut} {numbers[first]}" if cut and len(table) else "all rows",
            names,
            stamps[rows],
            position[rows],
            clock=f"column '{named}'" if named else "row number over rate",
            where={"columns": list(chosen), "clock": named, "rows": [first, stop]},
        )


def _csv(path: Path) -> pa.Table:
    """A CSV, whatever its line ends; its byte order mark, if any, left out."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise FormatError(f"{path}: cannot be read: {error.strerror}") from error
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise FormatError(f"{path}: expected UTF-8, got UTF-16; save it as UTF-8")
    data = data.removeprefix(b"\xef\xbb\xbf")
    head = data.split(b"\n", 1)[0].rstrip(b"\r")
    if not head:
        raise FormatError(f"{path}: expected a header of column names in line 1, got none")
    delimiter = max((",", ";", "\t"), key=lambda each: head.count(each.encode()))
    found = _DECIMAL_COMMA.search(data) if delimiter != "," else None
    if found:
        line = data.count(b"\n", 0, found.start(0) + 1) + 1
        text = found.group(0).strip(b';\t"\r\n').decode()
        raise FormatError(
            f"{path}: line {line}: expected numbers with a decimal point, got '{text}'; save it "
            "with points"
        )
    try:
        return pc.read_csv(
            io.BytesIO(data),
            parse_options=pc.ParseOptions(delimiter=delimiter),
            convert_options=pc.ConvertOptions(null_values=[""]),
        )
    except pa.ArrowInvalid as error:
        raise FormatError(f"{path}: {str(error).splitlines()[0]}") from error


def _parquet(path: Path) -> pa.Table:
    try:
        return pq.read_table(path)
    except (pa.ArrowException, OSError) as error:
        raise FormatError(f"{path}: {str(error).splitlines()[0]}") from error


def _flat(table: pa.Table) -> pa.Table:
    """Lists of one length as columns of their own, `NAME.ENTRY`."""
    columns: dict[str, pa.ChunkedArray] = {}
    for item in table.schema:
        column = table.column(item.name)
        if not pa.types.is_fixed_size_list(item.type):
            columns[item.name] = column
            continue
        width = item.type.list_size
        about = (item.metadata or {}).get(b"names", b"")
        labels = json.loads(about) if about else [str(i) for i in range(width)]
        values = column.combine_chunks().flatten()
        for i, label in enumerate(labels):
            columns[f"{item.name}.{label}"] = values.take(pa.array(range(i, len(values), width)))
    return pa.table(columns)


def _clock(path: Path, table: pa.Table, clock: str, rate: float) -> str:
    if rate:
        return ""
    if clock and clock not in table.column_names:
        raise ConfigError(
            f"{path}: --clock {clock}: the columns are {', '.join(table.column_names)}"
        )
    lower = {name.lower(): name for name in table.column_names}
    found = clock or next((lower[name] for name in CLOCKS if name in lower), "")
    if not found:
        raise ConfigError(
            f"{path}: no column of time; name it with --clock, or say --rate HZ: the columns are "
            f"{', '.join(table.column_names)}"
        )
    return found


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
    known = {clock, *CLOCKS, *CUTS, *NUMBERS}
    free = [name for name in table.column_names if name.lower() not in known and name != clock]
    of_qpos = [name for name in free if name.startswith("qpos.")]
    text = [name for name in free if pa.types.is_string(table.column(name).type)]
    if text and not of_qpos:
        raise FormatError(
            f"{path}: column '{text[0]}': expected numbers, got text such as "
            f"'{table.column(text[0])[0]}'; choose columns with --columns"
        )
    found = of_qpos or [name for name in free if _is_number(table.column(name).type)]
    if not found:
        raise FormatError(
            f"{path}: no column of joint positions; the columns are {', '.join(table.column_names)}"
        )
    return tuple(found)


def _is_number(kind: pa.DataType) -> bool:
    return bool(pa.types.is_floating(kind) or pa.types.is_integer(kind))


def _numbers(path: Path, table: pa.Table, name: str) -> Array:
    column = table.column(name)
    if column.null_count:
        row = int(np.flatnonzero(np.asarray(column.is_null()))[0])
        raise FormatError(f"{path}: column '{name}', row {row}: expected a number, got nothing")
    try:
        return np.asarray(column.to_numpy(), np.float64)
    except (ValueError, TypeError) as error:
        raise FormatError(f"{path}: column '{name}': expected numbers: {error}") from error


def _stamps(path: Path, table: pa.Table, clock: str, rate: float) -> Array:
    """Nanoseconds."""
    if not clock:
        return np.asarray(np.rint(np.arange(len(table)) / rate * NS), np.int64)
    column = table.column(clock)
    if pa.types.is_timestamp(column.type):
        return np.asarray(column.cast(pa.timestamp("ns")).cast(pa.int64()).to_numpy(), np.int64)
    if pa.types.is_integer(column.type) and len(column) and abs(column[0].as_py()) > MANY_NS:
        return np.asarray(column.to_numpy(), np.int64)
    seconds = _numbers(path, table, clock)
    bad = np.flatnonzero(~np.isfinite(seconds))
    if len(bad):
        raise FormatError(f"{path}: column '{clock}', row {bad[0]}: expected a time, got none")
    return np.asarray(np.rint(seconds * NS), np.int64)
