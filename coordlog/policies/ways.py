"""Where the scripted expert looks first: ways round that are known for a robot, and postures that
goals are searched from.
"""

from __future__ import annotations

import numpy as np

from coordlog.episode import Array
from coordlog.kinematics.ik import Reach
from coordlog.sim.task import BoundTask
from coordlog.tasks.goals import MIDDLE, anywhere

VIA_JOINTS = ("shoulder_x", "shoulder_y", "arm_z", "elbow_y")
"""Joints of each side that the known via poses bend."""
SURVEYED = 64
"""Goals that postures are judged by."""
STRANGE = 12
"""Random postures that are tried where no other finds nearly all of them."""
NEARLY = 0.97
"""Share of them that nearly all are."""
VIAS = 12
"""Postures that are tried as a way's first end where straight ways touch the robot too often."""


def postures(reach: Reach) -> list[Array]:
    """Postures from which nearly all goals are found, as few as do; none if the robot's named ones
    do.

    An expert that ends in a posture of chance wherever a search fails cannot be learnt from: where
    its palms go says nothing then of where its joints do. From arms that hang, three searches of
    ten may get stuck at the limits of joints that were turned the wrong way.
    """
    rng = np.random.default_rng(0)
    goals = surveyed(reach, rng)
    if not goals or np.mean([reach.solve(goal) is not None for goal in goals]) >= NEARLY:
        return []
    middle, half = reach.limits.mean(axis=1), np.ptp(reach.limits, axis=1) / 2
    strange = rng.uniform(middle - MIDDLE * half, middle + MIDDLE * half, (STRANGE, len(middle)))
    tried = [*reach.seeds, (reach.standing_angles + middle) / 2, middle, *strange]
    rows: list[list[bool]] = []
    for seed in tried:
        rows.append([reach.solve(goal, seed=seed) is not None for goal in goals])
        if np.mean(rows[-1]) >= NEARLY:
            return [seed]
    found, chosen = np.array(rows), list[Array]()
    while found.any():
        best = int(found.sum(axis=1).argmax())
        chosen.append(tried[best])
        found &= ~found[best]
    return chosen


def surveyed(reach: Reach, rng: np.random.Generator) -> list[Array]:
    """Goals like those of an episode."""
    drawn = [anywhere(rng, reach) for _ in range(SURVEYED)]
    return [goal for goal in drawn if goal is not None]


def found_ways(
    task: BoundTask, reach: Reach, seeds: list[Array], *, own: float
) -> list[list[Array]]:
    """The one way that a robot goes whose ways nobody knows: straight if nearly all goals can be
    reached so without coming close to itself, else by way of one posture.

    One and the same for every goal: a detour that is drawn anew for each cannot be learnt.

    Args:
        task: Joint speeds; slow joints take part in a detour by as much less.
        reach: Kinematics; the ways begin where the robot stands.
        seeds: Postures that goals are searched from; without any, the robot's named ones.
        own: Clearance of last links and fingers from the robot itself [m].
    """
    start, ends = reach.standing_angles, list[Array]()
    begun: list[Array | None] = [*seeds] or [None]
    for goal in surveyed(reach, np.random.default_rng(0)):
        found = (reach.solve(goal, seed=seed) for seed in begun)
        ends += [end for end in found if end is not None][:1]

    def share(way: list[Array]) -> float:
        """Of the ends that are reached this way."""
        if way and not reach.free(start, way[0], clearance=0.0, own=own):
            return 0.0
        by = [start, *way][-1]
        return float(np.mean([reach.free(by, end, clearance=0.0, own=own) for end in ends]))

    best: list[Array] = []
    if not ends or (most := share(best)) >= NEARLY:
        return [best]
    middle, fast = np.mean(ends, axis=0), task.speeds / task.speeds.max()
    for towards in [middle, *ends[:VIAS]]:
        via = start + fast * ((middle + towards) / 2 - start)
        if most < NEARLY and (reached := share([via])) > most:
            best, most = [via], reached
    return [best]


def known_ways(task: BoundTask) -> list[list[Array]]:
    """Known ways from arms hanging to hands in front, as lists of via postures; none for a robot
    with other joints.
    """
    joints = task.robot.action_joints
    if not {f"{side}_{name}" for side in "lr" for name in VIA_JOINTS} <= set(joints):
        return []

    def posture(**degrees: float) -> Array:
        angles = np.zeros(len(joints))
        for name, value in degrees.items():
            angles[joints.index(f"l_{name}")] = np.radians(value)
            angles[joints.index(f"r_{name}")] = np.radians(
                -value if name in ("shoulder_x", "arm_z") else value
            )
        return angles

    home = posture(shoulder_x=20, elbow_y=-90)
    out = posture(shoulder_x=75, elbow_y=-130)
    wide = posture(shoulder_x=45, elbow_y=-110)
    folded = posture(shoulder_x=25, shoulder_y=30, elbow_y=-140)
    high = posture(shoulder_x=30, shoulder_y=-40, elbow_y=-120)
    return [
        [folded, home],
        [out, home],
        [folded, high],
        [out, high],
        [out, wide],
        [out, wide, high],
    ]
