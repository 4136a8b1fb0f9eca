"""coordlog record --env: episodes of an environment that is not ours."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from coordlog.commands import terminal
from coordlog.errors import EXIT_INTERRUPTED, ConfigError, CoordlogError

if TYPE_CHECKING:
    from coordlog.record.foreign import Recorder

OWN = ("expert", "still", "pretrained")
"""Policies of coordlog's own scenes."""


def record_environment(
    name: str, policy: str, *, episodes: int, seed: int, out: Path, as_json: bool
) -> None:
    """Record a Gymnasium environment by its id.

    Raises:
        ConfigError: if there is no such environment, or it is not on MuJoCo.
        SimulationError: at the first step that cannot be replayed.
    """
    from coordlog.api.recording import actor
    from coordlog.catalog.asking import catalogued
    from coordlog.record.foreign import Recorder, played
    from coordlog.record.foreign_env import make

    if policy in OWN:
        raise ConfigError(
            f"--policy {policy}: acts in coordlog's scenes alone, from joint angles and goals that "
            f"{name} does not say; "
            "expected random, FILE.py:NAME, a model of stable-baselines3 (.zip) or the run folder "
            "of `coordlog train` on its logs with --env"
        )
    env = make(name)
    act, about = actor(env, policy, seed=seed, monitor=terminal.Watcher())
    began = time.perf_counter()
    with terminal.progress() as bar, terminal.interruptible() as interrupted:
        task = bar.add_task(f"recording {name}", total=episodes, note="")
        try:
            with Recorder(env, out, policy=about) as recorder:
                for _ in played(recorder, env, act, range(seed, seed + episodes)):
                    bar.update(task, completed=len(recorder.files))
                    if interrupted:
                        raise typer.Exit(EXIT_INTERRUPTED)
        except (CoordlogError, OSError, typer.Exit):
            raise
        except Exception as error:  # environment and policy are the user's
            raise ConfigError(
                f"--env {name} with the policy {policy or 'random'}: {type(error).__name__}: "
                f"{error}"
            ) from error
    catalogued(out, recorder.files)
    _show(recorder, out, seconds=time.perf_counter() - began, as_json=as_json)


def _show(recorder: Recorder, out: Path, *, seconds: float, as_json: bool) -> None:
    """What was recorded, for people or as JSON."""
    episodes, steps, outside = len(recorder.files), recorder.steps, recorder.set_from_outside
    if as_json:
        counted = {"run": recorder.run, "episodes": episodes, "steps": steps}
        counted |= {"set_from_outside": outside, "seconds": seconds}
        terminal.print_json(counted | {"files": [str(path) for path in recorder.files]})
        return
    said = f"{outside} of them set the state from outside; logged as such"
    terminal.facts(
        [
            ("episodes", f"{episodes} in {out}/ (run {recorder.run})"),
            ("steps", f"{steps}, each simulated again to the bit; {said}"),
            ("speed", f"{steps / seconds:,.0f} steps/s"),
        ]
    )
