"""What many episodes cost: a catalogue of a million, selections of a hundred thousand, packs, and
an object store's requests.

    python experiments/speed/bench_many.py [PART …] [--rows 1000000] [--files 20000]
    [--members 100000] [--json FILE]

PART is one of: catalogue selections files packs storage memory; by default all. Episodes are those of the
tests, copied; the million rows are random numbers in the catalogue's columns. Times are of the
processor, the least of a few runs; of what several processes do, on the clock.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch
from urllib.request import Request, urlopen

import numpy as np
import pyarrow as pa

from coordlog.catalog.gather import Gathered, gather
from coordlog.catalog.index import Catalog
from coordlog.catalog.packing import pack_files
from coordlog.catalog.query import Source, ask
from coordlog.catalog.rows import KEPT
from coordlog.catalog.selection import Split, select
from coordlog.catalog.summary import summary
from coordlog.episode import Episode
from coordlog.parallel import mapped
from coordlog.record import manifest
from coordlog.record.addresses import fetch, name_within
from coordlog.record.container import Container
from coordlog.record.metadata import RESULT, encode_commit, encode_header, sealed, vouched
from coordlog.record.pack_writer import PackWriter
from coordlog.record.packs import Pack
from coordlog.record.places import Folder
from coordlog.record.reader import metadata, read_episode
from coordlog.record.store import ObjectStore
from coordlog.record.writer import LIBRARY, write_episode
from coordlog.verify.levels import check_files

ROOT = Path(__file__).parents[2]
EPISODES = sorted((ROOT / "tests" / "data" / "v1").rglob("*.mcap"))
RUNS = 5
QUERIES = {
    "group by": "select scene, policy, count(*), avg(length), avg(clean::int) from episodes group by all",
    "filter, order, limit": "select path, length from episodes where clean and length < 90 and"
    " scene = 'shelf' order by duration desc limit 20",
    "count where": "select count(*) from episodes where run = 'run7' and not success",
}

Row = tuple[str, float, str]


def main() -> None:
    """Measure what the command line names."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("parts", nargs="*", metavar="PART", help="which; by default all")
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--files", type=int, default=20_000)
    parser.add_argument("--members", type=int, default=100_000)
    parser.add_argument("--episodes", type=int, default=100_000, help="of which memory is measured")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    found: list[Row] = []
    with tempfile.TemporaryDirectory(prefix="coordlog-bench-") as name:
        for part in options.parts or PARTS:
            folder = Path(name) / part
            folder.mkdir()
            for row in PARTS[part](folder, options):
                found.append(row)
                print(f"{row[0]:58} {row[1]:12.5g} {row[2]}", flush=True)
            shutil.rmtree(folder)
    if options.json:
        options.json.write_text(json.dumps(found, indent=2))


def timed(function: Callable[[], object], *, runs: int = RUNS) -> float:
    """Processor time of a call [s], all threads together: the least of a few runs.

    On an idle machine it takes no longer; on a busy one it is all that can be compared.
    """
    times = []
    for _ in range(runs):
        began = time.process_time()
        function()
        times.append(time.process_time() - began)
    return min(times)


def made_rows(n: int) -> pa.Table:
    """Rows of a catalogue with random values."""
    rng = np.random.default_rng(1)
    scenes = np.array(["free", "spheres", "table", "shelf"])[rng.integers(0, 4, n)]
    success = rng.random(n) < 0.9
    columns = {
        "path": np.char.add(np.char.zfill(np.arange(n).astype(str), 9), ".mcap"),
        "digest": [hashlib.sha256(i.to_bytes(8)).hexdigest() for i in range(n)],
        "goal": [f"{i:016x}" for i in rng.integers(0, n // 4 + 1, n)],
        "run": np.char.add("run", rng.integers(0, 500, n).astype(str)),
        "size": rng.integers(50_000, 150_000, n),
        "mtime": rng.integers(10**18, 2 * 10**18, n),
        "scene": scenes,
        "policy": np.array(["expert", "pretrained", "random"])[rng.integers(0, 3, n)],
        "length": rng.integers(1, 150, n),
        "duration": rng.random(n) * 6,
        "success": success,
        "clean": success & (rng.random(n) < 0.9),
        "seed": rng.integers(0, 100, n),
    }
    arrays = [
        pa.array(columns[field.name], field.type)
        if field.name in columns
        else pa.nulls(n, field.type)
        for field in KEPT
    ]
    return pa.Table.from_arrays(arrays, schema=KEPT)


def catalogue(folder: Path, options: argparse.Namespace) -> Iterator[Row]:
    """Queries over many rows."""
    catalog = Catalog(_empty(folder / "logs"))
    catalog._write(made_rows(options.rows))
    (part,) = (folder / "logs" / ".catalog").iterdir()
    yield f"catalogue of {options.rows:,} rows", part.stat().st_size / 1e6, "MB"
    source = Source(Catalog(folder / "logs").source(), "logs")
    for name, sql in QUERIES.items():
        yield f"query: {name}", timed(partial(ask, sql, [source])), "s"
    yield "all rows into memory", timed(lambda: Catalog(folder / "logs").rows(), runs=3), "s"


def selections(folder: Path, options: argparse.Namespace) -> Iterator[Row]:
    """Editing a list of a tenth as many episodes."""
    n = options.rows // 10
    gathered = Gathered(sources=[Source(made_rows(n), "logs")], folders=["logs"])
    out = folder / "a.manifest"
    how = Split.parse("0.8,0.1,0.1", by="goal")
    whole = select(gathered, split=how, out=out)
    yield f"write {n:,} episodes", timed(lambda: manifest.write(_new(out), whole), runs=3), "s"
    yield "read them", timed(lambda: manifest.read(out), runs=3), "s"
    half = select(gathered, where="clean", out=out)
    edits = {
        "divide by goal": lambda: select(gathered, split=how, out=out),
        "keep what is clean": lambda: select(gathered, where="clean", out=out),
        "take one set from another": lambda: select(gathered, minus=[half], out=out),
        "one of each goal": lambda: select(gathered, unique="goal", out=out),
    }
    for name, edit in edits.items():
        yield f"edit: {name}", timed(edit, runs=3), "s"


def files(folder: Path, options: argparse.Namespace) -> Iterator[Row]:
    """Catalogue and check of real files."""
    n = options.files
    logs = copies(folder / "logs", n)
    began = time.perf_counter()
    list(mapped(_hashed, [logs[i::8] for i in range(8)], jobs=0))
    hashing = time.perf_counter() - began
    yield f"read and hash {n:,} files", hashing / n * 1e3, "ms a file"
    began = time.perf_counter()
    gather([folder / "logs"], run=lambda function, jobs: mapped(function, jobs, jobs=0))
    yield "describe them for the catalogue", (time.perf_counter() - began) / n * 1e3, "ms a file"
    scan = timed(lambda: gather([folder / "logs"]), runs=3)
    yield "look again, nothing new", scan / n * 1e3, "ms a file"
    began = time.perf_counter()
    list(mapped(_checked, [logs[i::8] for i in range(8)], jobs=0))
    checking = time.perf_counter() - began
    yield "check --level file", checking / n * 1e3, "ms a file"
    yield "check against read and hash", hashing / checking, "× its speed"
    few = logs[: n // 10]
    yield (
        "info, from the ends of the files",
        timed(lambda: summary(gather(few)), runs=1) / len(few) * 1e3,
        "ms a file",
    )
    sql = "select scene, count(*), sum(length), avg(clean::int) from episodes group by 1"
    ready = timed(lambda: ask(sql, gather([folder / "logs"]).sources), runs=3)
    yield f"the same of all {n:,}, asked of the catalogue", ready, "s"


def packs(folder: Path, options: argparse.Namespace) -> Iterator[Row]:
    """Packing, and one member among many."""
    logs = copies(folder / "logs", min(options.files, 5000))
    names = [(path, name_within(path, folder / "logs", several=False)) for path in logs]
    size = sum(path.stat().st_size for path in logs)
    began = time.perf_counter()
    for path in logs:
        (folder / "copy.mcap").write_bytes(path.read_bytes())
    copying = time.perf_counter() - began
    began = time.perf_counter()
    pack_files(names, folder / "PACK")
    yield "pack", size / (time.perf_counter() - began) / 1e6, "MB/s"
    yield "copy one by one", size / copying / 1e6, "MB/s"
    rng = np.random.default_rng(1)
    with PackWriter(folder / "MANY") as writer:
        for i in range(options.members):
            writer.append(f"{i:08}.mcap", rng.bytes(8000), mtime=0)
    pack = Pack(Folder(folder / "MANY"))
    places = [
        (shard.name, member.name)
        for shard in pack.shards()
        for member in pack.index(shard.name).members
    ]
    chosen = [places[i] for i in rng.integers(0, len(places), 2000)]
    yield (
        f"one of {options.members:,} members",
        timed(lambda: [fetch(folder / "MANY" / s / n) for s, n in chosen], runs=1) / 2000 * 1e3,
        "ms",
    )
    cold = [sys.executable, "-c", _COLD, str(folder / "MANY" / chosen[0][0] / chosen[0][1])]
    yield (
        "one member, in a new process, index included",
        float(os.popen(" ".join(map(_quoted, cold))).read()),
        "ms",
    )


_COLD = (
    "import sys, time; from coordlog.record.addresses import fetch; began = time.perf_counter();"
    "fetch(sys.argv[1]); print((time.perf_counter() - began) * 1e3)"
)


COMMANDS = {
    "index": "index LOGS --jobs 1",
    "info": "info LOGS --jobs 1 --json",
    "query": "query SELECT LOGS --jobs 1 --json",
    "select": "select LOGS --out OUT/a.manifest --where clean --jobs 1",
    "diff": "diff LOGS OUT/a.manifest --jobs 1 --json",
    "check": "check LOGS --level file --jobs 1",
    "pack": "pack LOGS --out OUT/PACK --jobs 1",
    "export": "export LOGS --to csv --out OUT/csv --jobs 1",
}
"""Command lines whose memory is measured; of one process, so that it is all of it."""


def memory(folder: Path, options: argparse.Namespace) -> Iterator[Row]:
    """The most memory that a command takes of a third of the episodes, and of all; and by the
    difference of a hundred thousand.
    """
    n = options.episodes
    sizes: dict[str, list[float]] = {name: [] for name in COMMANDS}
    for count in (n // 3, n):
        logs, out = folder / f"logs{count}", folder / f"out{count}"
        different(logs, count)
        out.mkdir()
        for name, line in COMMANDS.items():
            words = [
                word.replace("LOGS", str(logs)).replace("OUT", str(out)) for word in line.split()
            ]
            words = [STATEMENT if word == "SELECT" else word for word in words]
            sizes[name].append(peak(words))
    for name, (few, many) in sizes.items():
        each = (many - few) / (n - n // 3)
        yield f"memory of {name}, {n:,} episodes", many / 1e6, "MB"
        yield f"of {name}, 100,000 by the slope", (many + max(each, 0) * (100_000 - n)) / 1e9, "GB"


STATEMENT = "select path, goal, length from episodes order by length"


def peak(words: list[str]) -> float:
    """Most memory that a command had at a time [bytes]."""
    with open(os.devnull, "w") as nowhere:
        command = [sys.executable, "-m", "coordlog.cli", *words]
        process = subprocess.Popen(command, stdout=nowhere, stderr=nowhere)
        _, status, usage = os.wait4(process.pid, 0)
    assert os.waitstatus_to_exitcode(status) in (0, 1), words  # diff: 1, the sets differ
    return usage.ru_maxrss * 1024.0


def different(folder: Path, n: int) -> None:
    """Small episodes, a thousand to a folder: copies of a few with other headers."""
    from tests.catalog.logs import write

    few = [_taken_apart(write(folder / f"{i}.mcap", i)) for i in range(20)]
    for path in folder.glob("*.mcap"):
        path.unlink()
    for i in range(n):
        path = folder / f"{i // 1000:04}" / f"{i:07}.mcap"
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(_copied(*few[i % len(few)], i))


def _taken_apart(path: Path) -> tuple[Episode, dict[str, tuple[int, int]], list[Any]]:
    """An episode, what its commit marker says of messages, and its chunks."""
    episode, chunks = read_episode(path), []
    with patch.object(Container, "add_chunk", lambda self, chunk: chunks.append((self, chunk))):
        write_episode(path.with_suffix(".b.mcap"), episode, attachments={}, display=False)
    said = vouched(metadata(path.read_bytes()))["messages"]
    defined = chunks[0][0]
    return episode, said, [defined, *(chunk for _, chunk in chunks)]


def _copied(
    episode: Episode, messages: dict[str, tuple[int, int]], parts: list[Any], number: int
) -> bytes:
    """The same episode as if it were another of its run."""
    about = {"id": f"{number:08x}", "seed": number, "index": number, "goals": [[number % 9, 0, 0]]}
    header = encode_header(replace(episode.header, episode=episode.header.episode | about))
    container = Container(LIBRARY)
    for name, values in header.items():
        container.add_metadata(name, values)
    container.books.schemas = parts[0].books.schemas
    container.books.channels = parts[0].books.channels
    for chunk in parts[1:]:
        container.add_chunk(chunk)
    marker = encode_commit(episode.result, metadata=header, attachments={}, messages=messages)
    container.commit(RESULT, partial(sealed, marker))
    return container.drain()


def storage(folder: Path, options: argparse.Namespace) -> Iterator[Row]:
    """Requests that a real S3 server was asked."""
    from tests.record.s3 import ENVIRONMENT, Server

    server = Server()
    os.environ |= {**ENVIRONMENT, "AWS_ENDPOINT_URL": server.url}
    store = ObjectStore("s3://robots/logs")
    chosen = EPISODES[:10]
    for path in chosen:
        store.publish(path.name, Path(shutil.copy(path, folder)))
    yield "publish an episode", len(server.requests) / len(chosen), "requests"
    server.requests.clear()
    same = [store.read(path.name) == path.read_bytes() for path in chosen]
    assert all(same)
    yield "read an episode", len(server.requests) / len(chosen), "requests"
    yield "read an episode", timed(lambda: store.read(chosen[0].name)) * 1e3, "ms"
    with urlopen(Request(f"{server.url}/robots")) as reply:
        listing = len(reply.read())
    yield "bytes of a listing, for each object", listing / len(chosen), "B"
    server.stop()


PARTS: dict[str, Callable[[Path, argparse.Namespace], Iterator[Row]]] = {
    "catalogue": catalogue,
    "selections": selections,
    "files": files,
    "packs": packs,
    "storage": storage,
    "memory": memory,
}


def copies(folder: Path, n: int) -> list[Path]:
    """Copies of the fixtures, a thousand to a folder."""
    texts = [path.read_bytes() for path in EPISODES]
    paths = []
    for i in range(n):
        path = folder / f"{i // 1000:04}" / f"{i:07}.mcap"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(texts[i % len(texts)])
        paths.append(path)
    return paths


def _hashed(paths: list[Path]) -> list[str]:
    return [hashlib.sha256(path.read_bytes()).hexdigest() for path in paths]


def _checked(paths: list[Path]) -> int:
    return check_files(paths, level="file").files


def _empty(folder: Path) -> Path:
    folder.mkdir()
    return folder


def _new(path: Path) -> Path:
    path.unlink(missing_ok=True)
    return path


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "'\\''") + "'"


if __name__ == "__main__":
    main()
