"""coordlog train: DiGrad from logs, from live simulations, or from both."""

from __future__ import annotations

import hashlib
import uuid
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coordlog.commands import terminal
from coordlog.commands.logs import load_logs
from coordlog.commands.streams import listed, size_of, stream_of
from coordlog.errors import EXIT_CHECK_FAILED, EXIT_INTERRUPTED, EXIT_PARTIAL, ConfigError
from coordlog.parallel import workers

if TYPE_CHECKING:
    from collections.abc import Mapping

    from coordlog.episode import Json
    from coordlog.record.cache import Logs
    from coordlog.sim.env import BatchEnv
    from coordlog.train.settings import Settings
    from coordlog.train.task import Outcome

STEPS = 150_000
"""Live steps of a run with the preset `default` that names no budget: enough for `free`."""


def train(
    source: Annotated[
        list[Path] | None,
        typer.Option("--from", help="Folders of logs to learn from; may be repeated."),
    ] = None,
    live: Annotated[
        bool,
        typer.Option(help="Simulate as well, if there are logs; without --from it always does."),
    ] = False,
    scene: Annotated[
        str, typer.Option(help="Scene to simulate, or FILE.py:NAME; by default that of the logs.")
    ] = "",
    where: Annotated[
        str, typer.Option(help="Which episodes, in SQL: \"clean and scene = 'table'\".")
    ] = "",
    preset: Annotated[
        str,
        typer.Option(
            help="default, live, or paper: as printed there. Without a word, live where there are fixed obstacles and no logs, else default."
        ),
    ] = "",
    config: Annotated[
        Path | None, typer.Option(help="TOML file of settings, [env] and [reward].")
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="One setting, section.key=value, also of [env] and [reward]; may be repeated.",
        ),
    ] = None,
    updates: Annotated[
        int | None,
        typer.Option(
            min=0, help="Gradient updates; 0, as with --steps alone: as many as those earn."
        ),
    ] = None,
    steps: Annotated[
        int | None, typer.Option(min=0, help="Live environment steps; by default the preset's.")
    ] = None,
    start: Annotated[
        str,
        typer.Option(help="Start pose of the robot; evaluations begin in stand and home as well."),
    ] = "stand",
    hindsight: Annotated[
        float | None,
        typer.Option(help="Share of each batch with goals in hindsight, of logs and live, 0 to 1."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 0,
    envs: Annotated[int, typer.Option(min=1, help="Live simulations at once.")] = 32,
    eval_every: Annotated[
        int | None, typer.Option(min=0, help="Updates between evaluations; 0 for none.")
    ] = None,
    eval_episodes: Annotated[
        int, typer.Option(min=1, help="Held-out episodes per evaluation.")
    ] = 100,
    out: Annotated[
        Path | None, typer.Option(help="Run folder; by default runs/SCENE-SOURCE-sSEED.")
    ] = None,
    resume: Annotated[
        bool,
        typer.Option("--resume", help="Go on with the run in --out, exactly where it stopped."),
    ] = False,
    device: Annotated[str, typer.Option(help="Where the networks live: cpu, cuda.")] = "cpu",
    skip_broken: Annotated[
        bool, typer.Option("--skip-broken", help="Leave out broken files instead of stopping.")
    ] = False,
    verify: Annotated[
        bool,
        typer.Option("--verify", help="Read every log again, also those that did not change."),
    ] = False,
    memory: Annotated[
        str,
        typer.Option(
            help="Let logs stream through a window of so many bytes, such as 500MB, instead of holding all of them."
        ),
    ] = "",
    collectors: Annotated[
        int,
        typer.Option(
            min=0,
            help="Collectors that share --envs among them and feed one learner; processes of a cluster with --jobs ray.",
        ),
    ] = 0,
    jobs: Annotated[
        str,
        typer.Option(
            help="Processes that read logs, 0 for one per core; ray or ray://HOST:PORT for --collectors on a cluster."
        ),
    ] = "0",
    tensorboard: Annotated[
        bool,
        typer.Option(
            "--tensorboard", help="Also write TensorBoard event files into the run folder."
        ),
    ] = False,
    view: Annotated[
        bool,
        typer.Option(
            "--view", help="Watch in rerun: losses, held-out figures, the latest evaluation."
        ),
    ] = False,
) -> None:
    """Learn to reach with DiGrad; every live and every evaluation episode is recorded.

    Examples:

        coordlog train --from logs/table --updates 10000

        coordlog train --scene table

        coordlog train --scene free --steps 600000 --preset paper

        coordlog train --from logs/spheres --live --steps 100000 --set behaviour.final=1.0

        coordlog train --from logs/spheres --set reward.n1=3.0

        coordlog train --from s3://robots/logs --memory 500MB --updates 100000

        coordlog train --scene free --collectors 4 --jobs ray

        coordlog train --from logs/table --out runs/table-logs-s0 --resume
    """
    from coordlog.commands.training import (
        EVALUATION_ENVS,
        RANK,
        Judge,
        Progress,
        assemble,
        collectors_of,
        evaluation_envs,
        practising,
        record_training,
        require_window,
        tell_doubts,
        watch,
    )
    from coordlog.config import read_toml
    from coordlog.sim.making import true_scene
    from coordlog.tasks.own import scene_of
    from coordlog.tasks.scene import find
    from coordlog.train.bind import require_alike
    from coordlog.train.collectors import shares
    from coordlog.train.events import EventFiles, require_tensorboard
    from coordlog.train.run import held
    from coordlog.train.settings import surroundings
    from coordlog.train.task import Hooks

    given = {
        "loop.seed": seed,
        "loop.updates": updates,
        "loop.steps": steps,
        "loop.evaluate_every": eval_every,
        "replay.hindsight": hindsight,
        "replay.log_hindsight": hindsight,
    }
    tables = read_toml(config) if config else {}
    around, assigned = _around(tables, settings or [])
    # Live steps alone are a budget: without a word about updates, they are as many as the steps earn.
    earned = (
        ["loop.updates=0"]
        if steps and updates is None and "updates" not in tables.get("loop", {})
        else []
    )
    if not preset:
        preset = _preset(out if resume else None, scene, live=not source)
        if preset == "default" and not source and steps is None and not tables.get("loop"):
            given |= {"loop.steps": STEPS, "loop.updates": updates or 0}
    wanted = _settings(tables, preset=preset, given=given, assignments=[*earned, *assigned])
    logs, room = None, size_of(memory) if memory else 0
    readers: int | str = int(jobs) if jobs.isdecimal() else 0 if collectors else workers(jobs)
    if source and room:
        logs = listed(source, where=where, skip_broken=skip_broken, jobs=readers)
    elif source:
        logs = load_logs(source, where=where, skip_broken=skip_broken, jobs=readers, verify=verify)
    elif room:
        raise ConfigError("--memory: expected logs to stream, --from, got none")
    mode = ("both" if live else "logs") if logs else "live"
    if collectors and (mode == "logs" or collectors > envs):
        got = f"{collectors} for {envs if mode != 'logs' else 'no'} live simulations"
        raise ConfigError(f"--collectors: expected at most one for each live simulation, got {got}")
    if mode != "logs" and wanted.loop.steps == 0:
        raise ConfigError("--steps: expected a budget of live steps, got none")
    asked = scene
    place = (
        scene_of(scene)
        if scene
        else find(logs.episodes.column("scene")[0].as_py() if logs else "table")
    )
    scene = place.name
    folder = out or Path("runs") / f"{scene}-{mode}-s{seed}"
    like = true_scene(logs.env(0)) if logs else surroundings(preset)
    judged = evaluation_envs(
        place, around, like, start=start, envs=min(EVALUATION_ENVS, eval_episodes)
    )
    stream = stream_of(logs, memory=room, jobs=readers, seed=seed) if logs and room else None
    said = _said(scene, mode, judged[""], wanted, logs, envs=envs, where=where) | {
        "preset": preset,
        "start": start,
    }
    layout = judged[""].layout
    said |= {"window": stream.about((layout.n_x, layout.n_u, layout.k))} if stream else {}
    said |= {"collectors": collectors} if collectors else {}
    if logs:
        require_alike(logs.env(0), said["env"], where=f"scene '{scene}'")
    if mode != "logs" and "reward" in around:
        tell_doubts(judged[""], wanted)
    if view:
        require_window()
    if tensorboard:
        require_tensorboard()
    run = _named(folder, said, wanted, resume=resume)
    if logs and like["reward"] != said["env"]["reward"]:
        terminal.note(
            "rewards are recomputed from logged distances and flags: the logs were recorded with other constants"
        )
    with ExitStack() as stack:
        stack.enter_context(held(folder))
        interrupted = stack.enter_context(terminal.interruptible())
        window = stack.enter_context(watch(folder.name)) if view else None
        events = stack.enter_context(EventFiles(folder / "tensorboard")) if tensorboard else None
        show = Progress(
            stack.enter_context(terminal.progress()), scene, wanted, window=window, events=events
        )
        judge = Judge(judged, folder, run=run, episodes=eval_episodes, window=window)
        recorder = None
        if collectors:
            recorder = stack.enter_context(
                collectors_of(
                    asked or scene,
                    around,
                    like,
                    wanted,
                    start=start,
                    folder=folder,
                    run=run,
                    lanes=shares(envs, collectors),
                    jobs=jobs,
                )
            )
        elif mode != "logs":
            simulated = practising(place, around, like, wanted, start=start, envs=envs)
            recorder = stack.enter_context(record_training(simulated, folder, run=run))
        hooks = Hooks(evaluate=judge, rank=RANK, on_row=show, should_stop=lambda: bool(interrupted))
        trainer = assemble(
            folder,
            wanted,
            judged[""],
            stream or logs,
            recorder,
            hooks=hooks,
            said=said,
            device=device,
        )
        if not resume:
            _begin(folder, {**said, "recorder": run}, logs)
        outcome = trainer.run(resume=resume and _has_checkpoint(folder))
    again = f" --scene {asked}" if ":" in asked else ""
    _tell(outcome, folder, scene=again, skipped=len(logs.skipped) if logs else 0)


def _preset(resumed: Path | None, scene: str, *, live: bool) -> str:
    """The preset of a run that names none: that of the run it goes on with, or what was measured to
    learn best.

    From live steps alone, `live` goes around fixed obstacles, where `default` learns nothing; where
    there are none, `default` learns in a third of the steps.
    """
    from coordlog.tasks.own import scene_of
    from coordlog.train import run as runs

    if resumed is not None:
        return str(runs.recall(resumed).get("preset", "default"))
    return "live" if live and scene_of(scene or "table").panels else "default"


def _around(
    tables: dict[str, Any], assignments: list[str]
) -> tuple[dict[str, dict[str, Any]], list[str]]:
    """The tables [env] and [reward], taken out of the file's, as --set changes them.

    And the assignments that are not about these.
    """
    from coordlog.config import parse_assignment
    from coordlog.sim.making import TABLES

    around, rest = {name: dict(tables.pop(name)) for name in TABLES if name in tables}, []
    for text in assignments:
        section, key, value = parse_assignment(text)
        if section in TABLES:
            around.setdefault(section, {})[key] = value
        else:
            rest.append(text)
    return around, rest


def _settings(
    tables: Mapping[str, Any], *, preset: str, given: Mapping[str, Any], assignments: list[str]
) -> Settings:
    """Preset, then file, then --set, then the options that have names of their own."""
    from coordlog.train.settings import load_settings

    own = [f"{key}={value}" for key, value in given.items() if value is not None]
    return load_settings(preset=preset, tables=tables, assignments=[*assignments, *own])


def _said(
    scene: str,
    mode: str,
    env: BatchEnv,
    settings: Settings,
    logs: Logs | None,
    *,
    envs: int,
    where: str,
) -> Json:
    """What the run is about, for run.json and for every policy file."""
    digests = logs.episodes.column("digest").to_pylist() if logs else []
    data = hashlib.sha256("".join(digests).encode()).hexdigest() if digests else ""
    return {
        "scene": scene,
        "mode": mode,
        "env": env.describe(),
        "settings": settings.asdict(),
        "seed": settings.loop.seed,
        "envs": envs if mode != "logs" else 0,
        "where": where,
        "data": data,
        "log_episodes": len(digests),
    }


def _named(folder: Path, said: Json, settings: Settings, *, resume: bool) -> str:
    """The name that the run's recordings carry.

    Nothing is written before all parts of the run are known to fit.
    """
    from coordlog.train import run as runs
    from coordlog.train.settings import refuse_changes

    if not resume:
        runs.require_new(folder)
        return uuid.uuid4().hex[:8]
    before = runs.recall(folder)
    runs.require_same(before, said, folder=folder)
    refuse_changes(settings, before["settings"])
    if not _has_checkpoint(folder):
        terminal.note(f"{folder}: stopped before its first checkpoint; it begins again")
    return str(before["recorder"])


def _begin(folder: Path, said: Json, logs: Logs | None) -> None:
    from coordlog.train import run as runs

    data = (
        zip(
            logs.episodes.column("digest").to_pylist(),
            logs.episodes.column("file").to_pylist(),
            strict=True,
        )
        if logs
        else []
    )
    runs.begin(folder, said, data=list(data))


def _has_checkpoint(folder: Path) -> bool:
    return (folder / "checkpoint.safetensors").exists()


def _tell(outcome: Outcome, folder: Path, *, scene: str, skipped: int) -> None:
    """How the run ended, what it achieved, and the exit code."""
    best = outcome.best or {}
    merit = (
        f"; best: clean {best['clean']:.1%}, success {best['success']:.1%}, score {best['score']:.2f}"
        if best
        else ""
    )
    terminal.say(
        f"{folder}: {outcome.ending} after {outcome.updates:,} updates and {outcome.steps:,} live steps{merit}"
    )
    if outcome.event is not None:
        terminal.note(f"{outcome.event.name}: {outcome.event.advice}")
        raise typer.Exit(EXIT_CHECK_FAILED)
    if outcome.ending == "stopped":
        terminal.note(f"stopped and saved; go on with: coordlog train … --out {folder} --resume")
        raise typer.Exit(EXIT_INTERRUPTED)
    if best:
        terminal.say(f"coordlog record --policy {folder}{scene} --split test --episodes 200")
    if skipped:
        raise typer.Exit(EXIT_PARTIAL)
