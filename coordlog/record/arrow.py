"""Columns of NumPy as Arrow arrays, without copying (bools are packed: Arrow stores them as bits).

A field of width n becomes a fixed-size list of n; every field carries its unit and meaning from
`spec`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import pyarrow as pa

from coordlog.episode import Array
from coordlog.spec import Field, Layout

EPISODE_INDEX = pa.field(
    "episode", pa.int32(), nullable=False, metadata={"doc": "index of the episode in the data set"}
)


def arrow_field(item: Field, layout: Layout) -> pa.Field:
    """The Arrow field of a field of `spec`."""
    kind, width = pa.from_numpy_dtype(np.dtype(item.type)), layout.width(item)
    if width is not None:
        kind = pa.list_(pa.field("item", kind, nullable=False), width)
    return pa.field(item.name, kind, nullable=False, metadata={"unit": item.unit, "doc": item.doc})


def arrow_array(values: Array, kind: pa.DataType) -> pa.Array:
    """An (n,) or (n, width) array as an Arrow array over the same memory."""
    if not pa.types.is_fixed_size_list(kind):
        return pa.array(values, kind)
    if kind.list_size == 0:  # Arrow divides by the width: the process would die
        return pa.array([[]] * len(values), kind)
    return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel(), kind.value_type), type=kind)


def record_batch(fields: Iterable[pa.Field], columns: Mapping[str, Array]) -> pa.RecordBatch:
    """A record batch with these fields, in this order."""
    schema = pa.schema(fields)
    return pa.record_batch(
        [arrow_array(columns[item.name], item.type) for item in schema], schema=schema
    )
