"""Everything about a robot in its scene that a person should know before the first episode."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

from coordlog.errors import CoordlogError
from coordlog.mjcf import compile_model, compose, pack_source
from coordlog.robots.robot import Robot
from coordlog.sim.doubts import doubts
from coordlog.sim.env import BatchEnv
from coordlog.sim.sampler import FEASIBLE
from coordlog.sim.settling import faults, settle
from coordlog.tasks.config import EnvConfig
from coordlog.tasks.scene import Scene

SCARCE = 0.5
"""A share of feasible draws below this is worth a word."""
STEPS = 20


class Report(NamedTuple):
    """What was found."""

    faults: list[str]
    """What must be mended before anything can be recorded, one sentence each."""
    facts: list[tuple[str, str]]
    """What is so, by name."""


def examine(
    scene: Scene, config: EnvConfig | None = None, *, start: str = "stand", draws: int = 30
) -> Report:
    """Build a scene, let its robot stand, and draw problems.

    Args:
        scene: What to look at.
        config: As for an environment.
        start: Start pose.
        draws: Problems to draw, each once.
    """
    config = config or EnvConfig()
    try:
        source = compose(scene, config)
        model = compile_model(source)
        rest = settle(scene.robot, model, start)
    except CoordlogError as error:
        return Report([str(error)], [])
    names = [model.geom(i).name or f"geom {i}" for i in range(model.ngeom)]
    wrong = faults(scene.robot, model, start, rest)
    held = not any(
        "is not held" in said for said in wrong
    )  # what touches after a fall says nothing
    wrong += [
        f"in its start pose {names[one]} touches {names[other]}: every episode would begin with a "
        "collision; "
        "choose another pose, or exclude their bodies"
        for one, other in rest.touching * held
    ]
    asked = [int(model.joint(name).qposadr[0]) for name in scene.robot.action_joints]
    away = np.abs(rest.row[1 : 1 + model.nq] - rest.asked)[asked]
    worst = scene.robot.action_joints[int(away.argmax())]
    facts = [
        ("robot", _about(scene.robot)),
        (
            "start pose",
            f"held to {away.max():.3f} rad ({worst})" if np.isfinite(away).all() else "lost",
        ),
        ("let be", ", ".join(f"{names[a]} and {names[b]}" for a, b in rest.resting) or "nothing"),
        ("model", f"{sum(map(len, pack_source(source).values())) / 1e3:.0f} kB in every file"),
    ]
    facts += [("mind", doubt) for doubt in doubts(scene.robot, model)]
    if wrong:
        return Report(wrong, facts)
    try:
        env = BatchEnv(scene, config, n=1, threads=1, start=start)
        facts += [*_drawn(env, draws), ("speed", _speed(env))]
    except CoordlogError as error:
        wrong.append(str(error))
    return Report(wrong, facts)


def _about(robot: Robot) -> str:
    arms = "; ".join(f"{arm.name}: {len(arm.joints)} joints to '{arm.palm}'" for arm in robot.arms)
    shared = f", {len(robot.shared)} shared" if robot.shared else ""
    feet = f", on {len(robot.soles)} soles" if robot.soles else ""
    return f"{arms}{shared}{feet}"


def _drawn(env: BatchEnv, draws: int) -> list[tuple[str, str]]:
    """The share of feasible draws and why the others are not.

    Raises:
        SimulationError: if none is.
    """
    for index in range(draws):
        env.problem(seed=0, split="train", index=index)
        if sum(env.draw.tally.values()) >= 4 * draws:
            break
    tally = env.draw.tally
    share = tally[FEASIBLE] / max(sum(tally.values()), 1)
    said = f"{share:.0%} of {sum(tally.values())} draws are feasible"
    return [("problems", said if share == 1.0 else f"{said}; the others: {env.draw.reasons()}")]


def _speed(env: BatchEnv) -> str:
    """Control steps a second of one simulation, with the robot at rest."""
    env.reset(np.array([0]), [env.problem(seed=0, split="train", index=0)])
    still = np.zeros((1, env.layout.n_u), dtype=np.float32)
    began = time.perf_counter()
    for _ in range(STEPS):
        env.step(still, np.array([0]))
    return f"{STEPS / (time.perf_counter() - began):,.0f} steps/s in one simulation"


def scarce(env: BatchEnv) -> str:
    """A sentence about draws that are seldom feasible; empty if they are not."""
    tally = env.draw.tally
    share = tally[FEASIBLE] / max(sum(tally.values()), 1)
    if share >= SCARCE or not tally:
        return ""
    return (
        f"only {share:.1%} of {sum(tally.values())} draws were feasible; the others: "
        f"{env.draw.reasons()}"
    )
