"""coordlog train: DiGrad from logs, from live simulations, or from both."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from coordlog.commands import terminal
from coordlog.commands.options import chosen, flag
from coordlog.errors import EXIT_CHECK_FAILED, EXIT_INTERRUPTED, EXIT_PARTIAL

if TYPE_CHECKING:
    from coordlog.api.training import Trained

Source = Annotated[
    list[Path] | None,
    typer.Option("--from", help="Folders of logs to learn from; may be repeated."),
]
Live = Annotated[
    bool, typer.Option(help="Simulate as well, if there are logs; without --from it always does.")
]
Scene = Annotated[
    str, typer.Option(help="Scene to simulate, or FILE.py:NAME; by default that of the logs.")
]
Where = Annotated[str, typer.Option(help="Which episodes, in SQL: \"clean and scene = 'table'\".")]
Preset = Annotated[
    str,
    typer.Option(
        help="default, live, agile, quick (logs, in a minute), environment, or paper. Without a "
        "word: environment for logs of another environment; without logs, live where there are "
        "fixed obstacles and agile where they stand elsewhere every time; else default."
    ),
]
Config = Annotated[Path | None, typer.Option(help="TOML file of settings, [env] and [reward].")]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help="One setting, section.key=value, also of [env] and [reward]; may be repeated.",
    ),
]
Updates = Annotated[
    int | None,
    typer.Option(min=0, help="Gradient updates; 0, as with --steps alone: as many as those earn."),
]
Steps = Annotated[
    int | None, typer.Option(min=0, help="Live environment steps; by default the preset's.")
]
Start = Annotated[
    str, typer.Option(help="Start pose of the robot; evaluations begin in stand and home as well.")
]
Hindsight = Annotated[
    float | None,
    typer.Option(help="Share of each batch with goals in hindsight, of logs and live, 0 to 1."),
]
Seed = Annotated[int, typer.Option(min=0, help="Seed of everything random.")]
Envs = Annotated[int, typer.Option(min=1, help="Live simulations at once.")]
EvalEvery = Annotated[
    int | None, typer.Option(min=0, help="Updates between evaluations; 0 for none.")
]
EvalEpisodes = Annotated[int, typer.Option(min=1, help="Held-out episodes per evaluation.")]
Out = Annotated[Path | None, typer.Option(help="Run folder; by default runs/SCENE-SOURCE-sSEED.")]
Resume = Annotated[bool, flag("--resume", "Go on with the run in --out, exactly where it stopped.")]
Device = Annotated[str, typer.Option(help="Where the networks live: cpu, cuda.")]
SkipBroken = Annotated[bool, flag("--skip-broken", "Leave out broken files instead of stopping.")]
Verify = Annotated[bool, flag("--verify", "Read every log again, also those that did not change.")]
Memory = Annotated[
    str,
    typer.Option(
        help="Let logs stream through a window of so many bytes, such as 500MB, "
        "instead of holding all of them."
    ),
]
Crew = Annotated[
    int,
    typer.Option(
        min=0,
        help="Collectors that share --envs among them and feed one learner; "
        "processes of a cluster with --jobs ray.",
    ),
]
Decoders = Annotated[
    str,
    typer.Option(
        help="Processes that read logs, 0 for one per core; ray or ray://HOST:PORT for "
        "--collectors on a cluster."
    ),
]
Tensorboard = Annotated[
    bool, flag("--tensorboard", "Also write TensorBoard event files into the run folder.")
]
View = Annotated[
    bool, flag("--view", "Watch in rerun: losses, held-out figures, the latest evaluation.")
]


def train(
    source: Source = None,
    live: Live = False,
    scene: Scene = "",
    where: Where = "",
    preset: Preset = "",
    config: Config = None,
    settings: Settings = None,
    updates: Updates = None,
    steps: Steps = None,
    start: Start = "stand",
    hindsight: Hindsight = None,
    seed: Seed = 0,
    envs: Envs = 32,
    eval_every: EvalEvery = None,
    eval_episodes: EvalEpisodes = 100,
    out: Out = None,
    resume: Resume = False,
    device: Device = "cpu",
    skip_broken: SkipBroken = False,
    verify: Verify = False,
    memory: Memory = "",
    collectors: Crew = 0,
    jobs: Decoders = "0",
    tensorboard: Tensorboard = False,
    view: View = False,
) -> None:
    """Learn to reach with DiGrad; every live and every evaluation episode is recorded. From logs of
    another environment, learn what its rewards ask for.

    Examples:

        coordlog train --from logs/table --updates 10000

        coordlog train --from logs/reacher

        coordlog train --scene table

        coordlog train --scene free --steps 600000 --preset paper

        coordlog train --from logs/spheres --live --steps 100000 --set behaviour.final=1.0

        coordlog train --from logs/spheres --set reward.n1=3.0

        coordlog train --from s3://robots/logs --memory 500MB --updates 100000

        coordlog train --scene free --collectors 4 --jobs ray

        coordlog train --from logs/table --out runs/table-logs-s0 --resume
    """
    from coordlog.api import train_plan, training

    plan = chosen(train_plan.TrainPlan, locals())
    with terminal.interruptible() as monitor:
        trained = training.train(plan, monitor)
    _tell(trained, scene=f" --scene {scene}" if ":" in scene else "")


def _tell(trained: Trained, *, scene: str) -> None:
    """How the run ended, what it achieved, and the exit code."""
    folder, outcome, skipped = trained
    best = outcome.best or {}
    merit = ""
    if "clean" in best:
        rates = f"clean {best['clean']:.1%}, success {best['success']:.1%}"
        merit = f"; best: {rates}, score {best['score']:.2f}"
    elif best:
        said = f"return {best['return']:.2f} ± {best['return_deviation']:.2f}"
        merit = f"; best: {said} of {best['episodes']:.0f} episodes"
    spent = f"{outcome.updates:,} updates and {outcome.steps:,} live steps"
    terminal.say(f"{folder}: {outcome.ending} after {spent}{merit}")
    if outcome.event is not None:
        terminal.note(f"{outcome.event.name}: {outcome.event.advice}")
        raise typer.Exit(EXIT_CHECK_FAILED)
    if outcome.ending == "stopped":
        terminal.note(f"stopped and saved; go on with: coordlog train … --out {folder} --resume")
        raise typer.Exit(EXIT_INTERRUPTED)
    if "clean" in best:
        terminal.say(f"coordlog record --policy {folder}{scene} --split test --episodes 200")
    if skipped:
        raise typer.Exit(EXIT_PARTIAL)
