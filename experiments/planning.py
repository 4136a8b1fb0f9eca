"""The part of the page on getting from a problem to a proven trajectory: experiments/planner.py's
tables as text.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from experiments import cells, tables
from experiments.cells import Tables

WAYS = {
    "kinematic": "policy, kinematic rollout + `local` smoothing",
    "physics": "policy, rollout in the simulation + `local` smoothing",
    "ompl": "OMPL RRTConnect + IK + simplify",
}

ABOUT = """## Problem to safe trajectory

`python -m experiments.planner SCENE`: the shipped policy's rollout, smoothed with 5 mm of clearance and certified between samples, against
OMPL's RRTConnect to an inverse-kinematics goal with simplification (motions checked every 0.05 rad, keeping 10 mm where start and goal
allow), on the same held-out problems, taking turns. Both results are then executed by the same servos from the same first state;
executing is not part of the CPU time. Jerk is the rest-padded root mean square at the control period. Medians and 95 % bootstrap
intervals; processor time of one thread on a shared machine.

A *kinematic rollout* takes the servos as exact and the base as still, which is what the planner plans with. It ends in a posture with
the palms on their goals, as the planner's path does: the policy leads to the goal radius, inverse kinematics from there closes the rest.
It is a path that nobody has gone yet, so its times may be chosen: 1.15 times the policy's, or, where a smooth motion between its ends at
the joints' speeds would take longer, as long as that; 30 configurations of it are kept. Among spheres the network alone leads; where what
comes of it cannot be proven, it is asked again with its shield, and both are paid for. A *rollout in the simulation* keeps its times, as
`coordlog smooth` does. The planner's path is timed by one minimum-jerk law to the joints' speeds and may take longer than an episode. In
`free` nothing is in the way: a straight line under that law is then of all motions as long the one with the least jerk, and no other can
be ten times smoother.

"""


def section(found: Tables) -> str:
    """Every scene's ways, and the ratios."""
    lines = cells.head(
        "scene",
        "way",
        "problems",
        "CPU [ms]",
        "of it",
        "proven",
        "executed: success",
        "clean",
        "motion [s]",
        "jerk [rad/s³]",
    )
    for scene in tables.SCENES:
        table = found.get(f"{scene}-planning")
        if table is None:
            lines.append(cells.line(scene, "not run", *[""] * 8))
            continue
        lines += [_line(scene, name, table) for name in WAYS]
    return ABOUT + "\n".join(lines) + "\n\n" + "\n".join(_ratios(found)) + "\n"


def _line(scene: str, name: str, table: Mapping[str, Any]) -> str:
    row = table[name]
    parts = ("ik", "rrt", "simplify") if name == "ompl" else ("rollout", "smooth")
    return cells.line(
        scene,
        WAYS[name],
        str(table["problems"]["episodes"]),
        cells.median(row["cpu"], scale=1e3),
        " + ".join(
            f"{part} {cells.up(1e3 * row[part]['median'])}" for part in parts if row.get(part)
        ),
        "no proof" if name == "ompl" else cells.share(row["certified"]),
        cells.share(row["success"]),
        cells.share(row["clean"]),
        cells.median(row["seconds"]),
        cells.median(row["jerk"]),
    )


def _ratios(found: Tables) -> list[str]:
    lines = cells.head(
        "scene",
        "rollout",
        "CPU, ours / OMPL's (≤ 1)",
        "jerk, OMPL's / ours (≥ 10)",
        "at ours' duration",
        "clean, ours - OMPL's",
    )
    for scene in tables.SCENES:
        table = found.get(f"{scene}-planning")
        for name in ("kinematic", "physics") if table else ():
            assert table is not None
            ratio = table["ratios"][name]
            gained = table[name]["clean"]["rate"] - table["ompl"]["clean"]["rate"]
            lines.append(
                cells.line(
                    scene,
                    name,
                    cells.median(ratio["cpu"], digits=2),
                    cells.median(ratio["jerk"], small=False),
                    cells.median(ratio["jerk_same_duration"], small=False),
                    f"{cells.down(100 * gained)} points",
                )
            )
    return lines
