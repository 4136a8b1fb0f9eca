"""One episode as one row of a catalogue."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa

from coordlog.episode import Episode, Json
from coordlog.errors import CoordlogError
from coordlog.record.places import Entry
from coordlog.record.recording import Recording

COLUMNS = pa.schema(
    [
        ("path", pa.string()),
        ("size", pa.int64()),
        ("mtime", pa.int64()),
        ("digest", pa.string()),
        ("kind", pa.string()),
        ("run", pa.string()),
        ("task", pa.string()),
        ("scene", pa.string()),
        ("robot", pa.string()),
        ("arms", pa.list_(pa.string())),
        ("policy", pa.string()),
        ("noise", pa.float64()),
        ("split", pa.string()),
        ("seed", pa.int64()),
        ("index", pa.int64()),
        ("start", pa.string()),
        ("goal", pa.string()),
        ("start_time", pa.int64()),
        ("duration", pa.float64()),
        ("length", pa.int64()),
        ("returns", pa.list_(pa.float64())),
        ("success", pa.bool_()),
        ("clean", pa.bool_()),
        ("terminated", pa.bool_()),
        ("truncated", pa.bool_()),
        ("aborted", pa.string()),
        ("collided", pa.bool_()),
        ("fell", pa.bool_()),
        ("transform", pa.string()),
        ("parents", pa.list_(pa.string())),
        ("jerk", pa.float64()),
        ("coordlog_version", pa.string()),
    ]
)
"""What SQL sees of an episode. `digest` is the sha256 of the file, `goal` one of the goals and
obstacles, `jerk` that of a smoothed path; times in ns since the epoch, durations in s."""
KEPT = pa.schema([*COLUMNS, ("error", pa.string()), ("gone", pa.bool_())])
"""What a catalogue keeps: also what is wrong with a file, and that it is gone."""
EMPTY = pa.Table.from_batches([], KEPT)
"""No rows; made so, since `empty_table` loads pandas where there is one, for half a second."""


class Job(NamedTuple):
    """Some files to describe."""

    root: str
    entries: tuple[Entry, ...]


def described(job: Job) -> list[dict[str, Any]]:
    """Rows of some files; one that is no sound episode gets a row with the reason in `error`."""
    return [_row(Path(job.root) / entry.name, entry) for entry in job.entries]


def _row(path: Path, entry: Entry) -> dict[str, Any]:
    known = {"path": entry.name, "size": entry.size, "mtime": entry.mtime}
    try:
        return known | episode_row(Recording(path))
    except CoordlogError as error:
        return known | {"error": str(error).replace(f"{path}: ", "")}


def episode_row(recording: Recording) -> dict[str, Any]:
    """What a catalogue says of an episode, apart from where its file is."""
    header, result, episode = recording.header, recording.result, recording.episode
    about, lineage, policy = header.episode, header.lineage, header.policy
    return {
        "digest": recording.digest,
        "kind": header.kind,
        "run": about.get("run"),
        "task": header.task,
        "scene": about.get("scene"),
        "robot": about.get("robot"),
        "arms": list(header.arms),
        "policy": policy.get("name") or policy.get("kind"),
        "noise": float((policy.get("noise") or {}).get("sigma", 0.0)),
        "split": about.get("split"),
        "seed": about.get("seed"),
        "index": about.get("index"),
        "start": about.get("start"),
        "goal": _goal(about),
        "start_time": about.get("start_time"),
        "duration": result.length * float(about.get("control_period", 0.0)),
        "length": result.length,
        "returns": list(result.returns),
        "success": result.success,
        "clean": result.clean,
        "terminated": result.terminated,
        "truncated": result.truncated,
        "aborted": result.aborted,
        "collided": _any(episode, "collision"),
        "fell": _any(episode, "instability"),
        "transform": lineage.get("transform", ""),
        "parents": list(lineage.get("parents", [])),
        "jerk": ((lineage.get("parameters") or {}).get("after") or {}).get("jerk"),
        "coordlog_version": header.env.get("coordlog_version"),
    }


def table_of(rows: Iterable[dict[str, Any]]) -> pa.Table:
    """Rows as a table with the columns of `KEPT`."""
    return pa.Table.from_pylist(list(rows), schema=KEPT)


def tombstones(names: Sequence[str]) -> pa.Table:
    """Rows that say that files are gone."""
    return table_of({"path": name, "gone": True} for name in names)


def _any(episode: Episode, name: str) -> bool | None:
    return bool(getattr(episode, name).any()) if episode.has(name) else None


def _goal(about: Json) -> str:
    """A digest of the problem that the episode was about: what a split must not tear apart."""
    problem = [about.get("scene"), about.get("goals"), about.get("obstacles")]
    return hashlib.sha256(json.dumps(problem).encode()).hexdigest()[:16]
