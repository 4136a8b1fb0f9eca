"""A LeRobot data set again, with the joints of its episodes moved as ours move and nothing else.

Every file is copied as it is but for those that hold the joints: there the state becomes the
positions of our episodes at the very times of its rows, the action the position of the row after
(of the last row, its own), and the statistics of both are computed anew. Episodes that are not
given keep their rows.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from coordlog.episode import Array, Episode, Json
from coordlog.errors import ConfigError
from coordlog.exchange import lerobot_source, statistics
from coordlog.exchange.blocks import Done, growing, publish, refuse_taken
from coordlog.exchange.lerobot import write_json
from coordlog.exchange.motion import NS
from coordlog.exchange.source import Entry, Loaded
from coordlog.exchange.sources import digest_of

Replaced = dict[str, Array]
"""New rows of each replaced feature of an episode, (n, width) float64."""


def export_like(
    chosen: Sequence[Entry],
    source: Path,
    out: Path,
    *,
    force: bool = False,
    advance: Callable[[int], None] = lambda episodes: None,
) -> Done:
    """Write a copy of a LeRobot set in which our episodes move its joints.

    Args:
        chosen: Observed episodes that were imported from the set, smoothed or not.
        source: The set.
        out: Folder of the copy; appears when it is complete.
        force: Replace what is at `out`.
        advance: Called with the number of episodes done.

    Raises:
        ConfigError: if an episode is not of this set, or has lost its times.
        StorageError: if something is at `out`, or the file system refuses.
    """
    info = lerobot_source.read_info(source)
    digest = digest_of(source)
    by_number = _by_number(chosen, source, digest)
    refuse_taken(out, force=force)
    part = out.parent / f".{out.name}.part"
    plan = {"like": digest, "of": [entry.result.digest for entry in chosen]}
    with growing(part, plan):
        shutil.copytree(source, part, dirs_exist_ok=True)
        kept: dict[int, dict[str, statistics.Stats]] = {}
        files: dict[Path, list[lerobot_source.Rows]] = {}
        for rows in lerobot_source.episodes(source, info):
            files.setdefault(rows.file, []).append(rows)
        for file, held in files.items():
            if any(rows.episode in by_number for rows in held):
                target = part / file.relative_to(source)
                kept |= _rewrite(file, target, held, by_number, info)
                advance(sum(len(by_number.get(rows.episode, ())) for rows in held))
        _restate(part, info, kept)
        publish(part, out, plan)
    steps = sum(entry.result.length for entry in chosen)
    return Done(len(chosen), steps, 0, len(files), False)


def _by_number(chosen: Sequence[Entry], source: Path, digest: str) -> dict[int, list[Entry]]:
    """Our episodes by the number of theirs; several where one was cut up."""
    found: dict[int, list[Entry]] = {}
    for entry in chosen:
        origin = entry.header.episode.get("source", {})
        if origin.get("sha256") != digest:
            raise ConfigError(
                f"{entry.path}: expected an episode imported from {source} (sha256 {digest[:12]}), "
                f"got one from {origin.get('name', 'a simulation')} "
                f"({str(origin.get('sha256', ''))[:12] or 'no source'}); --like wants the very set "
                "it came from"
            )
        found.setdefault(int(origin["episode"]), []).append(entry)
    return found


def _rewrite(
    file: Path,
    target: Path,
    held: Sequence[lerobot_source.Rows],
    by_number: Mapping[int, list[Entry]],
    info: Json,
) -> dict[int, dict[str, statistics.Stats]]:
    """Write one data file anew, group by group as it was; statistics of what changed come back."""
    read = pq.ParquetFile(file)
    table = read.read()
    numbers = table.column("episode_index").to_numpy()
    stats: dict[int, dict[str, statistics.Stats]] = {}
    changed: dict[str, Array] = {}
    for rows in held:
        places = np.flatnonzero(numbers == rows.episode)
        fresh: Replaced = {}
        for entry in by_number.get(rows.episode, ()):
            _replace(entry, table, places, fresh, info)
        for name, values in fresh.items():
            if name not in changed:
                changed[name] = _matrix(table, name)
            changed[name][places] = values
        if fresh:
            stats[rows.episode] = statistics.of_columns(fresh)
    for name, values in changed.items():
        at = table.schema.get_field_index(name)
        item = table.schema.field(at)
        flat = pa.array(values.ravel().astype(item.type.value_type.to_pandas_dtype()))
        kind = item.type
        if pa.types.is_fixed_size_list(kind):
            column = pa.FixedSizeListArray.from_arrays(flat, type=kind)
        else:
            offsets = np.arange(0, values.size + 1, values.shape[1], dtype=np.int32)
            column = pa.ListArray.from_arrays(pa.array(offsets), flat, type=kind)
        table = table.set_column(at, item, column)
    target.unlink()
    with pq.ParquetWriter(target, table.schema, compression="snappy") as writer:
        first = 0
        for i in range(read.num_row_groups):
            count = read.metadata.row_group(i).num_rows
            writer.write_table(table.slice(first, count), row_group_size=max(count, 1))
            first += count
    return stats


def _replace(entry: Entry, table: pa.Table, places: Array, fresh: Replaced, info: Json) -> None:
    """Put the motion of one of our episodes into the rows at its times."""
    loaded = Loaded(entry.path)
    origin = loaded.episode.header.episode["source"]
    state = origin["state"]
    if state not in fresh:
        fresh[state] = _matrix(table, state)[places]
    stamps, _ = lerobot_source.stamps_of(
        table.column("timestamp").to_numpy()[places], float(info["fps"])
    )
    start = int(loaded.episode.header.episode["start_time"])
    time = (stamps - start) / NS
    end = float(loaded.episode.time[-1])
    rows = np.flatnonzero((time >= -1e-6) & (time <= end + 1e-6))
    moved = fresh[state].copy()
    names = list(origin["joints"])
    for name, (joint, factor, offset) in origin["map"].items():
        found = _at(loaded.episode, joint, time[rows])
        moved[rows, names.index(name)] = (found - offset) / factor
    fresh[state] = moved
    action = origin.get("action")
    if action:
        if action not in fresh:
            fresh[action] = _matrix(table, action)[places]
        after = np.minimum(rows + 1, rows[-1])
        ours = np.array([names.index(name) for name in origin["map"]])
        fresh[action][np.ix_(rows, ours)] = moved[np.ix_(after, ours)]


def _at(episode: Episode, joint: str, time: Array) -> Array:
    """Positions of a joint at some times: the logged ones where they are logged."""
    (place,) = [int(item["qpos"]) for item in episode.header.env["joints"] if item["name"] == joint]
    return np.asarray(np.interp(time, episode.time, episode.qpos[:, place]))


def _matrix(table: pa.Table, name: str) -> Array:
    column = table.column(name).combine_chunks()
    flat = column.flatten().to_numpy(zero_copy_only=False).astype(np.float64)
    return np.array(flat.reshape(len(column), -1))


def _restate(part: Path, info: Json, kept: Mapping[int, dict[str, statistics.Stats]]) -> None:
    """Write the statistics of the changed episodes, and of the whole set, anew."""
    whole = _restated_v3(part, kept) if info["codebase_version"] == "v3.0" else _v2(part, kept)
    stats = part / "meta" / "stats.json"
    if stats.exists() and whole:
        old = json.loads(stats.read_text("utf-8"))
        pooled = {name: statistics.pooled(parts) for name, parts in whole.items() if all(parts)}
        write_json(stats, old | pooled)


_Parts = dict[str, list[Any]]


def _restated_v3(part: Path, kept: Mapping[int, dict[str, statistics.Stats]]) -> _Parts:
    whole: _Parts = {}
    names = {name for stats in kept.values() for name in stats}
    for file in sorted((part / "meta" / "episodes").rglob("*.parquet")):
        table = pq.read_table(file)
        numbers = table.column("episode_index").to_pylist()
        for name in names:
            for key in statistics.NAMES:
                column = f"stats/{name}/{key}"
                if column not in table.column_names:
                    continue
                values = table.column(column).to_pylist()
                for i, number in enumerate(numbers):
                    if name in kept.get(number, {}):
                        values[i] = kept[number][name][key]
                at = table.schema.get_field_index(column)
                item = table.schema.field(at)
                table = table.set_column(at, item, pa.array(values, item.type))
        pq.write_table(table, file, compression="snappy")
        for name in names:
            columns = [f"stats/{name}/{key}" for key in statistics.NAMES]
            if all(column in table.column_names for column in columns):
                lists = [table.column(column).to_pylist() for column in columns]
                whole.setdefault(name, []).extend(
                    dict(zip(statistics.NAMES, row, strict=True))
                    for row in zip(*lists, strict=True)
                )
    return whole


def _v2(part: Path, kept: Mapping[int, dict[str, statistics.Stats]]) -> _Parts:
    file = part / "meta" / "episodes_stats.jsonl"
    if not file.exists():
        return {}
    lines = []
    for line in file.read_text("utf-8").splitlines():
        row = json.loads(line)
        for name, fresh in kept.get(int(row["episode_index"]), {}).items():
            old = row["stats"].get(name, {})
            row["stats"][name] = {key: fresh[key] for key in fresh if key in old or not old}
        lines.append(json.dumps(row))
    file.write_text("".join(f"{line}\n" for line in lines), "utf-8")
    return {}
