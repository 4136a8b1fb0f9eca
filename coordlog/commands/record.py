"""coordlog record: episodes out of MuJoCo."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from coordlog.commands import terminal
from coordlog.commands.options import Shard, chosen, flag, json_flag
from coordlog.errors import EXIT_INTERRUPTED, EXIT_PARTIAL, ConfigError

if TYPE_CHECKING:
    from coordlog.api.recording import RecordPlan
    from coordlog.episode import Json

Scene = Annotated[
    str,
    typer.Option(
        help="free, spheres, table, shelf, planar, hold, or your own, FILE.py:NAME or ROBOT.toml; "
        "by default the policy's, or table."
    ),
]
EnvId = Annotated[
    str,
    typer.Option(
        "--env",
        help="A Gymnasium environment on MuJoCo by its id, such as Reacher-v5, "
        "in place of a scene.",
    ),
]
Policy = Annotated[
    str,
    typer.Option(
        help="expert, random, still, pretrained, or a run folder or policy file, by default "
        "expert; with --env random, FILE.py:NAME, a model of stable-baselines3, or a run on its "
        "logs, by default random."
    ),
]
Count = Annotated[
    int | None, typer.Option(min=1, help="How many; by default 10, or one per branch.")
]
Seed = Annotated[int, typer.Option(min=0, help="Seed of goals, obstacles, start poses and noise.")]
Split = Annotated[str, typer.Option(help="train, or test: problems that training never sees.")]
Noise = Annotated[
    float, typer.Option(min=0, help="Standard deviation of Gaussian noise on the actions; logged.")
]
Correlation = Annotated[
    float, typer.Option(help="Correlation of the noise from step to step, 0 to below 1.")
]
Shield = Annotated[
    bool | None,
    typer.Option(
        help="Slow links down towards near spheres, and arms towards the body; logged. "
        "By default as a shipped policy's card says."
    ),
]
Branch = Annotated[
    list[Path] | None,
    typer.Option(
        help="Folders of logs; each episode begins in one of those, just before it went wrong."
    ),
]
Where = Annotated[str, typer.Option(help='Which of them, in SQL: "not clean".')]
Out = Annotated[
    Path, typer.Option(help="Folder, pack or s3://…; what is already there stays as it is.")
]
Pack = Annotated[bool, flag("--pack", "Write a pack: many episodes in a few large files.")]
Envs = Annotated[
    int, typer.Option(min=1, help="Simulations at once; changes the speed, never the result.")
]
Threads = Annotated[int, typer.Option(min=0, help="Threads to simulate on; 0 for all cores.")]
Config = Annotated[
    Path | None, typer.Option(help="TOML file with tables [env], [reward], [policy], [damper].")
]
Epoch = Annotated[
    int | None,
    typer.Option(min=0, help="Start time [ns since 1970]; equal runs then write equal bytes."),
]
Display = Annotated[
    bool, typer.Option(help="Also write /joint_states and /coordlog/arm/NAME, for viewers.")
]


def record(
    scene: Scene = "",
    env_id: EnvId = "",
    policy: Policy = "",
    episodes: Count = None,
    seed: Seed = 0,
    split: Split = "train",
    noise: Noise = 0.0,
    noise_correlation: Correlation = 0.0,
    shield: Shield = None,
    branch: Branch = None,
    where: Where = "",
    start: Annotated[str, typer.Option(help="Start pose of the robot.")] = "stand",
    out: Out = Path("logs"),
    pack: Pack = False,
    shard: Shard = "",
    envs: Envs = 16,
    threads: Threads = 0,
    config: Config = None,
    epoch: Epoch = None,
    display: Display = True,
    as_json: Annotated[bool, json_flag("the summary")] = False,
) -> None:
    """Record episodes, one MCAP file each.

    Without options: 10 episodes of the scripted expert at the table, into logs/. A second run adds
    to the first.

    Examples:

        coordlog record

        coordlog record --scene shelf --episodes 512 --noise 0.15 --out logs/shelf

        coordlog record --scene shelf --policy pretrained --split test

        coordlog record --policy runs/table/best --split test --episodes 200 --out logs/evaluation

        coordlog record --episodes 1000 --shard 3/8 --pack --out PACK/

        coordlog record --env Reacher-v5 --policy mine.py:POLICY --out logs/reacher

        coordlog record --branch logs/visited --where "not clean" --out logs/corrected
    """
    from coordlog.api.recording import RecordPlan, record_scene

    policy = policy or ("random" if env_id else "expert")
    plan = chosen(RecordPlan, locals())
    if env_id:
        _record_environment(env_id, plan, out, as_json=as_json)
        return
    with terminal.interruptible() as monitor:
        _, figures = record_scene(plan, out, monitor)
    _show(figures, out=out, as_json=as_json)
    _end(figures["aborted"], interrupted=monitor.stopped)


def _end(aborted: int, *, interrupted: bool) -> None:
    """The exit code of what became of the episodes."""
    if interrupted:
        said = f"interrupted: {aborted} episodes were closed as aborted; all their steps are kept"
        terminal.note(said)
        raise typer.Exit(EXIT_INTERRUPTED)
    if aborted:
        ends = "they are marked aborted and end with their last sound state"
        terminal.note(f"{aborted} episodes diverged: {ends}")
        raise typer.Exit(EXIT_PARTIAL)


def _record_environment(name: str, plan: RecordPlan, out: Path, *, as_json: bool) -> None:
    from coordlog.commands.foreign import record_environment

    if plan.scene or plan.branch or plan.where or plan.config:
        raise ConfigError(
            "--env: an environment of its own, expected no --scene, --branch, --where or --config "
            "beside it"
        )
    if plan.noise or plan.split != "train":
        raise ConfigError("--env: an environment of its own has no --noise and no --split")
    count, acts = plan.episodes or 10, plan.policy
    record_environment(name, acts, episodes=count, seed=plan.seed, out=out, as_json=as_json)


def _show(figures: Json, *, out: Path, as_json: bool) -> None:
    if as_json:
        terminal.print_json(figures)
        return

    def percent(name: str) -> str:
        return f"{figures[name]:.1%}" if figures["episodes"] else "-"

    whole = f"{figures['episodes']} of {figures['wanted']} in {out}/ (run {figures['run']})"
    cost = f"recording cost {figures['recording_us_per_step']:.0f} µs/step"
    terminal.facts(
        [
            ("episodes", whole),
            ("success", percent("success")),
            ("clean", f"{percent('clean')}   success without collision or fall"),
            ("collisions", f"{percent('collisions')}   of episodes"),
            ("falls", percent("falls")),
            ("mean score", f"{figures['score']:.2f}   -ln(e₁ + e₂) at the last step"),
            (
                "speed",
                f"{figures['steps_per_second']:,.0f} steps/s over {figures['steps']:,} steps",
            ),
            ("size", f"{figures['megabytes']:.1f} MB; {cost}"),
        ]
    )
