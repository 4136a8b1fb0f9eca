"""Measure one row of the results: a policy on held-out goals of a scene, at 3 cm and at 2 cm.

    python -m experiments.evaluate digrad-logs table runs/table-logs-s0 --seed 0
    python -m experiments.evaluate expert shelf expert
    python -m experiments.evaluate td3-her free experiments/speed/td3.zip --seed 0

Writes experiments/tables/SCENE-ROW[-locked][-sSEED].json. ROW is one of experiments/recipes.toml.
"""

from __future__ import annotations

import argparse
import platform
import sys
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from coordlog.contracts import Policy
from coordlog.episode import Json
from coordlog.errors import CoordlogError
from coordlog.sim.env import BatchEnv
from coordlog.sim.making import make_env
from experiments import tables
from experiments.actors import actor, learnt_in
from experiments.measure import SEED, SPLIT, TIMED, decisions, figures, run
from experiments.recipes import row_names
from experiments.torso import SPINE
from experiments.training import cost

EPISODES = 500
ENVS = 32
BARE = "bare"
"""The row of shipped policies without the shield that their cards ask for (`record
--no-shield`)."""
RADII = {"3 cm": 0.03, "2 cm": 0.02}
"""An episode ends at success, so each radius is an evaluation of its own."""
HOME = "from home"
"""The key of a policy's figures at 3 cm from the pose of that name; all others are from stand."""


def environment(
    scene: str,
    policy: str,
    *,
    radius: float,
    torso: str,
    envs: int,
    threads: int = 0,
    start: str = "stand",
    **constants: Any,
) -> BatchEnv:
    """The environment a policy was trained in, with this goal radius, torso, and whatever other
    constants [env] has.
    """
    constants |= {"goal_radius": radius, "locked": SPINE if torso == "locked" else ()}
    like = learnt_in(policy, scene)
    return make_env(scene, {"env": constants}, start=start, envs=envs, threads=threads, like=like)


def evaluate(
    row: str, scene: str, policy: str, *, torso: str, episodes: int, seed: int | None
) -> tables.Table:
    """The table of one row."""
    table: tables.Table = {"row": row, "scene": scene, "torso": torso, "training_seed": seed}
    judged = {name: (radius, "stand") for name, radius in RADII.items()}
    if learnt_in(policy, scene):
        judged[HOME] = RADII["3 cm"], "home"
    for name, (radius, start) in judged.items():
        envs = min(ENVS, episodes)
        env = environment(scene, policy, radius=radius, torso=torso, envs=envs, start=start)
        chosen, said = _acting(row, policy, env)
        table["policy"] = said
        table[name] = figures(run(env, chosen, episodes=episodes))
        if Path(policy).is_dir():
            said["cost"] = cost(Path(policy), said["training"])
        print(f"{scene} {row} {name}: {summary(table[name])}", file=sys.stderr, flush=True)
    env = environment(scene, policy, radius=RADII["3 cm"], torso=torso, envs=1, threads=1)
    timed = _acting(row, policy, env)[0]
    table["decision"] = decisions(env, timed, episodes=min(TIMED, episodes))
    table["problems"] = {"seed": SEED, "split": SPLIT, "episodes": episodes}
    table["versions"] = versions()
    return table


def _acting(row: str, policy: str, env: BatchEnv) -> tuple[Policy, Json]:
    """The policy of a row, without its shield where the row is that."""
    return actor(policy, env, shield=False if row == BARE else None)


def summary(found: Mapping[str, Any]) -> str:
    """One line for a person who waits."""
    return ", ".join(
        f"{name} {found[name]['rate']:.1%}" for name in ("success", "clean", "collisions", "falls")
    )


def versions() -> dict[str, str]:
    """What the figures depend on."""
    return {
        "coordlog": version("coordlog"),
        "mujoco": mujoco.__version__,
        "numpy": np.__version__,
        "machine": platform.machine(),
    }


def main(arguments: list[str] | None = None) -> None:
    """Measure what the command line names."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.evaluate", description=(__doc__ or "").split("\n", 1)[0]
    )
    parser.add_argument("row", choices=row_names())
    parser.add_argument("scene", choices=tables.SCENES)
    parser.add_argument(
        "policy",
        help="expert, pretrained, a run folder or policy file, or a .zip of stable-baselines3",
    )
    parser.add_argument("--episodes", type=int, default=EPISODES)
    parser.add_argument("--seed", type=int, help="the training's, where a row has several")
    parser.add_argument("--torso", choices=tables.TORSOS, default="free")
    parser.add_argument("--out", type=Path, default=tables.FOLDER)
    given = parser.parse_args(arguments)
    try:
        table = evaluate(
            given.row,
            given.scene,
            given.policy,
            torso=given.torso,
            episodes=given.episodes,
            seed=given.seed,
        )
    except CoordlogError as error:
        sys.exit(f"{error}")
    print(
        tables.write(
            table,
            tables.name_of(given.row, given.scene, torso=given.torso, seed=given.seed),
            folder=given.out,
        )
    )


if __name__ == "__main__":
    main()
