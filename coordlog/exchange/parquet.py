"""Parquet: `steps/` with a row per step, `episodes/` with a row per episode.

Columns keep their names, types and every bit; sequences are lists of one length, their entries
named in the field's metadata. T rows an episode; its final state stands in the row of `episodes`,
`final.…`, beside its origin.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from coordlog.episode import Array, Json
from coordlog.exchange.blocks import Block, Options
from coordlog.exchange.columns import columns
from coordlog.exchange.source import Loaded
from coordlog.record.arrow import arrow_array


def write_block(block: Block) -> Json:
    """The two files of one block, a row group of steps for each episode."""
    rows = []
    writer: pq.ParquetWriter | None = None
    for number, loaded in enumerate(block.loaded(), block.first_episode):
        table = steps_table(loaded, number)
        if writer is None:
            path = _made(block.folder / "steps" / f"{block.number:05d}.parquet")
            writer = pq.ParquetWriter(path, table.schema, compression="zstd")
        writer.write_table(table, row_group_size=max(len(table), 1))
        rows.append(episode_row(loaded, number))
    if writer is not None:
        writer.close()
    path = _made(block.folder / "episodes" / f"{block.number:05d}.parquet")
    pq.write_table(pa.Table.from_pylist(rows), path, compression="zstd")
    return {}


def assemble(folder: Path, journals: Sequence[Json], options: Options) -> None:
    """Nothing stands once per set."""


def steps_table(loaded: Loaded, number: int) -> pa.Table:
    """The T steps of an episode; `episode` and `step` come first."""
    length = len(loaded.episode)
    values: dict[str, Array] = {
        "episode": np.full(length, number, np.int64),
        "step": np.arange(length, dtype=np.int64),
    }
    about: dict[str, dict[str, str]] = {name: {} for name in values}
    for item in columns(loaded.episode).values():
        values[item.name] = item.values[:length]
        about[item.name] = {"unit": item.unit, "doc": item.doc}
        if item.labels:
            about[item.name]["names"] = json.dumps(item.labels)
    arrays, fields = [], []
    for name, column in values.items():
        kind = pa.from_numpy_dtype(column.dtype)
        if column.ndim > 1:
            kind = pa.list_(kind, column.shape[1])
        arrays.append(arrow_array(np.ascontiguousarray(column), kind))
        fields.append(pa.field(name, kind, metadata=about[name]))
    return pa.table(arrays, schema=pa.schema(fields))


def episode_row(loaded: Loaded, number: int) -> Json:
    """Number, origin and final state of an episode."""
    row: Json = {"episode": number, **loaded.provenance}
    for item in columns(loaded.episode).values():
        if item.before:
            last = item.values[-1]
            row[f"final.{item.name}"] = last.tolist() if item.values.ndim > 1 else float(last)
    return row


def _made(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    return path
