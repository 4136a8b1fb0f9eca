"""Logs as training data: found, cached, filtered, and refused when they do not belong together."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from coordlog.catalog.asking import chosen, scenes
from coordlog.errors import SpecError
from coordlog.monitor import Monitor
from coordlog.parallel import mapped
from coordlog.sim.foreign import of_environment

if TYPE_CHECKING:
    from coordlog.record.cache import Built, Logs


def cache_folder() -> Path:
    """Where decoded columns are kept: the user's cache folder. Deleting it only costs time."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "coordlog" / "columns"


def load_logs(
    paths: Sequence[Path],
    *,
    where: str = "",
    skip_broken: bool = False,
    jobs: int | str = 0,
    verify: bool = False,
    monitor: Monitor | None = None,
    environments: bool = False,
) -> Logs:
    """The episodes under some folders that satisfy a condition, as columns; all of one scene and
    one state layout. Those of environments that are not ours only if asked for.

    Raises:
        FormatError: if a file is broken and they are not to be skipped.
        ConfigError: if the condition is no SQL, or nothing satisfies it.
        SpecError: if there is nothing to learn from, or the episodes are of several scenes.
    """
    from coordlog.record.cache import load
    from coordlog.record.files import find_files, nothing_found, refused

    files = chosen(paths, where, jobs=jobs, monitor=monitor) if where else find_files(paths)
    if not files.paths:
        raise nothing_found(paths, files, wanted="no logs: ")
    require_one_scene(scenes(paths, files))  # before all of them are decoded
    heard = Monitor() if monitor is None else monitor

    def run(
        build: Callable[[Sequence[Path]], Built], groups: Sequence[Sequence[Path]]
    ) -> Iterable[Built]:
        with heard.progress("decoding new logs", sum(map(len, groups))) as progress:
            for built in mapped(build, groups, jobs=jobs):
                progress.advance(built.files)
                yield built

    logs = load(files.paths, cache_folder(), run=run, verify=verify)
    logs = replace(logs, skipped=(*files.skipped, *logs.skipped))
    for text in logs.notes:
        heard.note(text)
    if logs.skipped and not skip_broken:
        raise refused(logs.skipped, "--skip-broken learns from the others")
    for item in logs.skipped:
        heard.note(f"skipped: {item.path}: {item.reason}")
    require_one_scene(logs.episodes.column("scene").to_pylist())
    if not (environments and of_environment(logs.env(0))):
        _require_task(logs)
    _require_alike(logs)
    return logs


def require_one_scene(scenes: Iterable[str]) -> None:
    """Refuse episodes of several scenes.

    Raises:
        SpecError: if there are.
    """
    found = sorted(set(scenes))
    if len(found) > 1:
        raise SpecError(
            f"logs of several scenes ({', '.join(found)}): learn from one, for example"
            f" --where \"scene = '{found[0]}'\""
        )


def _require_task(logs: Logs) -> None:
    """Refuse episodes that no task of ours judged, by what their steps lack."""
    if {"distance", "collision", "instability"} <= {*logs.steps.column_names}:
        return
    env, file = logs.env(0), logs.episodes.column("file")[0].as_py()
    name = env.get("task", {}).get("name", "")
    got = f"steps of a task '{name}' without them" if name else "an observed one, which has none"
    raise SpecError(
        f"{file}: expected an episode with distances to goals, collisions and falls, got {got}; "
        "other learners take it after `coordlog export`"
    )


def _require_alike(logs: Logs) -> None:
    from coordlog.train.bind import require_alike

    first = logs.env(0)
    seen = {logs.episodes.column("env")[0].as_py()}
    for i, text in enumerate(logs.episodes.column("env").to_pylist()):
        if text not in seen:
            seen.add(text)
            require_alike(first, logs.env(i), where=logs.episodes.column("file")[i].as_py())
