"""The parts of a training run where rooms meet: live simulations that are recorded, evaluations
that are recorded, progress.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.progress import Progress as Bar

from coordlog.commands.environment import make_env
from coordlog.policies.learned import Policy
from coordlog.record.cache import Logs
from coordlog.record.dataset import SUFFIX
from coordlog.record.reader import read_attachments, read_episode
from coordlog.record.recorder import Recorder
from coordlog.sim.scoring import evaluate, figures
from coordlog.train.bind import FARTHEST, task_of
from coordlog.train.events import EventFiles
from coordlog.train.live import Simulations
from coordlog.train.logs import Columns
from coordlog.train.loop import Trainer
from coordlog.train.metrics import Row
from coordlog.train.settings import Settings
from coordlog.train.task import Hooks

if TYPE_CHECKING:
    from coordlog.episode import Json
    from coordlog.sim.env import BatchEnv
    from coordlog.tasks.scene import Scene
    from coordlog.view.live import Live

SEED = 0
"""Evaluations are on the problems of this seed and the split "test", which no training sees."""
EVALUATION_ENVS = 32


def record_training(env: BatchEnv, folder: Path, *, run: str) -> Recorder:
    """The live environment, recorded into the run folder."""
    policy = {
        "kind": "digrad",
        "name": "learner",
        "checkpoint_sha256": "",
        "noise": {"kind": "gaussian", "schedule": "noise in run.json"},
    }
    return Recorder(env, folder / "episodes" / "train", policy=policy, display=False, run=run)


class Judge:
    """Evaluates a policy on held-out problems; the episodes are recorded like any other."""

    def __init__(
        self,
        scene: Scene | str,
        tables: Mapping[str, Any],
        like: Json | None,
        folder: Path,
        *,
        run: str,
        episodes: int,
        window: Live | None = None,
    ) -> None:
        self._run, self._window = run, window
        self._env = make_env(
            scene,
            tables,
            start="stand",
            envs=min(EVALUATION_ENVS, episodes),
            threads=0,
            like=like,
            doubts=False,
        )
        self._folder, self._episodes = folder, episodes

    def __call__(self, policy: Policy, updates: int) -> dict[str, float]:
        """Figures of merit after so many updates; see `scoring.figures`.

        What a killed run had recorded of them is not recorded twice.
        """
        said = {"kind": "digrad", "name": f"update {updates}", "checkpoint_sha256": "", "noise": {}}
        folder = self._folder / "episodes" / f"eval-{updates:07d}"
        weights = b"".join(policy.arrays[name].tobytes() for name in sorted(policy.arrays))
        run = hashlib.sha256(f"{self._run}/{updates}/".encode() + weights).hexdigest()[:8]
        with Recorder(self._env, folder, policy=said, display=False, run=run) as recorder:
            scores = evaluate(
                recorder, policy, episodes=self._episodes, k=self._env.layout.k, seed=SEED
            )
        if self._window is not None:
            from coordlog.view.show import Show

            paths = sorted(folder.glob(f"*{SUFFIX}"))
            self._window.evaluation(
                updates,
                [Show(path.stem, read_episode(path), read_attachments(path)) for path in paths],
            )
        return figures(scores)


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
            self._note["held-out"] = (
                f"clean {float(row['clean'] or 0):.0%} score {float(row['score'] or 0):.2f}"
            )
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
        panels = {"held-out": ("success", "clean", "collisions", "falls"), "score": ("score",)}
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


def assemble(
    folder: Path,
    settings: Settings,
    env: BatchEnv,
    logs: Logs | None,
    recorder: Recorder | None,
    *,
    hooks: Hooks,
    said: Json,
    device: str,
) -> Trainer:
    """The trainer of a run.

    Args:
        folder: The run folder.
        settings: All constants.
        env: What the task is, and where live steps are taken.
        logs: Logged episodes, or None.
        recorder: `env`, recorded, if there are live steps.
        hooks: Evaluation, progress, stop.
        said: What every policy file carries.
        device: Where the networks live.
    """
    task = task_of(env.describe(), reward=env.task.reward)
    columns = None if logs is None else Columns.from_tables(logs.steps, logs.episodes)
    reach = env.scene.robot.reach
    source = (
        None
        if recorder is None
        else Simulations(
            recorder, seed=settings.loop.seed, k=env.layout.k, farthest=FARTHEST * reach
        )
    )
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
