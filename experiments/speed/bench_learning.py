"""Learning curves per environment step: DiGrad, the same learner without its mask, and scalar TD3 +
HER.

    python experiments/speed/bench_learning.py --scene planar --steps 60000 --seeds 0 1 2 --out
    /tmp/learning/planar coordlog plot /tmp/learning/planar/* --against steps --out curves.png

Learners: mask is DiGrad; sum, mean and pcgrad are the same learner with another rule for the shared
joints (`learner.gradient`); td3 is stable-baselines3's (scalar_peer.py). All have the same network,
batch, updates per step and held-out problems. Every run is a run folder, LEARNER-sSEED; one that
has finished is left alone, an unfinished one of ours is resumed and one of the peer's begun again,
so the command may be killed and repeated. It takes hours and is no part of `make bench`.
"""

from __future__ import annotations

import argparse
import shutil
import statistics
import subprocess
import sys
from pathlib import Path

import torch
from scalar_peer import curve, learn

from coordlog.train.settings import load_settings

OURS = ("mask", "sum", "mean", "pcgrad")
FIGURES = ("success", "clean", "score")
REACHED = (0.5, 0.9)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scene", default="planar")
    parser.add_argument("--learners", nargs="+", default=[*OURS, "td3"], choices=[*OURS, "td3"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--steps", type=int, default=60_000)
    parser.add_argument("--every", type=int, default=5_000, help="steps between evaluations")
    parser.add_argument(
        "--episodes", type=int, default=100, help="held-out problems per evaluation"
    )
    parser.add_argument("--envs", type=int, default=32)
    parser.add_argument(
        "--set",
        dest="assignments",
        action="append",
        default=[],
        help="a setting of all of them, section.key=value",
    )
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    torch.set_num_threads(1)
    for seed in options.seeds:
        for learner in options.learners:
            folder = options.out / f"{learner}-s{seed}"
            print(f"== {folder}", flush=True)
            (peer if learner == "td3" else ours)(options, learner, seed, folder)
    table(options)


def ours(options: argparse.Namespace, gradient: str, seed: int, folder: Path) -> None:
    """`coordlog train`, begun or gone on with; a finished run has nothing left to do."""
    assignments = [*options.assignments, f"learner.gradient={gradient}", "loop.updates=0"]
    every = max(
        1, round(options.every * load_settings(assignments=assignments).loop.updates_per_step)
    )
    command = [
        sys.executable,
        "-m",
        "coordlog.cli",
        "train",
        "--scene",
        options.scene,
        "--preset",
        "default",  # the peer decides every 0.04 s, too
        "--steps",
        str(options.steps),
        "--seed",
        str(seed),
    ]
    command += [
        "--eval-every",
        str(every),
        "--eval-episodes",
        str(options.episodes),
        "--envs",
        str(options.envs),
        "--out",
        str(folder),
    ]
    for assignment in assignments:
        command += ["--set", assignment]
    begun = (folder / "checkpoint.safetensors").exists()
    if folder.exists() and not begun:
        shutil.rmtree(folder)  # killed before its first checkpoint
    done = subprocess.run([*command, *(["--resume"] if begun else [])], check=False)
    if done.returncode not in (0, 1):  # 1: diverged, which is a result
        sys.exit(f"{folder}: the run ended with {done.returncode}")


def peer(options: argparse.Namespace, learner: str, seed: int, folder: Path) -> None:
    if (folder / "finished").exists():
        return
    if folder.exists():
        shutil.rmtree(folder)
    settings = load_settings(
        assignments=[
            *options.assignments,
            f"loop.seed={seed}",
            "loop.updates=0",
            f"loop.steps={options.steps}",
        ]
    )
    learn(
        options.scene,
        settings,
        folder,
        steps=options.steps,
        envs=options.envs,
        every=options.every,
        episodes=options.episodes,
    )


def table(options: argparse.Namespace) -> None:
    """The last evaluation, and the first step at which success reached a share, mean over seeds (±
    sample deviation).
    """
    head = "".join(f"{name:>16}" for name in FIGURES) + "".join(
        f"{f'steps to {share:.0%}':>18}" for share in REACHED
    )
    print(f"\n{'learner':10}{head}   over {len(options.seeds)} seeds")
    for learner in options.learners:
        curves = [curve(options.out / f"{learner}-s{seed}") for seed in options.seeds]
        cells = [spread([rows[-1][name] for rows in curves if rows]) for name in FIGURES]
        for share in REACHED:
            firsts = [
                next((row["step"] for row in rows if row["success"] >= share), None)
                for rows in curves
            ]
            reached = [step for step in firsts if step is not None]
            cells.append(
                f"{statistics.mean(reached):,.0f} ({len(reached)}/{len(firsts)})"
                if reached
                else "never"
            )
        print(
            f"{learner:10}"
            + "".join(f"{cell:>{16 if i < len(FIGURES) else 18}}" for i, cell in enumerate(cells))
        )


def spread(values: list[float]) -> str:
    if not values:
        return "-"
    return f"{statistics.mean(values):.3f} ± {statistics.stdev(values) if len(values) > 1 else 0.0:.3f}"


if __name__ == "__main__":
    main()
