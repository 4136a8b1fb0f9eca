"""Bags as a ROS 2 system would leave them, written by rosbags."""

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.LATEST)
T = STORE.types
START = 1_700_000_000_000_000_000
NAMES = ("shoulder", "elbow", "wrist")
JOINT_STATE = "sensor_msgs/msg/JointState"


def stamp(ns):
    return T["builtin_interfaces/msg/Time"](sec=int(ns // 10**9), nanosec=int(ns % 10**9))


def joint_state(ns, names, position, velocity=()):
    header = T["std_msgs/msg/Header"](stamp=stamp(ns), frame_id="base")
    message = T[JOINT_STATE](
        header=header,
        name=list(names),
        position=np.array(position, float),
        velocity=np.array(velocity, float),
        effort=np.zeros(0),
    )
    return bytes(STORE.serialize_cdr(message, JOINT_STATE))


def recorded(rng, n=200, names=NAMES):
    """100 Hz with 1 ms of jitter and a gap of 0.4 s in the middle: stamps [ns] and positions."""
    seconds = np.sort(np.arange(n) / 100 + rng.normal(0, 1e-3, n).clip(-4e-3, 4e-3))
    seconds[n // 2 :] += 0.4
    stamps = START + np.rint(seconds * 1e9).astype(np.int64)
    phase = seconds[:, None] * (1 + 0.3 * np.arange(len(names)))
    return stamps, 0.4 * np.sin(phase) + rng.normal(0, 1e-3, (n, len(names)))


def write_bag(
    path, stamps, position, *, rng=None, names=NAMES, storage="mcap", topic="/joint_states"
):
    """A bag of joint states; with an rng the joints of each message are shuffled."""
    plugin = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}[storage]
    with Writer(path, version=9, storage_plugin=plugin) as bag:
        channel = bag.add_connection(topic, JOINT_STATE, typestore=STORE)
        text = bag.add_connection("/rosout", "std_msgs/msg/String", typestore=STORE)
        for i, (ns, row) in enumerate(zip(stamps.tolist(), position, strict=True)):
            order = np.arange(len(names)) if rng is None else rng.permutation(len(names))
            data = joint_state(ns, [names[k] for k in order], row[order])
            bag.write(channel, ns + 2_000_000, data)
            if i % 7 == 0:
                said = T["std_msgs/msg/String"](data=f"line {i}")
                bag.write(text, ns + 2_000_001, STORE.serialize_cdr(said, "std_msgs/msg/String"))
    return path
