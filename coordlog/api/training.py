"""Training runs: logs and live simulations to a run folder, every episode of it recorded."""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from coordlog.api.environments import BY_RETURN, Performance, learnt_from, performance
from coordlog.api.following import Follower, watch
from coordlog.api.judging import ELSEWHERE, ENVS, RANK, SEED, Judge, evaluation_envs
from coordlog.api.logs import load_logs
from coordlog.api.practice import Practice, collector, record_training
from coordlog.api.streams import listed, stream_of
from coordlog.api.train_plan import Constants, TrainPlan, constants
from coordlog.catalog.asking import catalogued
from coordlog.crew import Crew
from coordlog.monitor import Monitor
from coordlog.record.files import find_files
from coordlog.record.places import require_folder
from coordlog.sim.foreign import of_environment
from coordlog.sim.making import true_scene
from coordlog.tasks.own import scene_of
from coordlog.tasks.scene import Scene, find
from coordlog.train import run as runs
from coordlog.train.bind import learning_task, require_alike
from coordlog.train.collectors import Collectors, shares
from coordlog.train.columns import Columns
from coordlog.train.events import EventFiles, require_tensorboard
from coordlog.train.loop import Trainer
from coordlog.train.settings import refuse_changes, surroundings
from coordlog.train.stream import Stream
from coordlog.train.task import Hooks, LiveSource, Outcome, Task

if TYPE_CHECKING:
    from coordlog.episode import Json
    from coordlog.record.cache import Logs
    from coordlog.sim.env import BatchEnv
    from coordlog.view.live import Live

DOUBTED = 32
"""Problems whose palms' distance from their goals is what standing still is taken to cost."""


class Trained(NamedTuple):
    """How a run ended."""

    folder: Path
    outcome: Outcome
    skipped: int
    """Broken logs that were left out."""


class Run(NamedTuple):
    """A run whose parts are known to fit; nothing of it is written yet."""

    plan: TrainPlan
    scene: Scene | None
    """None for an environment that is not ours."""
    task: Task
    data: Columns | Stream | None
    """What is learnt from, besides live steps."""
    folder: Path
    constants: Constants
    logs: Logs | None
    like: Json
    """The `coordlog.env` record whose constants hold where the tables say nothing."""
    judged: dict[str, BatchEnv]
    """What it is judged in, as `evaluation_envs` makes them."""
    about: Json
    """What the run is about, for run.json and for every policy file."""
    name: str
    """What its recordings carry."""


def train(plan: TrainPlan, monitor: Monitor) -> Trained:
    """Train, from the beginning or from where the run stopped.

    Raises:
        ConfigError: for an unknown name, a value out of range, or a run resumed as another one.
        SpecError: for logs that do not belong together, or to the scene.
        StorageError: if the folder holds another run, or cannot be written.
    """
    run = prepare(plan, monitor)
    settings, folder = run.constants.settings, run.folder
    with ExitStack() as stack:
        stack.enter_context(runs.held(folder))
        window = stack.enter_context(watch(folder.name)) if plan.view else None
        events = EventFiles(folder / "tensorboard") if plan.tensorboard else None
        if events is not None:
            stack.enter_context(events)
        loop = settings.loop
        by_steps = loop.updates == 0
        bar = monitor.progress(
            f"training {run.about['scene']}", loop.steps if by_steps else loop.updates
        )
        follower = Follower(
            stack.enter_context(bar), by_steps=by_steps, window=window, events=events
        )
        judge, rank = stack.enter_context(_judge(run, monitor, window))
        source: LiveSource | None = None
        if plan.collectors:
            crew = Crew(partial(collector, practice_of(run)), plan.collectors, jobs=plan.jobs)
            each = shares(plan.envs, plan.collectors)
            source = Collectors(stack.enter_context(crew), each, k=run.judged[""].layout.k)
        elif plan.mode != "logs":
            practice = practice_of(run)
            recorder = record_training(practice.env(plan.envs), folder, run=run.name)
            source = practice.simulations(stack.enter_context(recorder))
        hooks = Hooks(
            evaluate=judge, rank=rank, on_row=follower, should_stop=lambda: monitor.stopped
        )
        trainer = trainer_of(run, source, hooks)
        if not plan.resume:
            _begin(run)
        outcome = trainer.run(resume=plan.resume and _has_checkpoint(folder))
    recorded = folder / "episodes"
    catalogued(recorded, find_files(recorded).paths if recorded.is_dir() else ())
    return Trained(folder, outcome, len(run.logs.skipped) if run.logs else 0)


def prepare(plan: TrainPlan, monitor: Monitor) -> Run:
    """Find out whether all parts of a run fit, before anything is written; errors as of `train`."""
    if plan.out is not None:
        require_folder(plan.out)
    wanted = constants(plan)
    if plan.view:
        from coordlog.view.viewer import require_display

        require_display()
    if plan.tensorboard:
        require_tensorboard()
    logs = _logs(plan, monitor) if plan.source else None
    if logs and of_environment(logs.env(0)):
        return _of_environment(plan, logs, monitor)
    if isinstance(plan.scene, Scene):
        scene = plan.scene
    elif plan.scene:
        scene = scene_of(plan.scene)
    else:
        scene = find(logs.episodes.column("scene")[0].as_py() if logs else "table")
    like = true_scene(logs.env(0)) if logs else surroundings(wanted.preset)
    envs = min(ENVS, plan.eval_episodes)
    judged = evaluation_envs(scene, wanted.tables, like, start=plan.start, envs=envs)
    env = judged[""]
    about = _about(plan, scene.name, env.describe(), wanted, logs)
    stream = None
    if logs and plan.window:
        seed = wanted.settings.loop.seed
        stream = stream_of(logs, memory=plan.window, jobs=plan.readers, seed=seed)
        about["window"] = stream.about((env.layout.n_x, env.layout.n_u, env.layout.k))
    if plan.collectors:
        about["collectors"] = plan.collectors
    if logs:
        require_alike(logs.env(0), about["env"], where=f"scene '{scene.name}'")
    if plan.mode != "logs" and "reward" in wanted.tables:
        _tell_doubts(env, wanted.settings.learner.gamma, monitor)
    folder = _folder(plan, scene.name)
    name = _name(plan, folder, about, wanted, monitor)
    if logs and like["reward"] != about["env"]["reward"]:
        monitor.note(
            "rewards are recomputed from logged distances and flags: "
            "the logs were recorded with other constants"
        )
    task = learning_task(about["env"], reward=env.task.reward)
    data: Columns | Stream | None = stream
    if logs and not stream:
        data = Columns.from_tables(logs.steps, logs.episodes)
    return Run(plan, scene, task, data, folder, wanted, logs, like, judged, about, name)


def _of_environment(plan: TrainPlan, logs: Logs, monitor: Monitor) -> Run:
    """A run on the logs of an environment that is not ours."""
    env, task, columns, wanted = learnt_from(plan, logs)
    scene = logs.episodes.column("scene")[0].as_py()
    about = _about(plan, scene, env, wanted, logs)
    folder = _folder(plan, scene)
    name = _name(plan, folder, about, wanted, monitor)
    return Run(plan, None, task, columns, folder, wanted, logs, env, {}, about, name)


def _folder(plan: TrainPlan, scene: str) -> Path:
    return Path(plan.out or f"runs/{scene}-{plan.mode}-s{plan.seed}")


@contextmanager
def _judge(
    run: Run, monitor: Monitor, window: Live | None
) -> Iterator[tuple[Judge | Performance | None, tuple[str, ...]]]:
    """Who judges a run, and the figures by which."""
    plan, folder = run.plan, run.folder
    if run.scene is None:
        made = performance(plan, run.about["env"], folder, run.name, monitor, window)
        with made as found:
            yield found, BY_RETURN
        return
    count = plan.eval_episodes
    elsewhere = max(1, count // ELSEWHERE) if plan.mode == "logs" else count
    judge = Judge(
        run.judged, folder, run=run.name, episodes=count, elsewhere=elsewhere, window=window
    )
    yield judge, RANK


def _logs(plan: TrainPlan, monitor: Monitor) -> Logs:
    """What is learnt from: columns, or with a window the list of what will stream through it."""
    paths = [Path(each) for each in plan.source or ()]
    chosen: dict[str, Any] = {
        "where": plan.where,
        "skip_broken": plan.skip_broken,
        "jobs": plan.readers,
        "monitor": monitor,
    }
    if plan.window:
        return listed(paths, **chosen)
    return load_logs(paths, verify=plan.verify, environments=True, **chosen)


def _about(plan: TrainPlan, scene: str, env: Json, wanted: Constants, logs: Logs | None) -> Json:
    digests = logs.episodes.column("digest").to_pylist() if logs else []
    return {
        "scene": scene,
        "mode": plan.mode,
        "env": env,
        "settings": wanted.settings.asdict(),
        "seed": wanted.settings.loop.seed,
        "envs": plan.envs if plan.mode != "logs" else 0,
        "where": plan.where,
        "data": hashlib.sha256("".join(digests).encode()).hexdigest() if digests else "",
        "log_episodes": len(digests),
        "preset": wanted.preset,
        "start": plan.start,
    }


def _tell_doubts(env: BatchEnv, gamma: float, monitor: Monitor) -> None:
    """Say which reward constants might teach the wrong thing at this run's discount, from where its
    episodes begin.
    """
    problems = [env.problem(seed=SEED, split="train", index=index) for index in range(DOUBTED)]
    standing = [
        np.linalg.norm(problem.goals - env.draw.reach.palms(problem.angles), axis=1).mean()
        for problem in problems
    ]
    for doubt in env.task.reward.doubts(
        gamma=gamma, steps=env.task.config.max_steps, farthest=float(np.mean(standing))
    ):
        monitor.note(doubt)


def _name(plan: TrainPlan, folder: Path, about: Json, wanted: Constants, monitor: Monitor) -> str:
    """The name that the run's recordings carry: a new one, or that of the run that goes on."""
    if not plan.resume:
        runs.require_new(folder)
        return uuid.uuid4().hex[:8]
    before = runs.recall(folder)
    runs.require_same(before, about, folder=folder)
    refuse_changes(wanted.settings, before["settings"])
    if not _has_checkpoint(folder):
        monitor.note(f"{folder}: stopped before its first checkpoint; it begins again")
    return str(before["recorder"])


def practice_of(run: Run) -> Practice:
    """What the live steps of a run are taken in."""
    plan, tables = run.plan, run.constants.tables
    assert run.scene is not None  # others have no live steps
    easier = {**asdict(run.constants.settings.train), **tables.get("env", {})}
    return Practice(
        run.scene,
        {**tables, "env": easier},
        plan.start,
        tuple(shares(plan.envs, plan.collectors or 1)),
        run.like,
        run.folder.resolve(),
        run.name,
        run.constants.settings.loop.seed,
        run.judged[""].layout.k,
    )


def trainer_of(run: Run, source: LiveSource | None, hooks: Hooks) -> Trainer:
    """The trainer of a run.

    Args:
        run: All that it needs.
        source: Of live steps; None if there are none.
        hooks: Evaluation, progress, stop.
    """
    kept = ("scene", "mode", "env", "seed", "data", "log_episodes", "where")
    about = {key: run.about[key] for key in kept}
    return Trainer(
        run.task,
        run.constants.settings,
        folder=run.folder,
        logs=run.data,
        source=source,
        hooks=replace(hooks, about=about),
        device=run.plan.device,
    )


def _begin(run: Run) -> None:
    data: list[tuple[str, str]] = []
    if run.logs:
        columns = (run.logs.episodes.column(name).to_pylist() for name in ("digest", "file"))
        data = list(zip(*columns, strict=True))
    runs.begin(run.folder, {**run.about, "recorder": run.name}, data=data)


def _has_checkpoint(folder: Path) -> bool:
    return (folder / "checkpoint.safetensors").exists()
