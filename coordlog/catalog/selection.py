"""Selections: lists of episodes out of catalogues, edited without touching a file.

Which part of a split an episode belongs to depends on what is split by, a seed and the shares
alone: more episodes later never move one from one part to another.
"""

from __future__ import annotations

import hashlib
import os
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, repeat
from pathlib import Path
from typing import Any

from coordlog.catalog.gather import Gathered
from coordlog.catalog.query import EXTRA, ask
from coordlog.catalog.rows import COLUMNS
from coordlog.errors import ConfigError, unknown
from coordlog.record.manifest import Chosen, Manifest
from coordlog.record.places import is_url

PARTS = ("train", "validation", "test")
"""Names of the parts of a split into two (the first and the last) or three."""

_SPAN = 1 << 64


@dataclass(frozen=True)
class Split:
    """How episodes are divided.

    Example:
        >>> Split.parse("0.8,0.1,0.1", by="goal").parts
        ('train', 'validation', 'test')
    """

    shares: tuple[float, ...]
    parts: tuple[str, ...]
    by: str = "goal"
    """Episodes that are equal in this column stay together."""
    seed: int = 0

    @classmethod
    def parse(cls, text: str, *, by: str = "goal", seed: int = 0) -> Split:
        """A split out of "0.8,0.1,0.1" or "learn=0.9,judge=0.1".

        Raises:
            ConfigError: if these are no shares that add up to 1, or there is no such column.
        """
        items = [item.partition("=") for item in text.split(",")]
        named = all(equals for _, equals, _ in items)
        try:
            shares = tuple(float(share if named else name) for name, _, share in items)
        except ValueError:
            shares = ()
        if not shares or min(shares) < 0 or not abs(sum(shares) - 1) < 1e-9:
            raise ConfigError(
                f"--split: expected shares that add up to 1, such as 0.8,0.1,0.1, got {text}"
            )
        default = {1: PARTS[:1], 2: (PARTS[0], PARTS[2]), 3: PARTS}.get(len(shares), ())
        parts = tuple(name for name, _, _ in items) if named else default
        if len(set(parts)) != len(shares) or not all(parts):
            raise ConfigError(
                f"--split: expected two or three shares, or a name for each, such as a=0.5,b=0.5,"
                f" got {text}"
            )
        if by not in COLUMNS.names:
            raise unknown("column", by, COLUMNS.names)
        return cls(shares, parts, by, seed)

    def part(self, value: Any) -> str:
        """The part that everything with this value in the column `by` belongs to."""
        digest = hashlib.sha256(f"{self.seed}/{self.by}/{value!r}".encode()).digest()
        at = int.from_bytes(digest[:8], "big") / _SPAN
        return self.parts[bisect_right(self._ends, at)]

    @cached_property
    def _ends(self) -> list[float]:
        return list(accumulate(self.shares))[:-1]


def select(
    gathered: Gathered,
    *,
    where: str = "",
    minus: Sequence[Manifest] = (),
    unique: str = "",
    split: Split | None = None,
    label: str | None = None,
    out: Path,
) -> Manifest:
    """A list of the episodes that satisfy a condition.

    Args:
        gathered: Where episodes are described; what is in several places is one episode.
        where: An SQL condition over `episodes`.
        minus: Lists whose episodes are left out.
        unique: Of episodes that are equal in these columns (comma-separated), keep the first by
            time and digest.
        split: How to divide them; None keeps the parts that they have.
        label: A label for all of them; None keeps the labels that they have.
        out: The file that the manifest is for: paths are from its folder on.

    Raises:
        ConfigError: if a condition or a column is none.
    """
    table = ask(_statement(unique, split), gathered.sources, where=where)
    columns = {name: table.column(name).to_pylist() for name in table.column_names}
    folder, known = out.parent, dict[str, str]()
    without = {each.digest for manifest in minus for each in manifest.chosen}
    parts = (
        map(split.part, columns[split.by]) if split else (each or "" for each in columns["part"])
    )
    labels = columns["label"] if label is None else repeat(label)
    fields = (columns[name] for name in ("digest", "size", "mtime", "path"))
    chosen: dict[str, Chosen] = {}
    for digest, size, mtime, path, part, name in zip(*fields, parts, labels, strict=False):
        if digest not in without and digest not in chosen:
            place = _from(path, folder, known)
            chosen[digest] = Chosen(digest, part, name or "", size, mtime, place)
    about: dict[str, Any] = {
        "sources": sorted({_from(folder, out.parent, {}) for folder in gathered.folders}),
        "where": where,
        "unique": unique,
        "minus": [manifest.hash for manifest in minus],
    }
    if split:
        shares = dict(zip(split.parts, split.shares, strict=True))
        about["split"] = {"shares": shares, "by": split.by, "seed": split.seed}
    stem = out.name.removesuffix(".manifest")
    return Manifest(name=stem, chosen=tuple(sorted(chosen.values())), about=about)


FIRST = "path, part desc nulls last, label desc nulls last"
"""Of an episode that several sources name, what a manifest said of it comes first."""


def _statement(unique: str, split: Split | None) -> str:
    names = {"digest", "size", "mtime", "path", *EXTRA} | ({split.by} if split else set())
    columns = ", ".join(f'"{name}"' for name in sorted(names))
    if not unique:
        return f"select {columns} from episodes order by {FIRST}"
    keys = [key.strip() for key in unique.split(",")]
    for key in keys:
        if key not in COLUMNS.names:
            raise unknown("column", key, COLUMNS.names)
    group = ", ".join(f'"{key}"' for key in keys)
    return (
        f"select {columns} from episodes qualify row_number() over"
        f" (partition by {group} order by start_time, digest, {FIRST}) = 1 order by path"
    )


def _from(path: str, folder: Path, known: dict[str, str]) -> str:
    """A path from a folder on; `known` remembers what becomes of the folders that it lies in."""
    head, _, tail = path.rpartition("/")
    if head not in known:
        whole = is_url(path) or os.path.isabs(path)
        before = head if whole else os.path.relpath(head or ".", folder)
        known[head] = "" if before == "." else f"{before}/"
    return known[head] + tail


@dataclass(frozen=True)
class Difference:
    """How two sets of episodes differ."""

    only_a: tuple[str, ...]
    """paths of episodes that the second lacks"""
    only_b: tuple[str, ...]
    both: int
    moved: tuple[tuple[str, str, str], ...]
    """digest, and part or label in each, of episodes that both have, where both have parts"""
    settings: dict[str, tuple[list[Any], list[Any]]]
    """values that only one of them has, by column"""
    figures: dict[str, tuple[float | None, float | None]]


SETTINGS = ("task", "scene", "robot", "policy", "noise", "split", "start", "coordlog_version")
FIGURES = {
    "episodes": "count(*)",
    "steps": "sum(length)",
    "length": "avg(length)",
    "success": "avg(success::int)",
    "clean": "avg(clean::int)",
    "collided": "avg(collided::int)",
    "fell": "avg(fell::int)",
    "return": "avg(list_sum(returns))",
    "jerk": "avg(jerk)",
}
"""What is compared, in SQL."""


def difference(a: Gathered, b: Gathered) -> Difference:
    """Compare two sets of episodes by the digests of their files.

    Raises:
        ConfigError: if a set cannot be asked.
    """
    tables = [_by_digest(each) for each in (a, b)]
    first, second = ({row["digest"]: row for row in reversed(table)} for table in tables)
    shared = first.keys() & second.keys()
    moved = []
    divided = all(any(map(_place, rows.values())) for rows in (first, second))
    for digest in sorted(shared) if divided else ():
        before, after = (_place(rows[digest]) for rows in (first, second))
        if before != after:
            moved.append((digest, before, after))
    figures = [_figures(each) for each in (a, b)]
    return Difference(
        only_a=tuple(sorted(row["path"] for key, row in first.items() if key not in shared)),
        only_b=tuple(sorted(row["path"] for key, row in second.items() if key not in shared)),
        both=len(shared),
        moved=tuple(moved),
        settings=_settings(a, b),
        figures={name: (figures[0][name], figures[1][name]) for name in FIGURES},
    )


def _by_digest(gathered: Gathered) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = ask(
        f"select digest, path, part, label from episodes order by {FIRST}", gathered.sources
    ).to_pylist()
    return rows


def _place(row: dict[str, Any]) -> str:
    return "/".join(filter(None, (row["part"], row["label"])))


def _figures(gathered: Gathered) -> dict[str, float | None]:
    columns = ", ".join(f'{text} as "{name}"' for name, text in FIGURES.items())
    once = "(select * from episodes qualify row_number() over (partition by digest) = 1)"
    (row,) = ask(f"select {columns} from {once}", gathered.sources).to_pylist()
    return {name: None if value is None else float(value) for name, value in row.items()}


def _settings(a: Gathered, b: Gathered) -> dict[str, tuple[list[Any], list[Any]]]:
    columns = ", ".join(f'list_sort(list(distinct "{name}")) as "{name}"' for name in SETTINGS)
    first, second = (
        ask(f"select {columns} from episodes", each.sources).to_pylist()[0] for each in (a, b)
    )
    return {
        name: (first[name] or [], second[name] or [])
        for name in SETTINGS
        if first[name] != second[name]
    }
