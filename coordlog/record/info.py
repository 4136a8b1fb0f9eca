"""What a folder of logs holds, from the two ends of each file: one row per episode, and totals."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

from coordlog.episode import Json
from coordlog.errors import FormatError, StorageError
from coordlog.record.files import Skipped, find_files, reason_of
from coordlog.record.opening import File
from coordlog.record.reader import read_summary


@dataclass(frozen=True)
class Row:
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
            "episodes": [asdict(row) for row in self.rows],
            "totals": asdict(self.totals),
            "skipped": [{"path": str(path), "reason": reason} for path, reason in self.skipped],
            "parts": [str(path) for path in self.parts],
        }


def summarise(path_or_paths: File | Iterable[File]) -> Summary:
    """Summarise files and folders without decoding a message; a broken file becomes an entry of
    `skipped`.

    Raises:
        StorageError: if a path does not exist, or the only one cannot be read.
    """
    files = find_files(path_or_paths)
    rows: list[Row] = []
    skipped: list[Skipped] = list(files.skipped)
    for path in files.paths:
        try:
            rows.append(row(path))
        except (FormatError, StorageError) as error:
            skipped.append(Skipped(path, reason_of(path, error)))
    return Summary(tuple(rows), _totals(rows), tuple(skipped), files.parts, files.others)


def row(path: File) -> Row:
    """Summarise one episode.

    Raises:
        FormatError: if the file is not a finished episode.
    """
    header, result, size = read_summary(path)
    episode, policy, lineage = header.episode, header.policy, header.lineage
    return Row(
        path=os.fspath(path),
        robot=str(episode.get("robot", "")),
        scene=str(episode.get("scene", "")),
        split=str(episode.get("split", "")),
        seed=episode.get("seed"),
        policy=str(policy.get("name") or policy.get("kind", "")),
        length=result.length,
        duration=result.length * float(episode.get("control_period", 0.0)),
        returns=dict(zip(header.arms, result.returns, strict=False)),
        success=result.success,
        clean=result.clean,
        terminated=result.terminated,
        truncated=result.truncated,
        aborted=result.aborted,
        transform=str(lineage.get("transform", "")),
        parents=tuple(map(str, lineage.get("parents") or ())),
        size=size,
    )


def _totals(rows: list[Row]) -> Totals:
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
