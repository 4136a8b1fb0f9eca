"""coordlog record --env: episodes of an environment that is not ours."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
    from coordlog.catalog.asking import catalogued
    from coordlog.policies.foreign import load
    from coordlog.record.foreign import record_env
    from coordlog.record.foreign_env import make

    if policy in OWN:
        raise ConfigError(
            f"--policy {policy}: acts in coordlog's scenes alone, from joint angles and goals that "
            f"{name} does not say; "
            "expected random, FILE.py:NAME, a model of stable-baselines3 (.zip) or the run folder "
            "of `coordlog train` on its logs with --env"
        )
    env = make(name)
    if policy == "random":
        env.action_space.seed(seed)
        act = lambda observation: env.action_space.sample()  # noqa: E731
        about: dict[str, Any] = {"kind": "random", "name": "random"}
    else:
        act, about = load(policy)
    began = time.perf_counter()
    with terminal.progress() as bar, terminal.interruptible() as interrupted:
        task = bar.add_task(f"recording {name}", total=episodes, note="")

        def each(recorder: Recorder) -> None:
            bar.update(task, completed=len(recorder.files))
            if interrupted:
                raise typer.Exit(EXIT_INTERRUPTED)

        try:
            recorder = record_env(
                env, act, episodes=episodes, out=out, seed=seed, about=about, each=each
            )
        except (CoordlogError, OSError, typer.Exit):
            raise
        except Exception as error:  # environment and policy are the user's
            raise ConfigError(
                f"--env {name} with the policy {policy or 'random'}: {type(error).__name__}: "
                f"{error}"
            ) from error
    seconds = time.perf_counter() - began
    catalogued(out, recorder.files)
    summary = {
        "run": recorder.run,
        "episodes": len(recorder.files),
        "steps": recorder.steps,
        "set_from_outside": recorder.set_from_outside,
        "seconds": seconds,
        "files": [str(path) for path in recorder.files],
    }
    if as_json:
        terminal.print_json(summary)
        return
    said = f"{summary['set_from_outside']} of them set the state from outside; logged as such"
    terminal.facts(
        [
            ("episodes", f"{summary['episodes']} in {out}/ (run {recorder.run})"),
            ("steps", f"{recorder.steps}, each simulated again to the bit; {said}"),
            ("speed", f"{recorder.steps / seconds:,.0f} steps/s"),
        ]
    )
