"""coordlog record: episodes out of MuJoCo."""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coordlog.commands import terminal
from coordlog.commands.sink import Sink, recording_into
from coordlog.errors import EXIT_INTERRUPTED, EXIT_PARTIAL, ConfigError
from coordlog.parallel import SHARD_HELP
from coordlog.parallel import shard as share

if TYPE_CHECKING:
    from coordlog.record.recorder import Recorder
    from coordlog.sim.scoring import Scoreboard


def record(
    scene: Annotated[
        str,
        typer.Option(
            help="free, spheres, table, shelf, planar, hold, or your own, FILE.py:NAME or ROBOT.toml; by default the policy's, or table."
        ),
    ] = "",
    env_id: Annotated[
        str,
        typer.Option(
            "--env",
            help="A Gymnasium environment on MuJoCo by its id, such as Reacher-v5, in place of a scene.",
        ),
    ] = "",
    policy: Annotated[
        str | None,
        typer.Option(
            help="expert (without --env), random, still, pretrained, or a run folder or policy file; with --env random, FILE.py:NAME or a model of stable-baselines3."
        ),
    ] = None,
    episodes: Annotated[
        int | None, typer.Option(min=1, help="How many; by default 10, or one per branch.")
    ] = None,
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of goals, obstacles, start poses and noise.")
    ] = 0,
    split: Annotated[
        str, typer.Option(help="train, or test: problems that training never sees.")
    ] = "train",
    noise: Annotated[
        float,
        typer.Option(min=0, help="Standard deviation of Gaussian noise on the actions; logged."),
    ] = 0.0,
    noise_correlation: Annotated[
        float, typer.Option(help="Correlation of the noise from step to step, 0 to below 1.")
    ] = 0.0,
    shield: Annotated[
        bool | None,
        typer.Option(
            help="Slow links down towards near spheres, and arms towards the body; logged. By default as a shipped policy's card says."
        ),
    ] = None,
    branch: Annotated[
        list[Path] | None,
        typer.Option(
            help="Folders of logs; each episode begins in one of those, just before it went wrong."
        ),
    ] = None,
    where: Annotated[str, typer.Option(help='Which of them, in SQL: "not clean".')] = "",
    start: Annotated[str, typer.Option(help="Start pose of the robot.")] = "stand",
    out: Annotated[
        Path,
        typer.Option(help="Folder, pack or s3://…; what is already there stays as it is."),
    ] = Path("logs"),
    pack: Annotated[
        bool, typer.Option("--pack", help="Write a pack: many episodes in a few large files.")
    ] = False,
    shard: Annotated[str, typer.Option(help=SHARD_HELP, metavar="I/N")] = "",
    envs: Annotated[
        int, typer.Option(min=1, help="Simulations at once; changes the speed, never the result.")
    ] = 16,
    threads: Annotated[
        int, typer.Option(min=0, help="Threads to simulate on; 0 for all cores.")
    ] = 0,
    config: Annotated[
        Path | None, typer.Option(help="TOML file with tables [env] and [reward].")
    ] = None,
    epoch: Annotated[
        int | None,
        typer.Option(min=0, help="Start time [ns since 1970]; equal runs then write equal bytes."),
    ] = None,
    display: Annotated[
        bool, typer.Option(help="Also write /joint_states and /coordlog/arm/NAME, for viewers.")
    ] = True,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON.")] = False,
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
    if env_id:
        from coordlog.commands.foreign import record_environment

        if scene or branch or where or config:
            raise ConfigError(
                "--env: an environment of its own, expected no --scene, --branch, --where or --config beside it"
            )
        if noise or split != "train":
            raise ConfigError("--env: an environment of its own has no --noise and no --split")
        record_environment(
            env_id, policy or "random", episodes=episodes or 10, seed=seed, out=out, as_json=as_json
        )
        return
    policy = policy or "expert"
    from coordlog.commands.logs import load_logs
    from coordlog.config import read_toml
    from coordlog.policies.registry import DEFAULT_SCENE, about, make_policy, policy_file
    from coordlog.policies.scripted import with_noise
    from coordlog.record.branches import Branched, Parents
    from coordlog.record.recorder import Recorder
    from coordlog.sim.examine import scarce
    from coordlog.sim.making import make_env
    from coordlog.sim.rollout import rollout
    from coordlog.sim.scoring import Scoreboard
    from coordlog.tasks.own import scene_of
    from coordlog.tasks.scene import find

    if where and not branch:
        raise ConfigError(
            "--where: chooses among the logs of --branch, of which there are none; name their folders"
        )
    parents = None
    if branch:
        parents = Parents(load_logs(branch, where=where, skip_broken=False, jobs=0))
    episodes = episodes or (len(parents) if parents else 10)
    asked = scene_of(scene) if scene else find(parents.scene) if parents else None
    if parents and asked and asked.name != parents.scene:
        raise ConfigError(
            f"--scene: expected the scene of the logs to branch from, '{parents.scene}', got '{asked.name}'; leave it out"
        )
    file = policy_file(policy, asked.name if asked else DEFAULT_SCENE)
    trained = about(file) if file else {}
    place = asked or find(trained.get("scene", DEFAULT_SCENE))
    tables = read_toml(config) if config else {}
    like = parents.env if parents else trained.get("env")
    start = parents.start if parents else start
    numbers = share(range(episodes), shard)
    envs = max(min(envs, len(numbers)), 1)
    env = make_env(
        place,
        tables,
        start=start,
        envs=envs,
        threads=threads,
        like=like,
        doubts=terminal.note,
    )
    chosen, described = make_policy(policy, env, shield=shield)
    actor, described["noise"] = with_noise(chosen, env, sigma=noise, correlation=noise_correlation)
    board = Scoreboard(env.n, env.layout.k)
    steps, began = 0, time.perf_counter()
    with (
        recording_into(out, pack=pack) as sink,
        terminal.progress() as bar,
        terminal.interruptible() as interrupted,
    ):
        task = bar.add_task(f"recording {place.name}", total=len(numbers), note="")
        make = partial(Branched, parents) if parents else Recorder
        with make(
            env, sink.folder, policy=described, display=display, epoch=epoch, finished=sink.take
        ) as recorder:
            for ids, outcome in rollout(recorder, actor, numbers, seed=seed, split=split):
                board.add(ids, outcome)
                steps += len(ids)
                bar.update(
                    task,
                    completed=len(sink.done),
                    note=f"{steps / (time.perf_counter() - began):,.0f} steps/s",
                )
                if interrupted:
                    break
        bar.update(task, completed=len(sink.done))
    summary = _summary(board, sink, recorder, steps=steps, seconds=time.perf_counter() - began)
    summary["wanted"] = len(numbers)
    _show(summary, out=out, as_json=as_json)
    if seldom := scarce(env):
        terminal.note(seldom)
    if interrupted:
        terminal.note(
            f"interrupted: {summary['aborted']} episodes were closed as aborted; all their steps are kept"
        )
        raise typer.Exit(EXIT_INTERRUPTED)
    if summary["aborted"]:
        terminal.note(
            f"{summary['aborted']} episodes diverged: they are marked aborted and end with their last sound state"
        )
        raise typer.Exit(EXIT_PARTIAL)


def _summary(
    board: Scoreboard, sink: Sink, recorder: Recorder, *, steps: int, seconds: float
) -> dict[str, Any]:
    """The figures of a run; rates are of the episodes that ended."""
    from coordlog.sim.scoring import figures

    return {
        "run": recorder.run,
        **figures(board.scores),
        "aborted": sum(bool(item.result.aborted) for item in sink.done),
        "steps": steps,
        "seconds": seconds,
        "steps_per_second": steps / seconds,
        "megabytes": sink.size / 1e6,
        "recording_us_per_step": recorder.seconds / max(steps, 1) * 1e6,
        "files": [str(item.path) for item in sorted(sink.done, key=lambda item: item.path)],
    }


def _show(summary: dict[str, Any], *, out: Path, as_json: bool) -> None:
    if as_json:
        terminal.print_json(summary)
        return

    def percent(name: str) -> str:
        return f"{summary[name]:.1%}" if summary["episodes"] else "-"

    pairs = [
        (
            "episodes",
            f"{summary['episodes']} of {summary['wanted']} in {out}/ (run {summary['run']})",
        ),
        ("success", percent("success")),
        ("clean", f"{percent('clean')}   success without collision or fall"),
        ("collisions", f"{percent('collisions')}   of episodes"),
        ("falls", percent("falls")),
        ("mean score", f"{summary['score']:.2f}   -ln(e₁ + e₂) at the last step"),
        ("speed", f"{summary['steps_per_second']:,.0f} steps/s over {summary['steps']:,} steps"),
        (
            "size",
            f"{summary['megabytes']:.1f} MB; recording cost {summary['recording_us_per_step']:.0f} µs/step",
        ),
    ]
    terminal.facts(pairs)
