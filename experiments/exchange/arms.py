"""Other people's recordings of an arm with meshes: imported, smoothed, and looked at by strangers.

    python -m experiments.exchange.arms --files FOLDER --work FOLDER [--robot yam panda ur5e]

Noisy motions of the arm over a table are written with pyarrow as anybody would, and coordlog only
ever sees those files. What comes out is judged by nothing of ours: contacts by MuJoCo's own
collision at 16 samples a knot on scipy's Hermite cubic, jerk by third differences at the log's
times, deviation from the log's samples. Times are processor time of the commands, all their
processes and their start included.
"""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from scipy.interpolate import CubicHermiteSpline

from coordlog.episode import Array
from coordlog.record.reader import read_episode
from experiments.outside import ROBOTS, fetch, run

RATE, SECONDS, NOISE, ALIKE = 50.0, 3.0, 0.01, 0.5
"""Of a recording: samples a second, length [s], standard deviation of the noise [rad], and its
correlation from sample to sample."""
FINE = 16
FREE = 0.01
"""Distance that a motion keeps before noise is added [m]."""
TRIES = 5
"""Motions from one pose before another is taken."""
FARTHEST = 0.1
"""rad: the option of `coordlog smooth`."""


class Scene(NamedTuple):
    """An arm over a table, as a file, and the joints that were recorded."""

    file: Path
    model: mujoco.MjModel
    joints: list[str]

    @property
    def places(self) -> Array:
        """Of the joints in qpos."""
        return np.array([self.model.joint(name).qposadr[0] for name in self.joints])

    @property
    def rest(self) -> Array:
        """The first key frame, or zero."""
        return np.array(self.model.key_qpos[0] if self.model.nkey else self.model.qpos0)

    def together(self) -> set[tuple[int, int]]:
        """Pairs of geoms that no recorded joint moves against one another."""
        moved: list[frozenset[int]] = []
        recorded = {int(self.model.joint(name).id) for name in self.joints}
        for body in range(self.model.nbody):
            above = moved[self.model.body_parentid[body]] if body else frozenset()
            own = range(self.model.body_jntadr[body], self.model.body_jntadr[body] + 1)
            count = self.model.body_jntnum[body]
            moved.append(above | (recorded & set(own) if count else set()))
        of = [moved[body] for body in self.model.geom_bodyid]
        pairs = range(len(of))
        return {(i, j) for i in pairs for j in pairs if of[i] == of[j]}


def scene_of(name: str, files: Path) -> Scene:
    """The robot's own model, with a table and two posts beside it."""
    robot = next(each for each in ROBOTS if each.name == name)
    source = fetch(robot, files, None)
    spec = mujoco.MjSpec.from_file(str(source))
    box = mujoco.mjtGeom.mjGEOM_BOX
    reach = mujoco.MjModel.from_xml_path(str(source)).stat.extent
    spec.worldbody.add_geom(
        name="table", type=box, size=[reach, reach, 0.02], pos=[0, 0, -0.02 - 0.01]
    )
    for side in (-1, 1):
        spec.worldbody.add_geom(
            name=f"post_{side}",
            type=box,
            size=[0.03, 0.03, 0.3 * reach],
            pos=[0.45 * reach, 0.35 * reach * side, 0.3 * reach],
        )
    model = spec.compile()
    file = source.with_name(f"{name}_at_a_table.xml")
    file.write_text(spec.to_xml(), encoding="utf-8")
    hinge = mujoco.mjtJoint.mjJNT_HINGE
    joints = [model.joint(i).name for i in range(model.njnt) if model.jnt_type[i] == hinge]
    return Scene(file, model, joints)


class Touching:
    """MuJoCo's own collision detection, asked about configurations one by one."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.data = scene, mujoco.MjData(scene.model)
        self._together = scene.together()
        self._places = scene.places
        self._near: set[tuple[int, int]] = set()
        """Pairs that are nearer than `FREE` at rest: neighbours, which need only not touch."""
        self._near = {pair for pair, _ in self._found(scene.rest[scene.places], FREE)}

    def __call__(self, path: Array) -> int:
        """How many of the configurations touch something."""
        return sum(self._touches(row, 0.0) for row in path)

    def free(self, path: Array) -> bool:
        """Whether all of them keep `FREE` from everything; a look at every tenth comes first."""
        return not any(self._touches(row, FREE) for row in (*path[::10], *path))

    def _touches(self, row: Array, margin: float) -> bool:
        found = self._found(row, margin)
        return any(dist < 0.0 or pair not in self._near for pair, dist in found)

    def _found(self, row: Array, margin: float) -> list[tuple[tuple[int, int], float]]:
        """Pairs nearer than a margin, and their distances [m]."""
        model, data = self.scene.model, self.data
        model.geom_margin[:] = margin
        data.qpos[:] = self.scene.rest
        data.qpos[self._places] = row
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        pairs = map(tuple, data.contact.geom.tolist())
        found = zip(pairs, data.contact.dist.tolist(), strict=True)
        return [item for item in found if item[1] < margin and item[0] not in self._together]


def motion(scene: Scene, touching: Touching, rng: np.random.Generator) -> Array:
    """A free motion by three free poses: a parabola, at rest at both ends."""
    low, high = np.array([scene.model.joint(name).range for name in scene.joints]).T
    count = int(RATE * SECONDS) + 1
    at = np.linspace(0.0, 1.0, count)
    blend = at**3 * (10.0 - 15.0 * at + 6.0 * at**2)

    def pose(near: Array | None) -> Array:
        while True:
            found = rng.uniform(low, high) if near is None else rng.normal(near, 0.4)
            found = low + 0.1 + np.clip(found - low - 0.1, 0.0, high - low - 0.2)
            if touching.free(found[None]):
                return np.asarray(found)

    while True:
        first = pose(None)
        for _ in range(TRIES):
            second, third = pose(first), pose(first)
            path = first + blend[:, None] * (third - first)
            path += (4.0 * blend * (1.0 - blend))[:, None] * (second - 0.5 * (first + third))
            inside = (path > low + 0.05).all() and (path < high - 0.05).all()
            if inside and touching.free(path):
                return np.asarray(path)


def recordings(scene: Scene, touching: Touching, folder: Path, count: int) -> list[Array]:
    """Noisy recordings as Parquet files; their samples."""
    rng, kept = np.random.default_rng(0), []
    folder.mkdir(parents=True)
    for i in range(count):
        path = motion(scene, touching, rng)
        noise, last = np.empty_like(path), np.zeros(path.shape[1])
        for k in range(len(path)):
            last = ALIKE * last + np.sqrt(1.0 - ALIKE**2) * rng.normal(0.0, NOISE, len(last))
            noise[k] = last
        path = path + noise
        stamps = np.arange(len(path)) / RATE + rng.uniform(-5e-4, 5e-4, len(path))
        columns = {"time": np.round((1.7e9 + stamps) * 1e9).astype(np.int64)}
        columns |= {name: path[:, j] for j, name in enumerate(scene.joints)}
        pq.write_table(pa.table(columns), folder / f"run_{i:03d}.parquet")
        kept.append(path)
    return kept


class Judged(NamedTuple):
    """What strangers say of one smoothed episode."""

    touching: int
    jerk: float
    """of the path, a share of the log's"""
    away: float


def judged(file: Path, log: Array, touching: Touching) -> Judged:
    """An episode's path, compared with the recording it came from."""
    episode = read_episode(file)
    path = episode.path
    if path is None:
        return Judged(touching(log), 1.0, 0.0)
    spline = CubicHermiteSpline(path.time, path.position, path.velocity)
    last = len(episode.time) - 1
    fine = np.interp(np.arange(FINE * last + 1) / FINE, np.arange(last + 1), episode.time)
    there = spline(episode.time)
    jerk = [np.sqrt(np.mean(np.diff(each, n=3, axis=0) ** 2)) for each in (log, there)]
    return Judged(touching(spline(fine)), jerk[1] / jerk[0], float(abs(there - log).max()))


def go(name: str, files: Path, work: Path, count: int) -> str:
    """One robot's line."""
    scene = scene_of(name, files)
    touching = Touching(scene)
    place = work / name
    shutil.rmtree(place, ignore_errors=True)
    logs = recordings(scene, touching, place / "theirs", count)
    theirs = sorted((place / "theirs").iterdir())
    imported = run("import", *theirs, "--robot", scene.file, "--out", place / "in", "--json")
    if imported.code:
        return f"| {name} | import: {imported.said} |"
    order = [Path(each["episodes"][0]) for each in json.loads(imported.printed)]
    arguments = ("--max-deviation", FARTHEST, "--json")
    smooth = run("smooth", place / "in", "--out", place / "out", *arguments)
    report = json.loads(smooth.printed)
    found = [
        judged(place / "out" / file.name, log, touching)
        for file, log in zip(order, logs, strict=True)
    ]
    jerk = np.array([each.jerk for each in found])
    before = sum(touching(log) > 0 for log in logs)
    hour = 3600.0 * count / ((imported.seconds + smooth.seconds) / 2.0)
    return (
        f"| {name}, {len(scene.joints)} joints | {count} of {len(logs[0])} samples, {before} touch "
        f"| {report['statuses']}, certified {report['certified']} "
        f"| {sum(each.touching > 0 for each in found)} | {np.median(jerk):.4f}, {jerk.max():.4f} "
        f"| {max(each.away for each in found):.3f} rad | {hour:,.0f} "
        f"({imported.seconds / count * 1e3:.0f} + {smooth.seconds / count * 1e3:.0f} ms) |"
    )


def main() -> None:
    """Print the table, a robot at a time."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=Path, required=True)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--robot", nargs="+", default=["yam"])
    parser.add_argument("--count", type=int, default=200)
    asked = parser.parse_args()
    print(
        "| arm | recordings | smoothed | still touch | jerk, share of the log's: median, most "
        "| farthest from a sample | an hour on two cores (import + smooth) |\n" + "|---" * 7 + "|"
    )
    for name in asked.robot:
        print(go(name, asked.files, asked.work, asked.count), flush=True)


if __name__ == "__main__":
    main()
