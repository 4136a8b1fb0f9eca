"""Logs as training data without holding them: listed by their catalogues, streamed when they are
learnt from.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from coordlog.api.logs import require_one_scene
from coordlog.errors import ConfigError
from coordlog.monitor import Monitor
from coordlog.parallel import mapped

if TYPE_CHECKING:
    from coordlog.episode import Json
    from coordlog.record.cache import Logs
    from coordlog.train.columns import Columns
    from coordlog.train.stream import Group, Stream


_EPISODES = """
    select digest, path as file, scene, length from episodes where length > 0 order by digest, path
"""


def listed(
    paths: Sequence[Path],
    *,
    where: str = "",
    skip_broken: bool = False,
    jobs: int | str = 0,
    monitor: Monitor | None = None,
) -> Logs:
    """The episodes that satisfy a condition, by their catalogues: which there are, and no steps.

    Raises:
        FormatError: if a file is broken and they are not to be skipped.
        ConfigError: if the condition is no SQL, or nothing satisfies it.
        SpecError: if there is nothing to learn from, or the episodes are of several scenes.
    """
    import pyarrow as pa

    from coordlog.catalog.asking import gathered
    from coordlog.catalog.query import ask
    from coordlog.record.cache import Logs
    from coordlog.record.files import find_files, nothing_found, refused
    from coordlog.record.recording import Recording

    found = gathered(paths, jobs=jobs, monitor=monitor, tell=skip_broken)
    if found.skipped and not skip_broken:
        raise refused(found.skipped, "--skip-broken learns from the others")
    rows = ask(_EPISODES, found.sources, where=where)
    if not len(rows) and where:
        raise ConfigError(f"--where: no episode satisfies: {where}")
    if not len(rows):
        raise nothing_found(paths, find_files(paths), wanted="no logs: ")
    require_one_scene(rows.column("scene").to_pylist())
    first = json.dumps(Recording(rows.column("file")[0].as_py()).header.env)
    envs = pa.array([first] + [""] * (len(rows) - 1))  # of the others it is looked at when read
    return Logs(pa.table({}), rows.append_column("env", envs), tuple(found.skipped))


def stream_of(logs: Logs, *, memory: int, jobs: int | str, seed: int) -> Stream:
    """A stream of listed episodes, read in processes of their own.

    Args:
        logs: As `listed` gives them.
        memory: Bytes that its window may take.
        jobs: Processes that read; 0 for one per core but one.
        seed: Seed of the order.
    """
    from coordlog.train.bind import require_alike
    from coordlog.train.stream import Logged, Stream, read

    first: Json = logs.env(0)
    readers = jobs if jobs not in (0, "0") else max(1, (os.cpu_count() or 2) - 1)

    def reader(groups: Iterator[Group]) -> Iterator[Columns]:
        seen: set[str] = set()
        with closing(mapped(read, groups, jobs=readers)) as found:  # type: ignore[type-var]
            for each in found:
                for text, path in each.envs.items():
                    if text not in seen:
                        require_alike(first, json.loads(text), where=path)
                        seen.add(text)
                yield each.columns

    columns = (logs.episodes.column(name).to_pylist() for name in ("file", "digest", "length"))
    logged = [Logged(file, digest, length) for file, digest, length in zip(*columns, strict=True)]
    return Stream(logged, reader, memory=memory, seed=seed)
