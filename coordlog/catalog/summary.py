"""What a folder of logs holds, as its catalogue says: one row per episode, and totals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NamedTuple

from coordlog.catalog.gather import Gathered
from coordlog.episode import Json
from coordlog.record.files import Skipped


class Row(NamedTuple):
    """One episode."""

    path: str
    robot: str
    scene: str
    split: str
    seed: int | None
    policy: str
    length: int
    duration: float
    """simulated seconds"""
    returns: dict[str, float]
    """by arm"""
    success: bool
    clean: bool
    terminated: bool
    truncated: bool
    aborted: str
    transform: str
    """what made it out of its parents; "" if it was recorded"""
    parents: tuple[str, ...]
    """sha256 of the files it was made from"""
    size: int
    """bytes"""


@dataclass(frozen=True)
class Totals:
    """Sums over the rows."""

    episodes: int
    steps: int
    duration: float
    """simulated seconds"""
    success: int
    clean: int
    aborted: int
    size: int
    """bytes"""
    scenes: dict[str, int]
    policies: dict[str, int]


@dataclass(frozen=True)
class Summary:
    """Rows by file name, what could not be read, and what is unfinished."""

    rows: tuple[Row, ...]
    totals: Totals
    skipped: tuple[Skipped, ...]
    parts: tuple[Path, ...]
    others: tuple[tuple[str, int], ...] = ()
    """Kinds of logs of other programs beside them, and how many of each."""

    def to_json(self) -> Json:
        """As plain JSON values."""
        return {
            "episodes": [row._asdict() for row in self.rows],
            "totals": asdict(self.totals),
            "skipped": [{"path": str(path), "reason": reason} for path, reason in self.skipped],
            "parts": [str(path) for path in self.parts],
        }


def summary(found: Gathered) -> Summary:
    """What was gathered, as rows and totals."""
    table = found.episodes().select(_COLUMNS)
    arms, returns = (table.column(name).to_pylist() for name in ("arms", "returns"))
    columns = {name: table.column(name).to_pylist() for name in Row._fields}
    for name in _TEXTS:
        columns[name] = [text or "" for text in columns[name]]
    columns["parents"] = list(map(tuple, columns["parents"]))
    columns["returns"] = [
        dict(zip(names or (), values, strict=False))
        for names, values in zip(arms, returns, strict=True)
    ]
    rows = tuple(map(Row, *(columns[name] for name in Row._fields)))
    others = tuple(sorted(found.others.items()))
    return Summary(rows, _totals(rows), tuple(found.skipped), tuple(found.parts), others)


_COLUMNS = ("arms", *Row._fields)
_TEXTS = ("robot", "scene", "split", "policy", "aborted", "transform")


def _totals(rows: Sequence[Row]) -> Totals:
    return Totals(
        episodes=len(rows),
        steps=sum(row.length for row in rows),
        duration=sum(row.duration for row in rows),
        success=sum(row.success for row in rows),
        clean=sum(row.clean for row in rows),
        aborted=sum(bool(row.aborted) for row in rows),
        size=sum(row.size for row in rows),
        scenes=dict(Counter(row.scene for row in rows)),
        policies=dict(Counter(row.policy for row in rows)),
    )
