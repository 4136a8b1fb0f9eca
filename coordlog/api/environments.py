"""Learning from the logs of an environment that is not ours: its rewards as they were logged, and
its episodes, where Gymnasium can make it again, to judge by.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from coordlog.api.judging import run_of, show
from coordlog.api.train_plan import Constants, TrainPlan, constants
from coordlog.errors import ConfigError
from coordlog.policies.foreign import learnt
from coordlog.policies.learned import Policy
from coordlog.record.foreign import Recorder, played
from coordlog.record.foreign_env import make
from coordlog.record.recording import Recording
from coordlog.train.bind import recorded_task
from coordlog.train.columns import Columns
from coordlog.train.settings import PRESETS
from coordlog.train.task import Task

if TYPE_CHECKING:
    from coordlog.episode import Json
    from coordlog.monitor import Monitor
    from coordlog.record.cache import Logs
    from coordlog.view.live import Live

PRESET = "environment"
"""What is learnt with without a word."""
HELD = 1_000_000
"""Seed of the first episode that is judged by; recordings begin at 0."""
BY_RETURN = ("return",)
"""The best policy has the greatest return."""
LARGEST = 10.0
"""Rewards are scaled to returns of about this, if nothing is said."""
SMALLEST = 1e-6
"""Entries of the state that vary less, as a share of their size, are left as they are."""


class Learnt(NamedTuple):
    """What is learnt from and how."""

    env: Json
    """The `coordlog.env` record, and the scales of states and actions
    (`policies.foreign.SCALES`)."""
    task: Task
    columns: Columns
    constants: Constants


def learnt_from(plan: TrainPlan, logs: Logs) -> Learnt:
    """The logs of an environment as what can be learnt from.

    Raises:
        ConfigError: for an option that only scenes of coordlog's have.
        SpecError: if there is no reward in them.
    """
    wanted = constants(replace(plan, preset=plan.preset or PRESET))
    _refuse_options(plan, wanted)
    found = Columns.from_tables(logs.steps, logs.episodes, rewarded=True)
    env = logs.env(0)
    env |= _scales(env, found)
    columns = found.scaled(env)
    task = recorded_task(env, columns)
    learner = wanted.settings.learner
    if learner.reward_scale == PRESETS[wanted.preset].learner.reward_scale:
        most = max(map(abs, task.bounds(learner.gamma)))
        learner = replace(learner, reward_scale=float(f"{LARGEST / most:.3g}"))
    settings = replace(wanted.settings, learner=learner)
    return Learnt(env, task, columns, wanted._replace(settings=settings))


def _refuse_options(plan: TrainPlan, wanted: Constants) -> None:
    """Refuse what there is only in coordlog's scenes."""
    given = {
        "--live": plan.live,
        "--scene": plan.scene,
        "--steps": plan.steps,
        "--collectors": plan.collectors,
        "--memory": plan.window,
        "--start": plan.start != "stand",
        "--hindsight": plan.hindsight,
        "[env], [reward] and [task]": wanted.tables,
    }
    said = [name for name, value in given.items() if value]
    if said:
        raise ConfigError(
            f"{', '.join(said)}: only for coordlog's own scenes; the logs of another environment "
            "are learnt from as they are, all of them held in memory"
        )


def _scales(env: Json, logs: Columns) -> Json:
    """Mean and deviation of each entry of the state, and the range of each action: what the
    environment said, else what was done.
    """
    state, action = logs.steps["state"], logs.steps["action"]
    offset, scale = state.mean(axis=0, dtype=np.float64), state.std(axis=0, dtype=np.float64)
    scale[scale <= SMALLEST * np.maximum(1.0, np.abs(offset))] = 1.0
    low = np.array(env.get("action_low", action.min(axis=0)), np.float64)
    high = np.array(env.get("action_high", action.max(axis=0)), np.float64)
    high = np.where(high > low, high, low + 1.0)  # what never changed need not be learnt
    ends = {"action_low": low, "action_high": high, "state_offset": offset, "state_scale": scale}
    return {name: values.tolist() for name, values in ends.items()}


@contextmanager
def performance(
    plan: TrainPlan, env: Json, folder: Path, run: str, monitor: Monitor, window: Live | None
) -> Iterator[Performance | None]:
    """What a run is judged by; None if nobody can make the environment again, which is said."""
    name = env["task"].get("environment", env["robot"]["name"])
    found = _again(name)
    if found is None:
        monitor.note(
            f"'{name}' is no environment that Gymnasium has here: nothing is evaluated; "
            "coordlog.policies.foreign.load(FOLDER) gives the policy as a function"
        )
        yield None
        return
    try:
        count = plan.eval_episodes
        yield Performance(found, env, folder, run=run, episodes=count, window=window)
    finally:
        found.close()


def _again(name: str) -> Any:
    """The environment of a name in a log, if Gymnasium knows it; nothing is imported for it."""
    try:
        import gymnasium
    except ImportError:
        return None
    known = (item for item in gymnasium.registry if item.replace("/", "_") == name)
    found = next(known, None)
    try:
        return None if found is None else make(found)
    except ConfigError:
        return None


class Performance:
    """Judges a policy by episodes of the environment, which are recorded like any other."""

    def __init__(
        self,
        env: Any,
        said: Json,
        folder: Path,
        *,
        run: str,
        episodes: int,
        window: Live | None,
    ) -> None:
        """Write nothing yet.

        Args:
            env: The environment.
            said: Its `coordlog.env` record.
            folder: The run folder.
            run: Name of the run, for its recordings.
            episodes: How many.
            window: Where evaluations are shown, if anywhere.
        """
        self._env, self._heads, self._folder = env, tuple(said["arms"]), folder
        self._run, self._episodes, self._window = run, episodes, window

    def __call__(self, policy: Policy, updates: int) -> dict[str, float | str]:
        """Mean and deviation of the return over the episodes, and the mean for each head.

        What a killed run had recorded of them is not recorded twice.
        """
        folder = self._folder / "episodes" / f"eval-{updates:07d}"
        name = f"update {updates}"
        about = {"kind": "digrad", "name": name, "checkpoint_sha256": ""}
        run = run_of(self._run, updates, policy)
        seeds = range(HELD, HELD + self._episodes)
        with Recorder(self._env, folder, policy=about, run=run) as recorder:
            for _ in played(recorder, self._env, learnt(policy, name), seeds):
                pass
        returns = np.array([Recording(path).result.returns for path in recorder.files])
        whole = returns.sum(axis=1)
        found: dict[str, float | str] = {
            "episodes": float(len(whole)),
            "return": float(whole.mean()),
            "return_deviation": float(whole.std()),
            "length": recorder.steps / len(whole),
        }
        if len(self._heads) > 1:
            each = zip(self._heads, returns.mean(axis=0).tolist(), strict=True)
            found |= {f"return_{head}": value for head, value in each}
        if self._window is not None:
            show(self._window, updates, folder)
        return found
