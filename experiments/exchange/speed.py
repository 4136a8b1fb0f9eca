"""What coming in, going out and rendering cost, in processor time.

    python -m experiments.exchange.speed LOGS

Prints for each format the time of an episode of 110 steps, read and written; for bags of ten
minutes of joint states the time to import them and to play them message by message with rosbags; and frames a second of
three cameras of 224 × 224 against bare `mujoco.Renderer` calls on the same states. The best of some
repetitions, for the machine is seldom idle. MUJOCO_GL chooses egl or osmesa.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from itertools import islice, product
from pathlib import Path

import mujoco
import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from coordlog.exchange import FORMATS
from coordlog.exchange.blocks import STORAGES, Options, export
from coordlog.exchange.cameras import frames
from coordlog.exchange.importing import Plan, import_source, understood
from coordlog.exchange.source import Entry, Loaded, entries
from coordlog.mjcf import load_attached

STEPS = 110
STATES = 8
"""Of an episode that are rendered: software GL is slow."""
JOINT_STATE = "sensor_msgs/msg/JointState"
CAMERAS = tuple(f"pos={x},-1.2,1.6 lookat=0,0,1" for x in (-1, 0, 1))


def cpu(work: Callable[[], object], *, times: int = 3) -> float:
    """Least processor time of some runs [s]."""
    least = np.inf
    for _ in range(times):
        start = time.process_time()
        work()
        least = min(least, time.process_time() - start)
    return float(least)


def exporting(chosen: list[Entry], work: Path) -> None:
    """A line for each format."""
    steps = sum(entry.result.length for entry in chosen)
    for to in FORMATS:
        for storage in STORAGES if to == "rosbag2" else ("mcap",):
            options = Options(to, storage=storage)
            least = cpu(partial(export, chosen, work / "set", options, force=True))
            name = f"{to} {storage}" if to == "rosbag2" else to
            print(f"export {name}: {least / steps * STEPS * 1e3:.1f} ms", flush=True)


def importing(work: Path, *, minutes: int = 10) -> None:
    """A line for each storage of a bag at 100 Hz, and each number of joints."""
    for joints, plugin in product((7, 30), (StoragePlugin.MCAP, StoragePlugin.SQLITE3)):
        path, count = work / f"{plugin.name}-{joints}", minutes * 6000
        write_bag(path, plugin, count, joints)
        played = cpu(partial(play, path), times=2)
        read = cpu(lambda path=path: list(understood(path, Plan(), None)))
        out = work / "in"
        whole = cpu(partial(import_source, path, out, Plan(), None, force=True))
        print(
            f"import {plugin.name.lower()}, {joints} joints, {minutes} minutes: "
            f"{whole / count * 1e6:.1f} µs a message, {played / whole:.1f} × as fast as playing; "
            f"read {read / count * 1e6:.1f} µs, {played / read:.1f} ×; "
            f"played {played / count * 1e6:.1f} µs",
            flush=True,
        )


def write_bag(path: Path, plugin: StoragePlugin, count: int, joints: int) -> None:
    """A bag of joint states at 100 Hz with 1 ms of jitter, positions and velocities."""
    types = get_typestore(Stores.LATEST)
    rng = np.random.default_rng(0)
    position = np.cumsum(rng.normal(0, 0.01, (count, joints)), axis=0)
    velocity = np.gradient(position, 0.01, axis=0)
    stamps = np.arange(count) * 10**7 + rng.integers(0, 10**6, count)
    names = [f"joint_{i}" for i in range(joints)]
    with Writer(path, version=9, storage_plugin=plugin) as bag:
        channel = bag.add_connection("/joint_states", JOINT_STATE, typestore=types)
        for ns, row, speed in zip(stamps.tolist(), position, velocity, strict=True):
            stamp = types.types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
            header = types.types["std_msgs/msg/Header"](stamp=stamp, frame_id="base")
            message = types.types[JOINT_STATE](
                header=header, name=names, position=row, velocity=speed, effort=np.zeros(0)
            )
            bag.write(channel, ns, types.serialize_cdr(message, JOINT_STATE))


def play(path: Path) -> None:
    """Every message of a bag, decoded in Python."""
    with AnyReader([path]) as bag:
        for connection, _, data in bag.messages():
            bag.deserialize(data, connection.msgtype)


def rendering(path: Path) -> None:
    """Frames a second of three cameras, replayed and proven, and of bare renderer calls."""
    loaded = Loaded(path)
    options = Options("lerobot", CAMERAS, 224, 224)
    ours = cpu(lambda: list(islice(frames(loaded, options), STATES)), times=2)
    model = load_attached(loaded.attachments)
    data = mujoco.MjData(model)
    views = [mujoco.MjvCamera() for _ in CAMERAS]
    for view in views:
        view.distance, view.elevation, view.lookat[:] = 2.0, -20, (0, 0, 1)

    def bare() -> None:
        with mujoco.Renderer(model, 224, 224) as renderer:
            for qpos in loaded.episode.qpos[:STATES]:
                data.qpos[:] = qpos
                mujoco.mj_forward(model, data)
                for view in views:
                    renderer.update_scene(data, view)
                    renderer.render()

    others = cpu(bare, times=2)
    count = STATES * len(CAMERAS)
    print(
        f"render: {count / ours:.0f} frames a second of processor time, replay proven; bare "
        f"mujoco.Renderer {count / others:.0f}; {others / ours:.2f} ×"
    )


def main() -> None:
    """Print all three tables."""
    chosen, _ = entries([Path(each) for each in sys.argv[1:]])
    rendering(chosen[0].path)
    with tempfile.TemporaryDirectory() as work:
        exporting(chosen, Path(work))
        importing(Path(work))


if __name__ == "__main__":
    main()
