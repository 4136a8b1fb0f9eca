"""What showing an episode costs, as ratios measured in one run.

    python experiments/speed/bench_view.py [FOLDER] [--episodes 1000] [--json FILE]

FOLDER holds real logs, read as often as it takes to make up the number of episodes; without it an
episode of each scene is simulated. Columns are compared with logging the same moving content step
by step, in two ways: into the same few entities, and as tutorials do it, an entity per geom, curve
and flag. All start from worked-out poses; the columns include what is logged once. `whole` is
`to_rerun` with everything: compiling the model, kinematics, blueprint. The fastest of several turns
counts (CPU time, all threads).
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import rerun as rr

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "view"))

from recordings import rolled_out, with_path

from coordlog.episode import Array
from coordlog.kinematics.geometry import Geom
from coordlog.record.dataset import find_files
from coordlog.record.reader import read_attachments, read_episode
from coordlog.view.camera import camera
from coordlog.view.draft import Draft
from coordlog.view.overview import to_overview
from coordlog.view.plots import plot
from coordlog.view.recording import new_stream, to_rerun
from coordlog.view.scene import draw
from coordlog.view.show import Show, Stage, stages
from coordlog.view.solids import ARCHETYPES

ROUNDS = 5
TURN = 0.25
"""A turn lasts at least this long [s]."""
LED_TO = (
    "action",
    "reward",
    "distance",
    "boundary",
    "goal",
    "collision",
    "instability",
    "terminated",
    "truncated",
)

Row = dict[str, float | str]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    files = find_files(options.folder).paths if options.folder else ()
    raw = show_of(files[0]) if files else rolled_out("table", steps=150)
    with tempfile.TemporaryDirectory() as folder:
        rows = [*building(raw, Path(folder)), overview(files, options.episodes, Path(folder))]
    for row in rows:
        print(
            "  ".join(
                f"{name} {value:.4g}" if isinstance(value, float) else str(value)
                for name, value in row.items()
            )
        )
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def building(raw: Show, folder: Path) -> list[Row]:
    """Columns against steps, for an episode and for one of eight times its length.

    The whole conversion; the size on disk.
    """
    rows: list[Row] = []
    for show in (raw, stretched(raw, 8)):
        stage, steps = stages([show])[0], len(show.episode)
        eye = camera([stage]).eye
        ways = {
            "columns": partial(by_columns, eye=eye),
            "into the same entities": by_steps,
            "an entity each": by_entities,
        }
        seconds = in_turns({name: partial(build, stage) for name, build in ways.items()})
        columns = seconds.pop("columns")
        rows.append(
            {
                "what": f"{steps} steps as columns",
                "ms": 1e3 * columns,
                "us_per_step": 1e6 * columns / steps,
            }
        )
        for name, taken in seconds.items():
            what = f"{steps} steps one by one, {name}"
            rows.append(
                {
                    "what": what,
                    "ms": 1e3 * taken,
                    "us_per_step": 1e6 * taken / steps,
                    "times": taken / columns,
                }
            )
    for name, show in (
        ("raw", raw),
        ("with knots and spline", with_path(raw, np.random.default_rng(7))),
    ):
        whole = in_turns({"whole": partial(to_rerun, [show])})["whole"]
        rows.append(
            {
                "what": f"whole, {name}",
                "ms": 1e3 * whole,
                "kB": save(to_rerun([show]), folder / "a.rrd") / 1e3,
            }
        )
    return rows


def stretched(show: Show, times: int) -> Show:
    """The same motion several times in a row."""
    episode = show.episode
    columns = {name: np.concatenate([getattr(episode, name)] * times) for name in LED_TO}
    states = {
        name: np.concatenate([*[getattr(episode, name)[:-1]] * times, getattr(episode, name)[-1:]])
        for name in ("qpos", "qvel", "state")
    }
    time = np.arange(len(columns["action"]) + 1) * 0.04
    return replace(show, episode=replace(episode, time=time, **columns, **states))


def by_columns(stage: Stage, eye: Array) -> rr.RecordingStream:
    """The package's way, static content included."""
    stream, draft = new_stream("columns"), Draft()
    draw(draft, stage, eye)
    plot(draft, stage)
    draft.send(stream)
    return stream


def by_steps(stage: Stage) -> rr.RecordingStream:
    """The moving content, a row at a time into the entities that the columns go to."""
    stream, episode, motion = new_stream("steps"), stage.episode, stage.motion
    kinds = {
        kind: [geom.index for geom in robot_geoms(stage) if geom.kind == kind]
        for kind in ARCHETYPES
    }
    support = motion.support()
    for t in range(len(episode) + 1):
        stream.set_time("sim_time", duration=float(episode.time[t]))
        for kind, index in kinds.items():
            if index:
                place, turned = (
                    motion.position[t, index],
                    np.roll(motion.quaternion[t, index], -1, axis=-1),
                )
                pose = {
                    "translations" if kind == "capsule" else "centers": place,
                    "quaternions": turned,
                }
                stream.log(f"world/robot/{kind}", ARCHETYPES[kind].from_fields(**pose))
        for i, arm in enumerate(stage.arms):
            stream.log(f"world/palm/{arm}", rr.Points3D(motion.palms[t, i]))
        log_balance(stream, motion.com[t], support[t])
        for group, index in stage.groups.items():
            stream.log(f"joint/{group}", rr.Scalars(episode.qpos[t, stage.geometry.joints[index]]))
            if t < len(episode):
                stream.log(f"action/{group}", rr.Scalars(episode.action[t, index]))
        if t:
            stream.log("reward", rr.Scalars(episode.reward[t - 1]))
            stream.log("distance", rr.Scalars(episode.distance[t - 1]))
            stream.log("log_distance", rr.Scalars(np.log10(episode.distance[t - 1])))
            log_flags(stream, stage, t)
    return stream


def by_entities(stage: Stage) -> rr.RecordingStream:
    """The moving content with a transform per geom and an entity per curve."""
    stream, episode, motion = new_stream("entities"), stage.episode, stage.motion
    geoms, support = robot_geoms(stage), motion.support()
    for t in range(len(episode) + 1):
        stream.set_time("sim_time", duration=float(episode.time[t]))
        for geom in geoms:
            turned = np.roll(motion.quaternion[t, geom.index], -1)
            stream.log(
                f"robot/{geom.name}",
                rr.Transform3D(translation=motion.position[t, geom.index], quaternion=turned),
            )
        log_balance(stream, motion.com[t], support[t])
        for name, value in zip(
            stage.robot.action_joints, episode.qpos[t, stage.geometry.joints], strict=True
        ):
            stream.log(f"joint/{name}", rr.Scalars(value))
        if t < len(episode):
            for name, value in zip(stage.robot.action_joints, episode.action[t], strict=True):
                stream.log(f"action/{name}", rr.Scalars(value))
        for i, arm in enumerate(stage.arms):
            stream.log(f"palm/{arm}", rr.Points3D(motion.palms[t, i]))
            if t:
                stream.log(f"reward/{arm}", rr.Scalars(episode.reward[t - 1, i]))
                stream.log(f"distance/{arm}", rr.Scalars(episode.distance[t - 1, i]))
                stream.log(f"log_distance/{arm}", rr.Scalars(np.log10(episode.distance[t - 1, i])))
        if t:
            log_flags(stream, stage, t)
    return stream


def log_balance(stream: rr.RecordingStream, com: Array, support: Array) -> None:
    ground = com * [1.0, 1.0, 0.0]
    outline = np.concatenate([support, np.zeros((len(support), 1))], axis=1)
    stream.log("world/balance/mass", rr.Points3D([com, ground]))
    stream.log("world/balance/plumb", rr.LineStrips3D([[com, ground]]))
    stream.log("world/balance/support", rr.LineStrips3D([outline]))


def log_flags(stream: rr.RecordingStream, stage: Stage, t: int) -> None:
    """The flags that change at state t."""
    episode = stage.episode
    for name in ("collision", "instability", "boundary", "goal"):
        now = np.atleast_1d(getattr(episode, name)[t - 1])
        before = np.atleast_1d(getattr(episode, name)[t - 2]) if t > 1 else ~now
        for i in np.flatnonzero(now != before):
            stream.log(f"flag/{name}/{i}", rr.StateChange(state="yes" if now[i] else "no"))


def robot_geoms(stage: Stage) -> list[Geom]:
    return [geom for geom in stage.geometry.geoms if geom.place == "robot"]


def overview(files: tuple[Path, ...], count: int, folder: Path) -> Row:
    """The overview of many episodes, reading included, by the clock on the wall."""

    def shows() -> Iterator[Show]:
        if not files:
            ready = [
                rolled_out(scene, steps=150) for scene in ("free", "spheres", "table", "shelf")
            ]
        for i in range(count):
            if files:
                yield show_of(files[i % len(files)], first=i == 0)
            else:
                yield ready[i % len(ready)]

    begin = time.perf_counter()
    size = save(to_overview(shows()), folder / "overview.rrd")
    seconds = time.perf_counter() - begin
    return {
        "what": f"overview of {count} episodes",
        "s": seconds,
        "MB": size / 1e6,
        "ms_per_episode": 1e3 * seconds / count,
    }


def show_of(path: Path, *, first: bool = True) -> Show:
    return Show(path.stem, read_episode(path), read_attachments(path) if first else {}, str(path))


def finish(stream: rr.RecordingStream) -> None:
    stream.flush()
    stream.disconnect()


def save(stream: rr.RecordingStream, path: Path) -> int:
    stream.save(path)
    finish(stream)
    return path.stat().st_size


def in_turns(builds: Mapping[str, Callable[[], rr.RecordingStream]]) -> dict[str, float]:
    """Processor time [s] of each at its fastest, taking turns.

    The short ones are repeated within a turn.
    """
    times: dict[str, list[float]] = {name: [] for name in builds}
    for _ in range(ROUNDS):
        for name, build in builds.items():
            left = TURN
            while left > 0.0:
                start = time.process_time()
                finish(build())
                times[name].append(time.process_time() - start)
                left -= times[name][-1]
    return {name: min(taken) for name, taken in times.items()}


if __name__ == "__main__":
    main()
