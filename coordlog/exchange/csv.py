"""CSV: `steps.csv` with a row per step, `episodes.csv` with a row per episode.

UTF-8, commas, decimal points; numbers in the fewest digits that give the same float again. A column
per entry of a sequence, `NAME.ENTRY`. T rows an episode; its final state stands in `episodes.csv`.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc

from coordlog.episode import Json
from coordlog.exchange.blocks import Block, Options
from coordlog.exchange.columns import columns
from coordlog.exchange.source import Loaded

_NAMES = ("steps", "episodes")


def write_block(block: Block) -> Json:
    """The rows of one block, in two files with a header each."""
    rows = []
    steps = _part(block.folder, "steps", block.number)
    steps.parent.mkdir(parents=True, exist_ok=True)
    with steps.open("wb") as file:
        for number, loaded in enumerate(block.loaded(), block.first_episode):
            header = number == block.first_episode
            options = pc.WriteOptions(include_header=header, quoting_style="needed")
            pc.write_csv(_flat(loaded, number), file, options)
            rows.append(_row(loaded, number))
    options = pc.WriteOptions(quoting_style="needed")
    episodes = _part(block.folder, "episodes", block.number)
    pc.write_csv(pa.Table.from_pylist(rows), episodes, options)
    return {"number": block.number}


def assemble(folder: Path, journals: Sequence[Json], options: Options) -> None:
    """Join the blocks' rows under one header."""
    for name in _NAMES:
        with (folder / f"{name}.csv").open("wb") as whole:
            for journal in journals:
                with _part(folder, name, journal["number"]).open("rb") as part:
                    if journal["number"]:
                        part.readline()
                    shutil.copyfileobj(part, whole)
    shutil.rmtree(folder / "parts")


def _flat(loaded: Loaded, number: int) -> pa.Table:
    length = len(loaded.episode)
    flat = {"episode": pa.array(np.full(length, number)), "step": pa.array(np.arange(length))}
    for name, item in columns(loaded.episode).items():
        if not item.labels:
            flat[name] = pa.array(item.values[:length])
            continue
        entries = np.ascontiguousarray(item.values[:length].T)
        for label, values in zip(item.labels, entries, strict=True):
            flat[f"{name}.{label}"] = pa.array(values)
    return pa.table(flat)


def _row(loaded: Loaded, number: int) -> Json:
    row: Json = {"episode": number, **loaded.provenance}
    for item in columns(loaded.episode).values():
        if not item.before:
            continue
        if not item.labels:
            row[f"final.{item.name}"] = float(item.values[-1])
        for label, value in zip(item.labels, item.values[-1] if item.labels else (), strict=True):
            row[f"final.{item.name}.{label}"] = value.item()
    return row


def _part(folder: Path, name: str, number: int) -> Path:
    return folder / "parts" / f"{name}-{number:05d}.csv"
