"""Problem to safe trajectory: a policy's rollout smoothed and certified, against OMPL's RRTConnect
+ inverse kinematics + simplification.

    python -m experiments.planner table [--episodes 200] [--policy pretrained]

Both plan the same held-out problems, taking turns, and both results are executed by the same servos
from the same first state. Writes experiments/tables/SCENE-planning.json (the comparison) and
SCENE-ompl.json (the planner as a row of the results). Needs `ompl`.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from coordlog.contracts import Policy
from coordlog.episode import Array
from coordlog.errors import CoordlogError
from coordlog.sim.env import BatchEnv
from coordlog.sim.scoring import Score
from coordlog.sim.tracking import Run
from coordlog.smooth import metrics
from experiments import measure, tables
from experiments.actors import actor
from experiments.case import case, chase, score
from experiments.evaluate import RADII, environment, versions
from experiments.nearest import Nearest
from experiments.ompl_plan import CLEARANCES, RESOLUTION, Timed, plan, quiet
from experiments.safe import CLEARANCE, executed, safe
from experiments.stats import median_interval, rate

EPISODES = 200
LONG = 1000
"""Steps a planned motion may take: the planner is not held to the episode's limit."""
OURS = ("physics", "kinematic")


class Tried:
    """One way of getting to trajectories, and how it went on every problem."""

    def __init__(self) -> None:
        self.scores: list[Score | None] = []
        self.clearance: list[float] = []
        self.found: list[bool] = []
        self.certified: list[bool] = []
        self.numbers: dict[str, list[float]] = {}

    def add(
        self, numbers: dict[str, float], *, ran: Run | None, nearest: float, certified: bool
    ) -> None:
        """Count one problem; None for one without a trajectory."""
        self.found.append(ran is not None)
        self.certified.append(certified)
        self.scores.append(None if ran is None else score(ran))
        self.clearance.append(nearest)
        for name, value in numbers.items():
            self.numbers.setdefault(name, []).append(value)

    def row(self) -> dict[str, Any]:
        """Shares of all problems, and medians with intervals."""
        n = len(self.scores)
        done = [each for each in self.scores if each is not None]
        shares = {
            name: rate(sum(bool(getattr(each, name)) for each in done), n)
            for name in ("success", "clean", "collided", "fell")
        }
        shares |= {"found": rate(sum(self.found), n), "certified": rate(sum(self.certified), n)}
        return shares | {name: median_interval(values) for name, values in self.numbers.items()}


def compare(
    scene: str, policy: str, *, episodes: int, seed: int = 0
) -> tuple[tables.Table, tables.Table]:
    """The comparison, and OMPL's row."""
    quiet(seed + 1)
    ours = environment(scene, policy, radius=RADII["3 cm"], torso="free", envs=1, threads=1)
    theirs = environment(
        scene, policy, radius=RADII["3 cm"], torso="free", envs=1, threads=1, max_steps=LONG
    )
    act, said = actor(policy, ours)
    # What is proven afterwards needs no shield before: the network alone is asked first where there are two.
    ways = {
        "physics": [act],
        "kinematic": [actor(policy, ours, shield=False)[0], act] if "shield" in said else [act],
    }
    tried = {name: Tried() for name in (*OURS, "ompl")}
    for index in range(episodes):
        for name in OURS:
            _ours(tried[name], ours, ways[name], index, physics=name == "physics")
        _theirs(tried["ompl"], theirs, index)
        if index % 20 == 19:
            print(f"{scene}: {index + 1} of {episodes} problems", file=sys.stderr, flush=True)
    problems = {"seed": measure.SEED, "split": measure.SPLIT, "episodes": episodes}
    table = {
        "kind": "planning",
        "scene": scene,
        "policy": said,
        "problems": problems,
        "settings": {
            "resolution": RESOLUTION,
            "clearances": list(CLEARANCES),
            "smoothing_clearance": CLEARANCE,
            "max_steps": LONG,
        },
        **{name: each.row() for name, each in tried.items()},
        "ratios": {name: ratios(tried[name], tried["ompl"]) for name in OURS},
        "versions": versions(),
    }
    return table, _row(scene, tried["ompl"], problems)


def ratios(one: Tried, other: Tried) -> dict[str, Any]:
    """Problem by problem, medians with intervals: CPU of ours over theirs, and jerk of theirs over
    ours.
    """

    def over(name: str, top: Tried, bottom: Tried) -> list[float]:
        return [
            a / b
            for a, b in zip(top.numbers[name], bottom.numbers[name], strict=True)
            if math.isfinite(a) and math.isfinite(b)
        ]

    jerk, lasts = over("jerk", other, one), over("seconds", other, one)
    return {
        "cpu": median_interval(over("cpu", one, other)),
        "jerk": median_interval(jerk),
        "jerk_same_duration": median_interval(
            [each * last**3 for each, last in zip(jerk, lasts, strict=True)]
        ),
    }


def _ours(
    tried: Tried, env: BatchEnv, policies: Sequence[Policy], index: int, *, physics: bool
) -> None:
    where = case(env, index)
    found = safe(env, where, policies, physics=physics)
    ran = executed(where, env, found)
    spline = found.result.spline
    last = float(spline.time[-1])
    before, after = found.result.before, found.result.after
    numbers = {
        **found.cpu,
        "cpu": sum(found.cpu.values()),
        "seconds": last,
        "jerk": _jerk(spline, last, env),
    }
    numbers |= {"smoother": before.jerk / after.jerk, "end_error": after.end_error}
    tried.add(numbers, ran=ran, nearest=_nearest(env, ran), certified=bool(found.result.certified))


def _theirs(tried: Tried, env: BatchEnv, index: int) -> None:
    where = case(env, index)
    planned = plan(env, where)
    cpu = {name: planned.cpu.get(name, math.nan) for name in ("ik", "rrt", "simplify")}
    numbers = {**cpu, "cpu": sum(planned.cpu.values()), "seconds": math.nan, "jerk": math.nan}
    if planned.points is None:
        tried.add(numbers, ran=None, nearest=math.inf, certified=False)
        return
    path = Timed.of(planned.points, env.task.speeds)
    ran = chase(where.log, path.__call__, path.duration)
    numbers |= {"seconds": path.duration, "jerk": _jerk(path, path.duration, env)}
    tried.add(numbers, ran=ran, nearest=_nearest(env, ran), certified=False)


def _jerk(path: Any, duration: float, env: BatchEnv) -> float:
    """Rest-padded RMS at the control period [rad/s³]."""
    n = max(4, round(duration / env.task.config.control_period) + 1)
    time, dt = np.linspace(0.0, duration, n, retstep=True)
    return metrics.jerk(path(time), float(dt))


def _nearest(env: BatchEnv, ran: Run) -> float:
    """Least distance to an obstacle at the end of any step of an execution [m]."""
    nearest = Nearest(env)
    if not nearest.known:
        return math.inf
    configurations: Array = ran.columns["qpos"]
    return min(
        nearest.at(qpos, env.physics.mocap_pos[0], env.simulation.radii[0])
        for qpos in configurations
    )


def _row(scene: str, tried: Tried, problems: dict[str, Any]) -> tables.Table:
    """OMPL as a row of the results: a problem without a path counts as a failure, and planning as
    what comes before the first step.
    """
    done = [
        (each, near)
        for each, near in zip(tried.scores, tried.clearance, strict=True)
        if each is not None
    ]
    found = measure.figures(measure.Run([each for each, _ in done], [near for _, near in done]))
    n = len(tried.scores)
    for name in ("success", "clean", "collisions", "falls"):
        found[name] = rate(found[name]["count"], n)
    cpu = sorted(tried.numbers["cpu"])
    begin = {"median": float(np.percentile(cpu, 50)), "p95": float(np.percentile(cpu, 95))}
    return {
        "row": "ompl",
        "scene": scene,
        "torso": "free",
        "training_seed": None,
        "policy": {"kind": "ompl", "training": {}},
        "3 cm": found,
        "decision": {"act": None, "begin": begin, "calls": n},
        "problems": problems,
        "versions": versions(),
    }


def main(arguments: list[str] | None = None) -> None:
    """Compare on the scenes of the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.planner", description=(__doc__ or "").split("\n", 1)[0]
    )
    parser.add_argument("scene", nargs="+", choices=tables.SCENES)
    parser.add_argument("--policy", default="pretrained")
    parser.add_argument("--episodes", type=int, default=EPISODES)
    parser.add_argument("--out", type=Path, default=tables.FOLDER)
    given = parser.parse_args(arguments)
    for scene in given.scene:
        try:
            comparison, row = compare(scene, given.policy, episodes=given.episodes)
        except CoordlogError as error:
            sys.exit(str(error))
        print(tables.write(comparison, f"{scene}-planning", folder=given.out))
        print(tables.write(row, tables.name_of("ompl", scene), folder=given.out))


if __name__ == "__main__":
    main()
