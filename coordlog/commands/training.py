"""The parts of a training run where rooms meet: live simulations that are recorded, evaluations
that are recorded, progress.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.progress import Progress as Bar

from coordlog.commands.terminal import note
from coordlog.crew import Crew
from coordlog.policies.learned import Policy
from coordlog.record.cache import Logs
from coordlog.record.dataset import SUFFIX
from coordlog.record.reader import read_attachments, read_episode
from coordlog.record.recorder import Recorder
from coordlog.sim.making import make_env
from coordlog.sim.scoring import Scoreboard, figures, judged
from coordlog.tasks.own import scene_of
from coordlog.train.bind import FARTHEST, task_of
from coordlog.train.collectors import Collector, Collectors, shares
from coordlog.train.columns import Columns
from coordlog.train.events import EventFiles
from coordlog.train.live import Simulations
from coordlog.train.loop import Trainer
from coordlog.train.metrics import Row
from coordlog.train.settings import Settings
from coordlog.train.stream import Stream
from coordlog.train.task import Hooks, LiveSource

if TYPE_CHECKING:
    from coordlog.episode import Json
    from coordlog.sim.env import BatchEnv
    from coordlog.tasks.scene import Scene
    from coordlog.view.live import Live

SEED = 0
"""Evaluations are on the problems of this seed and the split "test", which no training sees."""
EVALUATION_ENVS = 32
DOUBTED = 32
"""Problems whose palms' distance from their goals is what standing still is taken to cost."""
RANK = ("clean", "overall", "score")
"""The best policy is the cleanest from the start pose asked for.

Among equals the one cleanest from all.
"""
STARTS = ("stand", "home")
"""Poses that evaluations begin in, as far as the robot has them."""


def record_training(env: BatchEnv, folder: Path, *, run: str) -> Recorder:
    """The live environment, recorded into the run folder."""
    policy = {
        "kind": "digrad",
        "name": "learner",
        "checkpoint_sha256": "",
        "noise": {"kind": "gaussian", "schedule": "noise in run.json"},
    }
    return Recorder(env, folder / "episodes" / "train", policy=policy, display=False, run=run)


def evaluation_envs(
    scene: Scene | str, tables: Mapping[str, Any], like: Json | None, *, start: str, envs: int
) -> dict[str, BatchEnv]:
    """The true scene from every start pose that is judged, by the prefix of its figures: none for
    `start`, "home_" for home.

    Args:
        scene: What to judge in, or the name of a scene that ships.
        tables: Tables "env" and "reward" of constants.
        like: A `coordlog.env` record whose constants hold where the tables say nothing.
        start: The first pose; the robot's others in STARTS follow.
        envs: Simulations at once.
    """
    make = partial(make_env, scene, tables, envs=envs, threads=0, like=like)
    first = make(start=start)
    others = [pose for pose in STARTS if pose != start and pose in first.scene.robot.poses]
    return {"": first, **{f"{pose}_": make(start=pose) for pose in others}}


def practising(
    scene: Scene,
    tables: Mapping[str, Any],
    like: Json,
    settings: Settings,
    *,
    start: str,
    envs: int,
) -> BatchEnv:
    """The environment that live steps are taken in: with what makes training easier (section
    [train]).
    """
    easier = {**tables, "env": {**asdict(settings.train), **tables.get("env", {})}}
    return make_env(
        scene,
        easier,
        start=start,
        envs=envs,
        threads=max(1, (os.cpu_count() or 2) - 1),
        like=like,
    )


def tell_doubts(env: BatchEnv, settings: Settings) -> None:
    """Say which reward constants might teach the wrong thing at this run's discount, from where its
    episodes begin.
    """
    problems = [env.problem(seed=SEED, split="train", index=index) for index in range(DOUBTED)]
    standing = [
        np.linalg.norm(problem.goals - env.draw.reach.palms(problem.angles), axis=1).mean()
        for problem in problems
    ]
    for doubt in env.task.reward.doubts(
        gamma=settings.learner.gamma,
        steps=env.task.config.max_steps,
        farthest=float(np.mean(standing)),
    ):
        note(doubt)


class Judge:
    """Evaluates a policy on held-out problems of the true scene, from several start poses.

    The episodes are recorded like any other.
    """

    def __init__(
        self,
        envs: Mapping[str, BatchEnv],
        folder: Path,
        *,
        run: str,
        episodes: int,
        window: Live | None = None,
    ) -> None:
        """Write nothing yet.

        Args:
            envs: What to judge in, as `evaluation_envs` makes them.
            folder: The run folder.
            run: Name of the run, for its recordings.
            episodes: Problems per start pose.
            window: Where evaluations are shown, if anywhere.
        """
        self._envs, self._run, self._window, self._folder, self._episodes = (
            envs,
            run,
            window,
            folder,
            episodes,
        )

    def __call__(self, policy: Policy, updates: int) -> dict[str, float | str]:
        """Figures of merit after so many updates: those of `scoring.figures` per start pose, and
        "overall", the mean of their clean rates.

        What a killed run had recorded of them is not recorded twice.
        """
        folder = self._folder / "episodes" / f"eval-{updates:07d}"
        boards = {
            prefix: self._judge(
                prefix, policy, updates, folder.with_name(folder.name + suffix(prefix))
            )
            for prefix in self._envs
        }
        found: dict[str, float | str] = {}
        for prefix, board in boards.items():
            found |= {prefix + name: value for name, value in figures(board.scores).items()}
        found["overall"] = sum(float(found[f"{prefix}clean"]) for prefix in boards) / len(boards)
        touches = boards[""].touches.most_common(1)
        model = self._envs[""].task.model
        found["touched"] = (
            " and ".join(model.geom(geom).name for geom in touches[0][0]) if touches else ""
        )
        if self._window is not None:
            from coordlog.view.show import Show

            paths = sorted(folder.glob(f"*{SUFFIX}"))
            self._window.evaluation(
                updates,
                [Show(path.stem, read_episode(path), read_attachments(path)) for path in paths],
            )
        return found

    def _judge(self, prefix: str, policy: Policy, updates: int, folder: Path) -> Scoreboard:
        """One evaluation from one start pose, recorded."""
        env = self._envs[prefix]
        said = {"kind": "digrad", "name": f"update {updates}", "checkpoint_sha256": "", "noise": {}}
        weights = b"".join(policy.arrays[name].tobytes() for name in sorted(policy.arrays))
        run = hashlib.sha256(f"{self._run}/{updates}/".encode() + weights).hexdigest()[:8]
        with Recorder(env, folder, policy=said, display=False, run=run) as recorder:
            return judged(recorder, policy, episodes=self._episodes, k=env.layout.k, seed=SEED)


def suffix(prefix: str) -> str:
    """What the folder of an evaluation from another start pose is called after: "home_" →
    "-home".
    """
    return f"-{prefix.rstrip('_')}" if prefix else ""


def require_window() -> None:
    """Refuse to begin what is to be watched where nothing can be shown.

    Raises:
        ViewerError: without a display.
    """
    from coordlog.view.viewer import require_display

    require_display()


@contextmanager
def watch(name: str) -> Iterator[Live]:
    """A viewer's window in which a run is watched."""
    from coordlog.view.live import Live
    from coordlog.view.viewer import Viewer

    with Viewer() as viewer, Live(name, url=viewer.url) as live:
        yield live


class Progress:
    """A bar over the budget, with the latest figures; hands them on to whoever else wants them."""

    def __init__(
        self,
        bar: Bar,
        scene: str,
        settings: Settings,
        *,
        window: Live | None = None,
        events: EventFiles | None = None,
    ) -> None:
        loop, self._window, self._events = settings.loop, window, events
        self._bar, self._by_steps = bar, loop.updates == 0
        self._task = bar.add_task(
            f"training {scene}", total=loop.steps if self._by_steps else loop.updates, note=""
        )
        self._note: dict[str, str] = {}

    def __call__(self, row: Row) -> None:
        """Take in a row of metrics."""
        if row["kind"] == "evaluation":
            rates = "  ".join(
                f"{name} {float(row[name] or 0):.0%}"
                for name in ("clean", "success", "falls", "home_clean")
                if name in row
            )
            touched = f"  touches {row['touched']} first" if row.get("touched") else ""
            self._note["held-out"] = f"{rates.replace('home_clean', 'clean from home')}{touched}"
        elif row["kind"] == "training":
            rate = f"{float(row['updates_per_second'] or 0):.0f} updates/s"
            live = f", {float(row['steps_per_second'] or 0):,.0f} steps/s" if row["step"] else ""
            self._note["speed"] = rate + live
        if self._events is not None:
            self._events(row)
        if self._window is not None:
            self._window.figures(int(row["update"] or 0), curves(row))
        done = row["step"] if self._by_steps else row["update"]
        self._bar.update(
            self._task, completed=float(done or 0), note="  ".join(self._note.values())
        )


def curves(row: Row) -> dict[str, float]:
    """The points of a row of metrics, as "panel/curve"."""
    if row["kind"] == "evaluation":
        panels = {
            "held-out": ("success", "clean", "collisions", "falls", "home_clean"),
            "score": ("score",),
        }
    else:
        panels = {
            "loss": ("critic_loss", "behaviour"),
            "value": tuple(name for name in row if name.startswith(("q_", "value_"))),
        }
    return {
        f"{panel}/{name}": float(row[name] or 0)
        for panel, names in panels.items()
        for name in names
        if name in row
    }


def simulations(
    recorder: Recorder, env: BatchEnv, settings: Settings, *, first: int = 0, stride: int = 1
) -> Simulations:
    """The recorded simulations of a run, or those of one of several collectors."""
    farthest = FARTHEST * env.scene.robot.reach
    k, seed = env.layout.k, settings.loop.seed
    return Simulations(recorder, seed=seed, k=k, farthest=farthest, first=first, stride=stride)


def collectors_of(
    scene: str,
    tables: Mapping[str, Any],
    like: Json,
    settings: Settings,
    *,
    start: str,
    folder: Path,
    run: str,
    lanes: list[int],
    jobs: int | str,
) -> Crew:
    """Collectors of a run, each with its share `lanes` of the simulations; `jobs` says where."""
    make = partial(
        _collector, scene, tables, like, settings, start, folder.resolve(), run, tuple(lanes)
    )
    return Crew(make, len(lanes), jobs=jobs)


def _collector(
    scene: str,
    tables: Mapping[str, Any],
    like: Json,
    settings: Settings,
    start: str,
    folder: Path,
    run: str,
    lanes: tuple[int, ...],
    at: int,
) -> Collector:
    """One of several collectors, in its own process or here."""
    env = practising(scene_of(scene), tables, like, settings, start=start, envs=lanes[at])
    recorder = record_training(env, folder, run=run)
    return Collector(simulations(recorder, env, settings, first=at, stride=len(lanes)), recorder)


def assemble(
    folder: Path,
    settings: Settings,
    env: BatchEnv,
    logs: Logs | Stream | None,
    recorder: Recorder | Crew | None,
    *,
    hooks: Hooks,
    said: Json,
    device: str,
) -> Trainer:
    """The trainer of a run.

    Args:
        folder: The run folder.
        settings: All constants.
        env: What the task is, without what makes training easier.
        logs: Logged episodes, or a stream of them, or None.
        recorder: `env`, recorded, if there are live steps; or collectors that have it.
        hooks: Evaluation, progress, stop.
        said: What every policy file carries.
        device: Where the networks live.
    """
    task = task_of(env.describe(), reward=env.task.reward)
    columns = logs if isinstance(logs, Stream) else None
    if logs is not None and not isinstance(logs, Stream):
        columns = Columns.from_tables(logs.steps, logs.episodes)
    source: LiveSource | None = None
    if isinstance(recorder, Crew):
        source = Collectors(recorder, shares(said["envs"], said["collectors"]), k=env.layout.k)
    elif recorder is not None:
        source = simulations(recorder, env, settings)
    about = {
        key: said[key] for key in ("scene", "mode", "env", "seed", "data", "log_episodes", "where")
    }
    return Trainer(
        task,
        settings,
        folder=folder,
        logs=columns,
        source=source,
        hooks=hooks,
        about=about,
        device=device,
    )
