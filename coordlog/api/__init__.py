"""What the commands do, from Python: each verb in three lines.

    import coordlog

    coordlog.record("table", episodes=64, out="logs")
    assert not coordlog.check("logs").findings
    coordlog.train("logs", updates=2000, out="runs/first")
    coordlog.smooth("logs", out="smoothed")
    coordlog.view("smoothed", save="smoothed.rrd")

Everything raises `coordlog.errors.CoordlogError` for what can go wrong on purpose. What is worth a
word goes to the log "coordlog" of `logging`; a `coordlog.Monitor` hears of it instead, and of
progress. Heavy libraries are loaded by the verb that needs them.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from coordlog.errors import ConfigError, SpecError, StorageError, unknown
from coordlog.monitor import Monitor

if TYPE_CHECKING:
    from coordlog.episode import Json
    from coordlog.exchange.blocks import Done
    from coordlog.record.dataset import Dataset
    from coordlog.smooth.result import Result as Smoothed
    from coordlog.verify.levels import Checked

OF_ENVIRONMENTS = ("about", "source", "verify")
"""Options of `record` with an environment of another program."""
BATCH = ("write", "force", "share", "jobs", "monitor")
"""Options of `smooth` for logs that are not about how a path is smoothed."""
Plan = TypeVar("Plan")
Source = str | os.PathLike[str]
"""A file, a folder that is searched at any depth, a pack, a manifest, or s3://…"""


def open(source: Source | Iterable[Source], *, skip_broken: bool = False) -> Dataset:
    """Open logs as a lazy sequence of episodes (`coordlog.record.dataset.open`)."""
    from coordlog.record.dataset import open as opened

    return opened(source, skip_broken=skip_broken)


def record(
    what: Any = "table",
    policy: Any = "expert",
    *,
    episodes: int | None = None,
    out: Source = "logs",
    seed: int = 0,
    monitor: Monitor | None = None,
    **options: Any,
) -> list[Path]:
    """Record episodes, one file each, and return the files.

    Args:
        what: A scene: its name, FILE.py:NAME, ROBOT.toml, or a `Scene`; "" for the policy's. Or an
            environment of another program on MuJoCo, as Gymnasium's are; the policy is then
            "random", a run folder or another name as on the command line, a function from
            observation to action, or an object with `predict` or `act`.
        policy: Name as on the command line, or a `Policy` (`coordlog.contracts`).
        episodes: How many; by default 10.
        out: Folder, pack or s3://…; files already in it stay as they are.
        seed: Of goals, obstacles, start poses and noise.
        monitor: Hears of progress, and may ask to stop.
        options: Of scenes: all others of `coordlog.api.recording.RecordPlan`: split, noise, start,
            envs, tables, display, branch, … Of an environment: those of
            `coordlog.record.foreign.record_env`.

    Raises:
        ConfigError: for an unknown name or option, or a value out of range.
        SimulationError: if physics cannot be built, or an environment cannot be replayed.
        StorageError: if a file cannot be written.

    Example:
        >>> record("table", episodes=2, out="logs")      # doctest: +SKIP
        [PosixPath('logs/table-train-s0-000000-….mcap'), …]
    """
    from coordlog.api.recording import EPISODES, RecordPlan, actor, record_scene
    from coordlog.tasks.scene import Scene

    if isinstance(what, str | Scene):
        given = {"scene": what, "policy": policy, "episodes": episodes, "seed": seed, **options}
        plan = _plan(RecordPlan, given)
        return record_scene(plan, Path(out), Monitor() if monitor is None else monitor).files
    from coordlog.record.foreign import record_env

    for name in options:
        if name not in OF_ENVIRONMENTS:
            raise unknown("option of an environment", name, OF_ENVIRONMENTS)
    heard, source = Monitor() if monitor is None else monitor, options.get("source")
    act, about = actor(what, policy, seed=seed, monitor=heard, source=source)
    options = {"about": about, **options}
    count = episodes or EPISODES
    return sorted(record_env(what, act, episodes=count, out=Path(out), seed=seed, **options).files)


def check(
    source: Source | Sequence[Source],
    *,
    level: str = "replay",
    jobs: int | str = 1,
    monitor: Monitor | None = None,
) -> Checked:
    """Prove that every episode is whole, consistent, and simulates again from its file alone.

    Args:
        source: Files or folders.
        level: "file": structure and checksums. "content": and values. "replay": and the physics,
            bit for bit.
        jobs: Processes, 0 for one per core; "ray" for a cluster.
        monitor: Hears of progress.

    Raises:
        ConfigError: for an unknown level.
        FormatError: if there is no episode: a proof that looked at nothing is none.

    Example:
        >>> check("logs").findings                        # doctest: +SKIP
        []
    """
    from coordlog.verify.levels import check_logs

    return check_logs(_paths(source), level=level, jobs=jobs, monitor=monitor)


def train(
    source: Source | Sequence[Source] | None = None,
    *,
    out: Source | None = None,
    monitor: Monitor | None = None,
    **options: Any,
) -> Path:
    """Learn from logs, live, or both, and return the run folder.

    Args:
        source: Logs to learn from; None: live simulations alone.
        out: Run folder, which must be new (or `resume=True`); by default runs/SCENE-SOURCE-sSEED.
        monitor: Hears of progress, and may ask to stop: the run then saves itself.
        options: All others of `coordlog.api.train_plan.TrainPlan`: scene, live, where, preset,
            updates, steps, seed, eval_every, …

    Raises:
        ConfigError: for an unknown option, name, or value out of range; or a run that diverged.

    Example:
        >>> train("logs", updates=2000, out="runs/first")     # doctest: +SKIP
        PosixPath('runs/first')
    """
    from coordlog.api import training
    from coordlog.api.train_plan import TrainPlan

    given = {
        "source": None if source is None else _paths(source),
        "out": None if out is None else Path(out),
        **options,
    }
    trained = training.train(_plan(TrainPlan, given), Monitor() if monitor is None else monitor)
    if trained.outcome.event is not None:
        event = trained.outcome.event
        raise ConfigError(f"{trained.folder}: the run diverged: {event.name}: {event.advice}")
    return trained.folder


def smooth(source: Any, *rest: Any, out: Source | None = None, **options: Any) -> Json | Smoothed:
    """Smooth logs into a folder, or one joint path given as arrays.

    Args:
        source: Logs; or the times (T,) [s] of one path.
        rest: For logs the folder, if not as `out`. For a path joint angles (T, n_j), and a checker
            (`coordlog.contracts.Checker`); without one nothing is in the way.
            `coordlog.smooth.smoother.smooth` says the rest.
        out: For logs: folder for the smoothed episodes.
        options: method, cutoff, max_deviation, clearance, …; for logs also force, write, share,
            jobs and monitor (`coordlog.smooth.batch.smooth_logs`).

    Returns:
        For logs the report (a row for every episode); for a path its `Result`.

    Raises:
        ConfigError: for an unknown option, or logs without a folder or with several.
        SpecError: for a path that cannot be smoothed.

    Example:
        >>> smooth("logs", out="smoothed")["statuses"]        # doctest: +SKIP
        {'smoothed': 10}
    """
    if rest and isinstance(rest[0], str | os.PathLike):
        if len(rest) > 1 or out is not None:
            raise ConfigError("smooth: expected one folder for the smoothed logs, got several")
        out, rest = rest[0], ()
    if rest:
        import numpy as np

        from coordlog.smooth.feasibility import Unobstructed
        from coordlog.smooth.smoother import smooth as smooth_path

        angles, *given = rest
        if np.ndim(angles) != 2:
            got = type(angles).__name__
            raise SpecError(f"smooth: expected a folder, or joint angles (T, n_j), got a {got}")
        checker = given[0] if given else Unobstructed(np.shape(angles)[-1])
        return smooth_path(source, angles, checker, **options)
    if out is None:
        raise ConfigError("smooth: expected a folder for the smoothed logs (out=…), got none")
    from coordlog.api.smoothing import smooth_logs

    how = {name: options.pop(name) for name in BATCH if name in options}
    return smooth_logs(_paths(source), Path(out), options, **how)


def view(
    source: Source | Sequence[Source],
    *,
    save: Source | None = None,
    beside: Source | None = None,
    alone: bool = False,
    ghosts: bool = False,
    monitor: Monitor | None = None,
) -> Any:
    """Build the rerun recording of episodes: robot, contacts, plots, knots against splines.

    Returns a `rerun.RecordingStream`.

    Args:
        source: Episode files, shown together; or one folder, for an overview.
        save: Also write it to this `.rrd`, which completes it; open that with `rerun FILE`.
        beside: Another episode beside it; by default the smoothed or raw sibling of a single one.
        alone: Do not look for a sibling.
        ghosts: Robots in one place, translucent, instead of side by side.
        monitor: Hears of progress, and of what is left out.

    Raises:
        ConfigError: if there is nothing to show.
        FormatError: if a file is no episode.
        StorageError: if `save` exists.

    Example:
        >>> view("logs/episode.mcap", save="episode.rrd")     # doctest: +SKIP
    """
    from coordlog.view import files

    if save is not None and Path(save).exists():
        raise StorageError(f"{save}: the file exists and is not overwritten; choose another name")
    drawn = files.draw_files(
        _paths(source),
        beside=None if beside is None else Path(beside),
        alone=alone,
        ghosts=ghosts,
        monitor=monitor,
    )
    if save is not None:
        files.save(drawn.stream, Path(save))
    return drawn.stream


def export(source: Source | Sequence[Source], *, to: str, out: Source, **options: Any) -> Done:
    """Write episodes as another program's data set.

    Args:
        source: Logs.
        to: lerobot, lerobot2.1, minari, robomimic, rosbag2, parquet or csv.
        out: Folder of the set; appears when it is complete.
        options: Of `coordlog.exchange.blocks.Options`: cameras, width, height, storage; and
            `force`, `jobs`.

    Raises:
        ConfigError: for an unknown format, or episodes that do not fit in one set.
        FormatError: if there is no episode.
        StorageError: if something else is at `out`.

    Example:
        >>> export("logs", to="lerobot", out="sets/table")    # doctest: +SKIP
    """
    from coordlog.exchange.blocks import Options
    from coordlog.exchange.blocks import export as write
    from coordlog.exchange.source import entries

    how = {name: options.pop(name) for name in ("force", "jobs") if name in options}
    found, _ = entries(_paths(source))
    return write(found, Path(out), Options(to, **options), **how)


def _plan(kind: type[Plan], given: dict[str, Any]) -> Plan:
    """A plan from keywords.

    Raises:
        ConfigError: for an unknown one; the message lists them.
    """
    known = [field.name for field in fields(kind)]  # type: ignore[arg-type]
    for name in given:
        if name not in known:
            raise unknown("option", name, known)
    return kind(**given)


def _paths(source: Source | Sequence[Source]) -> list[Path]:
    several = [source] if isinstance(source, str | os.PathLike) else source
    return [Path(each) for each in several]
