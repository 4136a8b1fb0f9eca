"""How smoothing grows with the length of a path: configurations asked about and processor time,
`paper` and `local`.

    python -m experiments.growth      → experiments/tables/growth.json

One kinematic rollout of the shipped table policy, gone through there and back again until it has so
many knots. The paper's method as printed looks at the knots alone; `local` proves what lies between
as well.
"""

from __future__ import annotations

import argparse
from typing import Any, cast

import numpy as np

from coordlog.kinematics.clearance import SceneChecker
from coordlog.smooth.smoother import smooth
from experiments import tables
from experiments.actors import actor
from experiments.case import case
from experiments.evaluate import RADII, environment, versions
from experiments.safe import kinematic

SCENE = "table"
KNOTS = (75, 150, 300, 600)
METHODS: dict[str, dict[str, Any]] = {
    "paper": {"method": "paper", "dense": 1, "certify": False},
    "local": {"method": "local", "ends": "soft"},
}


def measure(knots: tuple[int, ...] = KNOTS) -> tables.Table:
    """One row for each length."""
    env = environment(SCENE, "pretrained", radius=RADII["3 cm"], torso="free", envs=1, threads=1)
    where = case(env, 0)
    rolled = kinematic(env, where, actor("pretrained", env)[0])
    there = np.concatenate([rolled.qpos, rolled.qpos[-2:0:-1]])
    task, rows = env.task, []
    for n in knots:
        qpos, time = (
            np.resize(there, (n, there.shape[1])),
            np.arange(n) * task.config.control_period,
        )
        row: dict[str, Any] = {"knots": n}
        for name, options in METHODS.items():
            log = where.log
            checker = SceneChecker(
                log.model, task.robot, task.config, time=time, qpos=qpos, initial=log.start
            )
            # The checker is one by its methods: the simulation's room knows nothing of smoothing.
            result = smooth(time, qpos[:, task.qpos_index], cast("Any", checker), **options)
            row[name] = {
                "checks": result.checks + result.slacks,
                "cpu": result.cpu,
                "status": result.status,
            }
        rows.append(row)
    return {"kind": "growth", "scene": SCENE, "rows": rows, "versions": versions()}


def main(arguments: list[str] | None = None) -> None:
    """Measure every length."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.growth", description=(__doc__ or "").split("\n", 1)[0]
    )
    parser.add_argument("--knots", type=int, nargs="+", default=KNOTS)
    given = parser.parse_args(arguments)
    print(tables.write(measure(tuple(given.knots)), "growth"))


if __name__ == "__main__":
    main()
