"""Is the articulated torso of use? The same problems with the five joints of the spine held by
their servos.

python -m experiments.torso            inverse kinematics with and without the spine →
experiments/tables/SCENE-reach.json
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from coordlog.episode import Array
from coordlog.robots.humanoid import HUMANOID
from coordlog.sim.env import BatchEnv
from coordlog.tasks.scene import find
from experiments import cells, tables
from experiments.cells import Tables
from experiments.measure import SEED, SPLIT
from experiments.stats import rate

SPINE = HUMANOID.shared
RESTARTS = 20
"""Random postures that a search starts from, after the named ones, before a goal counts as out of
reach."""
EPISODES = 500


def reaches(
    env: BatchEnv, goals: Array, start: Array, rng: np.random.Generator, *, locked: bool
) -> bool:
    """Whether a legal posture was found with both palms on their goals (to 2 mm), the spine at its
    start angles or free.
    """
    reach = env.draw.reach
    spine = np.isin(env.scene.robot.action_joints, SPINE)
    held = np.where(spine, start, np.nan) if locked else None
    if reach.solve(goals, held=held) is not None:
        return True
    seeds = (np.asarray(rng.uniform(*env.task.limits.T)) for _ in range(RESTARTS))
    return any(reach.solve(goals, seed=seed, held=held) is not None for seed in seeds)


def measure(scene: str, *, episodes: int = EPISODES) -> tables.Table:
    """For how many held-out goals two-hand inverse kinematics finds a posture."""
    env = BatchEnv(find(scene), n=1, threads=1)
    counts: dict[str, int] = {}
    for index in range(episodes):
        problem = env.problem(seed=SEED, split=SPLIT, index=index)
        env.draw.reach.place(problem.spheres)
        for torso in tables.TORSOS:
            rng = np.random.default_rng([SEED, index])
            found = reaches(env, problem.goals, problem.angles, rng, locked=torso == "locked")
            counts[torso] = counts.get(torso, 0) + found
    return {
        "kind": "reach",
        "scene": scene,
        "problems": {"seed": SEED, "split": SPLIT, "episodes": episodes},
        "restarts": RESTARTS,
        **{torso: rate(count, episodes) for torso, count in counts.items()},
    }


def section(found: Tables) -> str:
    """What the spine is worth, scene by scene."""
    names = (
        "scene",
        "problems",
        "posture exists, torso free",
        "torso locked",
        "expert clean, free",
        "locked",
        "DiGrad from logs clean, free",
        "locked",
    )
    lines = cells.head(*names)
    for scene in tables.SCENES:
        reach = found.get(f"{scene}-reach")
        texts = [cells.share(reach[torso]) if reach else "not run" for torso in tables.TORSOS]
        for row in ("expert", "digrad-logs"):
            texts += [
                cells.good(tables.of_row(found, row, scene, torso=torso), "3 cm", "clean")
                for torso in tables.TORSOS
            ]
        lines.append(cells.line(scene, cells.problems([reach]) if reach else "", *texts))
    return ABOUT.format(restarts=RESTARTS) + "\n".join(lines) + "\n"


ABOUT = """## Torso free, torso locked

The same problems, drawn where the robot reaches with its spine, with `locked` naming the spine's five joints in `[env]`
(experiments/locked.toml): their servos hold the start angles, state and action keep their shape. *Posture exists*: inverse kinematics finds
a posture that touches nothing, keeps the centre of mass over the feet, and has both palms on their goals to 2 mm, from the named poses
and {restarts} random ones. The locked policy learnt from 512 logs of the locked expert.

"""


def main(arguments: list[str] | None = None) -> None:
    """Measure every scene."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.torso", description=(__doc__ or "").split("\n", 1)[0]
    )
    parser.add_argument("scene", nargs="*", default=tables.SCENES)
    parser.add_argument("--episodes", type=int, default=EPISODES)
    given = parser.parse_args(arguments)
    for scene in given.scene:
        table: dict[str, Any] = measure(scene, episodes=given.episodes)
        print(
            tables.write(table, f"{scene}-reach"),
            *(f"{torso} {table[torso]['rate']:.1%}" for torso in tables.TORSOS),
        )


if __name__ == "__main__":
    main()
