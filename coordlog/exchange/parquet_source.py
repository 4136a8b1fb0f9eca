"""Parquet as a flat Arrow table: entries of lists and structs are columns of their own."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from coordlog.episode import Array
from coordlog.errors import FormatError
from coordlog.strangers import HEAD, PARQUET, recognise

NAMES = ("name", "names", "joint_names")
"""Columns of lists with the joints' names."""


def read_parquet(path: Path) -> pa.Table:
    """The table as it lies in the file.

    Raises:
        FormatError: if it cannot be read, or two columns have one name.
    """
    try:
        _require_content(path)
        file = pq.ParquetFile(path, page_checksum_verification=True)
        twice = _twice([item.name for item in file.schema_arrow])
        if twice:
            raise FormatError(
                f"{path}: column '{twice}': stands twice; give each a name of its own"
            )
        return file.read()
    except (pa.ArrowException, OSError) as error:
        said = str(error).splitlines()[0].replace(f" '{path}'", "")
        raise FormatError(f"{path}: not Parquet that can be read: {said}") from error


def _require_content(path: Path) -> None:
    """Hold a file to be no file of another kind, such as a pointer of Git LFS to what it was."""
    with path.open("rb") as stream:
        head = stream.read(HEAD)
    if not head.startswith(PARQUET) and (got := recognise(head)):
        raise FormatError(f"{path}: expected Parquet, got {got}")


def read_columns(path: Path, names: Sequence[str]) -> pa.Table:
    """Some columns of a file.

    Raises:
        FormatError: if it cannot be read or lacks one.
    """
    try:
        _require_content(path)
        had = pq.read_schema(path).names
        lost = [name for name in names if name not in had]
        if lost:
            raise FormatError(f"{path}: expected a column '{lost[0]}', got {', '.join(had)}")
        return pq.read_table(path, columns=list(names), page_checksum_verification=True)
    except (pa.ArrowException, OSError) as error:
        said = str(error).splitlines()[0].replace(f" '{path}'", "")
        raise FormatError(f"{path}: not Parquet that can be read: {said}") from error


def numbers(path: Path, table: pa.Table, name: str) -> Array:
    """A column of finite numbers, float64.

    Raises:
        FormatError: naming the first row that is none.
    """
    column = table.column(name)
    if not is_number(column.type):
        raise FormatError(f"{path}: column '{name}': expected numbers, got {column.type}")
    values = np.asarray(column.cast(pa.float64()).to_numpy(), np.float64)
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        got = "nothing" if column[int(bad[0])].as_py() is None else values[bad[0]]
        raise FormatError(f"{path}: column '{name}', row {bad[0]}: expected a number, got {got}")
    return values


def matrix(path: Path, table: pa.Table, name: str, width: int) -> Array:
    """A column of lists of `width` numbers as (n, width), or of numbers as (n, 1); NaN where an
    entry is missing.

    Raises:
        FormatError: if it is another column.
    """
    column = table.column(name)
    kind, inner = column.type, column.type
    while is_list(inner):
        inner = inner.value_type
    if not is_number(inner) or (width != 1 and not is_list(kind)):
        raise FormatError(f"{path}: column '{name}': expected lists of {width} numbers, got {kind}")
    parts = []
    for values in column.chunks:
        while is_list(values.type):
            values = values.flatten()
        parts.append(values.cast(pa.float64()).to_numpy(zero_copy_only=False))
    flat = np.concatenate(parts) if parts else np.zeros(0)
    if len(flat) != len(column) * width:
        raise FormatError(
            f"{path}: column '{name}': expected {width} numbers a row, got {len(flat)} in "
            f"{len(column)}"
        )
    return np.asarray(flat.reshape(-1, width), np.float64)


def _twice(names: Sequence[str]) -> str:
    return next((name for i, name in enumerate(names) if name in names[:i]), "")


def flat(path: Path, table: pa.Table) -> pa.Table:
    """Structs and lists of one length as columns of their own, `NAME.ENTRY`.

    Raises:
        FormatError: if lists differ in length from row to row.
    """
    if not len(table):
        return table
    columns: dict[str, pa.Array] = {}
    for item in table.schema:
        columns |= _spread(path, item, table.column(item.name).combine_chunks())
    labels: list[str] = []
    for name in [each for each, column in columns.items() if _is_names(each, column.type)]:
        labels = _labels(path, name, columns.pop(name))
    found: dict[str, pa.Array] = {}
    for name, column in columns.items():
        found |= _listed(path, name, column, labels, table.schema)
    return pa.table(found)


def _is_names(name: str, kind: pa.DataType) -> bool:
    """Whether a column holds, row by row, the names of the joints in the others."""
    return name.split(".")[-1] in NAMES and bool(
        is_list(kind) and pa.types.is_string(kind.value_type)
    )


def _spread(path: Path, item: pa.Field, column: pa.Array) -> dict[str, pa.Array]:
    """A column; of a struct, and of lists of structs, one for each of its fields."""
    kind = item.type
    if pa.types.is_struct(kind):
        parts = zip(kind, column.flatten(), strict=True)
    elif pa.types.is_list(kind) and pa.types.is_struct(kind.value_type):
        values = column.values
        parts = zip(
            kind.value_type,
            (pa.ListArray.from_arrays(column.offsets, each) for each in values.flatten()),
            strict=True,
        )
    else:
        return {item.name: column}
    found: dict[str, pa.Array] = {}
    for inner, values in parts:
        found |= _spread(path, pa.field(f"{item.name}.{inner.name}", values.type), values)
    return found


def _listed(
    path: Path, name: str, column: pa.Array, labels: Sequence[str], schema: pa.Schema
) -> dict[str, pa.Array]:
    kind = column.type
    if not is_list(kind) or not is_number(kind.value_type):
        return {name: column}
    width, values = _even(path, name, column)
    place = schema.get_field_index(name)
    about = ((schema.field(place).metadata or {}) if place >= 0 else {}).get(b"names", b"")
    own = json.loads(about) if about else labels
    own = own if len(own) == width else [str(i) for i in range(width)]
    return {
        f"{name}.{own[i]}": values.take(pa.array(range(i, len(values), width)))
        for i in range(width)
    }


def _even(path: Path, name: str, column: pa.Array) -> tuple[int, pa.Array]:
    """Length of every list of a column, and all their entries one after the other."""
    if column.null_count:
        row = int(np.flatnonzero(np.asarray(column.is_null()))[0])
        raise FormatError(f"{path}: column '{name}', row {row}: expected a list, got nothing")
    lengths = np.asarray(pc.list_value_length(column))
    other = np.flatnonzero(lengths != lengths[0])
    if len(other):
        raise FormatError(
            f"{path}: column '{name}', row {other[0]}: expected {lengths[0]} numbers as in row 0, "
            f"got {lengths[other[0]]}"
        )
    return int(lengths[0]), column.flatten()


def _labels(path: Path, name: str, column: pa.Array) -> list[str]:
    rows = column.to_pylist()
    other = next((i for i, row in enumerate(rows) if row != rows[0]), None)
    if other is not None:
        raise FormatError(
            f"{path}: column '{name}', row {other}: expected the joints of row 0 in their order, "
            "got others"
        )
    return list(rows[0] or ())


def is_list(kind: pa.DataType) -> bool:
    """Whether every entry of a column is a list."""
    return bool(pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind))


def is_number(kind: pa.DataType) -> bool:
    """Whether a column of this type may hold positions."""
    return bool(
        pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_decimal(kind)
    )
