"""A recording in the making: NumPy arrays go straight into chunks of Arrow columns, which a stream
takes over all at once.

`stream.log(entity, rr.Points3D(...))` converts each field for itself, takes a lock, and wakes a
thread, for a hundred entities a hundred times; for an episode of 150 steps that costs more than
everything else.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from functools import cache
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from rerun.chunk import Chunk

from coordlog.episode import Array
from coordlog.view.palette import Colour

Value = Array | float | Sequence[Enum] | Sequence[str] | Sequence[bool] | Sequence[Colour]
"""Of a field: floats, (n,) float32 for sizes and float64 for scalars; (n, 3) and (n, 4) for places
and xyzw quaternions; (n, m, 3) for line strips; colours, (n, 4) uint8 or tuples; triangles, (n, 3)
uint32; enumerated constants, words, bools. A number stands for all."""


class Draft:
    """What panels show, until `send` hands it to a stream.

    Fields are named as the archetype names them.
    """

    def __init__(self, now: rr.TimeColumn | None = None) -> None:
        """Begin with nothing.

        With a column of one time, what `log` adds holds from then on, otherwise at all times.
        """
        self._now = [] if now is None else [now]
        self._chunks: list[Chunk] = []

    def log(self, entity: str, archetype: type[rr.AsComponents], **fields: Value) -> None:
        """Add one row to an entity, each field as a whole."""
        row = [_column(archetype, name, value) for name, value in fields.items()]
        self._chunks.append(Chunk.from_columns(entity, self._now, row))

    def columns(
        self,
        entity: str,
        time: rr.TimeColumn,
        archetype: type[rr.AsComponents],
        counts: Array | int = 1,
        **fields: Value,
    ) -> None:
        """Add a row at each of n times to an entity.

        Args:
            entity: Its path.
            time: The n times.
            archetype: What the fields are of.
            counts: How many values of each field belong to a row, (n,) or the same for all.
            fields: Values of all rows, one after the other.

        Raises:
            ValueError: if times and values are not of one length.
        """
        rows = [_column(archetype, name, value, counts) for name, value in fields.items()]
        self._chunks.append(Chunk.from_columns(entity, [time], rows))

    def send(self, stream: rr.RecordingStream) -> None:
        """Hand everything to a stream, in the order in which it was added."""
        stream.send_chunks(self._chunks)


class _Ready:
    """Values that need no conversion any more."""

    def __init__(self, values: pa.Array) -> None:
        self._values = values

    def as_arrow_array(self) -> pa.Array:
        """The values."""
        return self._values


def _column(
    archetype: type[rr.AsComponents], field: str, value: Value, counts: Array | int | None = None
) -> rr.ComponentColumn:
    """One field over all rows; without `counts` one row has it all."""
    values = _arrow(value)
    n = len(values)
    if counts is None:
        offsets = np.array([0, n], dtype=np.int32)
    elif isinstance(counts, int):
        offsets = np.arange(0, n + 1, counts, dtype=np.int32)
    else:
        offsets = np.append(0, np.cumsum(counts)).astype(np.int32)
    return rr.ComponentColumn(_descriptor(archetype, field), _Ready(values), offsets=offsets)


@cache
def _descriptor(archetype: Any, field: str) -> rr.ComponentDescriptor:
    """The viewer's name of a field."""
    found: rr.ComponentDescriptor = getattr(archetype, f"descriptor_{field}")()
    return found


@cache
def _list(item: pa.DataType, size: int = -1) -> pa.DataType:
    """Of items that are never null, so many each, or any number."""
    return pa.list_(pa.field("item", item, nullable=False), size)


def _arrow(value: Value) -> pa.Array:
    """Values as the viewer stores them."""
    if isinstance(value, float):
        return pa.array([value], type=pa.float32())
    if not isinstance(value, np.ndarray):
        if isinstance(value[0], Enum):
            return pa.array(
                [constant.value for constant in value if isinstance(constant, Enum)],
                type=pa.uint8(),
            )
        if not isinstance(value[0], tuple):
            return pa.array(value)
        value = np.array(value, dtype=np.uint8)
    if value.ndim == 1:
        return pa.array(value)
    if value.dtype == np.uint8:  # red is the highest byte
        return pa.array(np.ascontiguousarray(value).view(">u4").ravel().astype(np.uint32))
    flat = pa.array(
        np.asarray(value, dtype=np.uint32 if value.dtype == np.uint32 else np.float32).ravel()
    )
    vectors = pa.FixedSizeListArray.from_arrays(flat, type=_list(flat.type, value.shape[-1]))
    if value.ndim == 2:
        return vectors
    ends = np.arange(0, len(vectors) + 1, value.shape[1], dtype=np.int32)
    return pa.ListArray.from_arrays(ends, vectors, type=_list(vectors.type))
