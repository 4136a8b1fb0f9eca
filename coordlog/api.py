"""What the commands do, from Python: each verb in three lines.

    import coordlog

    coordlog.record("table", episodes=64, out="logs")
    assert not coordlog.check("logs").findings
    coordlog.train("logs", updates=2000, out="runs/first")
    coordlog.smooth("logs", out="smoothed")
    coordlog.view("smoothed", save="smoothed.rrd")

Everything raises `coordlog.errors.CoordlogError` for what can go wrong on purpose. Heavy libraries
are loaded by the verb that needs them.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coordlog.errors import ConfigError, unknown

if TYPE_CHECKING:
    from coordlog.contracts import Policy
    from coordlog.episode import Json
    from coordlog.exchange.blocks import Done
    from coordlog.record.dataset import Dataset
    from coordlog.smooth.result import Result as Smoothed
    from coordlog.tasks.scene import Scene
    from coordlog.verify.levels import Checked

OF_ENVIRONMENTS = ("about", "each", "source", "verify")
"""Options of `record` with an environment of another program."""
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
    episodes: int = 10,
    out: Source = "logs",
    seed: int = 0,
    split: str = "train",
    noise: float = 0.0,
    **options: Any,
) -> list[Path]:
    """Record episodes, one file each, and return the files.

    Args:
        what: A scene: its name, FILE.py:NAME, ROBOT.toml, or a `Scene`. Or an environment of
            another program on MuJoCo, as Gymnasium's are; the policy is then "random", a
            function from observation to action, or an object with `predict` or `act`, and `options` are those of `coordlog.record.foreign.record_env`.
        policy: Name as on the command line, or a `Policy` (`coordlog.contracts`).
        episodes: How many.
        out: Folder; files already in it stay as they are.
        seed: Of goals, obstacles, start poses and noise.
        split: "train", or "test": problems that training never sees.
        noise: Standard deviation of Gaussian noise on the actions.
        options: Of scenes: `start` (name of the start pose), `envs` (simulations at once),
            `tables` (of constants: "env", "reward", "task"), `display` (topics for viewers).

    Raises:
        ConfigError: for an unknown name or option, or a value out of range.
        SimulationError: if physics cannot be built, or an environment cannot be replayed.
        StorageError: if a file cannot be written.

    Example:
        >>> record("table", episodes=2, out="logs")      # doctest: +SKIP
        [PosixPath('logs/table-train-s0-000000-….mcap'), …]
    """
    from coordlog.tasks.scene import Scene

    if not isinstance(what, str | Scene):
        from coordlog.policies.foreign import as_act
        from coordlog.record.foreign import record_env

        for name in options:
            if name not in OF_ENVIRONMENTS:
                raise unknown("option of an environment", name, OF_ENVIRONMENTS)
        if noise:
            raise ConfigError("noise: only scenes have it; let the policy of an environment add it")
        if policy == "random" and hasattr(what, "action_space"):
            what.action_space.seed(seed)
            policy = lambda observation: what.action_space.sample()  # noqa: E731
        act = as_act(policy, "policy")
        done = record_env(what, act, episodes=episodes, out=Path(out), seed=seed, **options)
        return sorted(done.files)
    return _record_scene(
        what, policy, episodes=episodes, out=Path(out), drawn=(seed, split), noise=noise, **options
    )


def _record_scene(
    what: str | Scene,
    policy: str | Policy,
    *,
    episodes: int,
    out: Path,
    drawn: tuple[int, str],
    noise: float,
    start: str = "stand",
    **options: Any,
) -> list[Path]:
    from coordlog.policies.registry import make_policy
    from coordlog.policies.scripted import with_noise
    from coordlog.record.recorder import Finished, Recorder
    from coordlog.sim.making import make_env
    from coordlog.sim.rollout import rollout
    from coordlog.tasks.own import scene_of

    for name in options:
        if name not in ("envs", "tables", "display"):
            raise unknown("option", name, ("start", "envs", "tables", "display"))
    scene = scene_of(what) if isinstance(what, str) else what
    env = make_env(
        scene,
        options.get("tables", {}),
        start=start,
        envs=min(options.get("envs", 16), episodes),
        threads=0,
    )
    if isinstance(policy, str):
        chosen, said = make_policy(policy, env)
    else:
        chosen = policy
        said = {"kind": "own", "name": type(policy).__name__, "checkpoint_sha256": ""}
    actor, said["noise"] = with_noise(chosen, env, sigma=noise, correlation=0.0)
    done: list[Finished] = []
    shown = options.get("display", True)
    (seed, split) = drawn
    with Recorder(env, out, policy=said, display=shown, finished=done.append) as recorder:
        for _ in rollout(recorder, actor, range(episodes), seed=seed, split=split):
            pass
    return sorted(item.path for item in done)


def check(source: Source | Sequence[Source], *, level: str = "replay") -> Checked:
    """Prove that every episode is whole, consistent, and simulates again from its file alone.

    Args:
        source: Files or folders.
        level: "file": structure and checksums. "content": and values. "replay": and the physics,
            bit for bit.

    Raises:
        ConfigError: for an unknown level.
        FormatError: if there is no episode: a proof that looked at nothing is none.

    Example:
        >>> check("logs").findings                        # doctest: +SKIP
        []
    """
    from coordlog.record.files import find_files, nothing_found
    from coordlog.verify.levels import LEVELS, check_files

    if level not in LEVELS:
        raise unknown("level", level, LEVELS)
    paths = _paths(source)
    files = find_files(paths)
    if not files.paths:
        raise nothing_found(paths, files)
    return check_files(list(files.paths), level=level)


def train(source: Source | Sequence[Source] | None = None, *, out: Source, **options: Any) -> Path:
    """Learn from logs, live, or both, and return the run folder; progress is shown.

    Args:
        source: Logs to learn from; None: live simulations alone.
        out: Run folder, which must be new (or `resume=True`).
        options: As on the command line, by the names there: scene, live, where, preset, updates,
            steps, seed, eval_every, … (`coordlog train --help`).

    Raises:
        ConfigError: for an unknown option, name, or value out of range.

    Example:
        >>> train("logs", updates=2000, out="runs/first")     # doctest: +SKIP
        PosixPath('runs/first')
    """
    import inspect

    import typer

    from coordlog.commands import train as command

    known = inspect.signature(command.train).parameters
    for name in options:
        if name not in known:
            raise unknown("option", name, known)
    logs = None if source is None else _paths(source)
    try:
        command.train(source=logs, out=Path(out), **options)
    except typer.Exit as ended:
        if ended.exit_code not in (0, 3):
            raise ConfigError(f"{out}: the run did not end well; see {out}/metrics.jsonl") from None
    return Path(out)


def smooth(source: Any, *rest: Any, out: Source | None = None, **options: Any) -> Json | Smoothed:
    """Smooth logs into a folder, or one joint path given as arrays.

    Args:
        source: Logs; or the times (T,) [s] of one path.
        rest: For a path: joint angles (T, n_j), and a checker (`coordlog.contracts.Checker`);
            without one nothing is in the way. `coordlog.smooth.smoother.smooth` says the rest.
        out: For logs: folder for the smoothed episodes.
        options: method, cutoff, max_deviation, clearance, …

    Returns:
        For logs the report (a row for every episode); for a path its `Result`.

    Raises:
        ConfigError: for an unknown option, or logs without `out`.
        SpecError: for a path that cannot be smoothed.

    Example:
        >>> smooth("logs", out="smoothed")["statuses"]        # doctest: +SKIP
        {'smoothed': 10}
    """
    if rest:
        import numpy as np

        from coordlog.smooth.feasibility import Unobstructed
        from coordlog.smooth.smoother import smooth as smooth_path

        angles, *given = rest
        checker = given[0] if given else Unobstructed(np.shape(angles)[-1])
        return smooth_path(source, angles, checker, **options)
    if out is None:
        raise ConfigError("smooth: expected a folder for the smoothed logs (out=…), got none")
    from coordlog.smooth.batch import plan, summary

    force = bool(options.pop("force", False))
    settings = {"method": "local", "cutoff": "max", "clearance": 0.005} | options
    batch = plan(_paths(source), Path(out), settings, force=force)
    return summary(list(batch.run()), batch, settings, seconds=0.0)


def view(
    source: Source | Sequence[Source], *, save: Source | None = None, ghosts: bool = False
) -> Any:
    """Build the rerun recording of episodes: robot, contacts, plots, knots against splines.

    Returns a `rerun.RecordingStream`.

    Args:
        source: Episode files, shown together.
        save: Also write it to this `.rrd`; open that with `rerun FILE`.
        ghosts: Robots in one place, translucent, instead of side by side.

    Raises:
        FormatError: if a file is no episode.
        StorageError: if `save` exists.

    Example:
        >>> view("logs/episode.mcap", save="episode.rrd")     # doctest: +SKIP
    """
    from coordlog.errors import StorageError
    from coordlog.record.files import find_files, nothing_found
    from coordlog.record.reader import read_attachments, read_episode
    from coordlog.view.recording import to_rerun
    from coordlog.view.show import Show

    if save is not None and Path(save).exists():
        raise StorageError(f"{save}: the file exists and is not overwritten; choose another name")
    paths = _paths(source)
    files = find_files(paths)
    if not files.paths:
        raise nothing_found(paths, files)
    shows = [
        Show(f"{path.parent.name}/{path.stem}", read_episode(path), read_attachments(path))
        for path in files.paths
    ]
    stream = to_rerun(shows, ghosts=ghosts)
    if save is not None:
        stream.save(str(save))
    return stream


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


def _paths(source: Source | Sequence[Source]) -> list[Path]:
    several = [source] if isinstance(source, str | os.PathLike) else source
    return [Path(each) for each in several]
