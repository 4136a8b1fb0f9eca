"""Other programs' files, written by their own libraries, give the motion that was put in."""

import json
import os
import struct

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from coordlog.errors import ConfigError, FormatError, StorageError
from coordlog.exchange.blocks import Options, export
from coordlog.exchange.source import entries
from coordlog.exchange.sources import Reading, digest_of, kind_of, motions
from tests.exchange.bags import (
    JOINT_STATE,
    NAMES,
    START,
    STORE,
    T,
    joint_state,
    recorded,
    write_bag,
)


def read(path, **reading):
    return list(motions(path, Reading(**reading)))


def refused(path, said, error=FormatError, **reading):
    with pytest.raises(error, match=said) as caught:
        read(path, **reading)
    assert "\n" not in str(caught.value)
    return caught


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("shuffled", [False, True])
def test_a_bag_gives_every_joint_state(tmp_path, rng, storage, shuffled):
    stamps, position = recorded(rng)
    order = np.random.default_rng(1) if shuffled else None
    write_bag(tmp_path / "bag", stamps, position, rng=order, storage=storage)
    (found,) = read(tmp_path / "bag")
    assert sorted(found.names) == sorted(NAMES)
    columns = [found.names.index(name) for name in NAMES]
    np.testing.assert_array_equal(found.position[:, columns], position)
    np.testing.assert_array_equal(found.stamps, stamps)
    assert found.clock == "header stamps"
    assert found.timing.gaps[0][0] == 99
    (late,) = read(tmp_path / "bag", stamps="log")
    np.testing.assert_array_equal(late.stamps, stamps + 2_000_000)


def test_a_bare_file_of_a_bag_is_a_bag(tmp_path, rng):
    stamps, position = recorded(rng, 20)
    for storage, name in (("mcap", "bag.mcap"), ("sqlite3", "lite.db3")):
        folder = write_bag(tmp_path / name.split(".")[0], stamps, position, storage=storage)
        assert kind_of(folder / name) == "rosbag2"
        (found,) = read(folder / name)
        np.testing.assert_array_equal(found.position, position)


def test_velocities_are_taken_where_every_message_has_them(tmp_path):
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        channel = bag.add_connection("/js", JOINT_STATE, typestore=STORE)
        for i in range(5):
            bag.write(channel, i, joint_state(START + i, ["a", "b"], [i, -i], [1, 2]))
    (found,) = read(tmp_path / "bag")
    assert found.velocity.tolist() == [[1, 2]] * 5


def test_trajectories_and_other_joint_messages_are_read_too(tmp_path):
    from coordlog.episode import Path as JointPath
    from coordlog.exchange.rosbag2 import TRAJECTORY, trajectory

    time = np.array([0.0, 0.1, 0.25])
    path = JointPath(time, np.zeros((3, 2)), np.ones(3), time, np.eye(3, 2), np.ones((3, 2)))
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        channel = bag.add_connection("/plan", TRAJECTORY, typestore=STORE)
        bag.write(channel, START, trajectory(path, ["a", "b"]))
    (found,) = read(tmp_path / "bag")
    np.testing.assert_array_equal(found.position, np.eye(3, 2))
    assert (found.stamps - START).tolist() == [0, 100_000_000, 250_000_000]


def test_a_bag_without_joints_or_with_two_robots_says_what_it_has(tmp_path, rng):
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        channel = bag.add_connection("/rosout", "std_msgs/msg/String", typestore=STORE)
        said = T["std_msgs/msg/String"](data="hello")
        bag.write(channel, 1, STORE.serialize_cdr(said, "std_msgs/msg/String"))
    refused(tmp_path / "bag", r"got /rosout \(std_msgs/msg/String\): there is no joint motion")
    refused(tmp_path / "bag", "no joint motion on '/x'", ConfigError, topic="/x")
    with Writer(tmp_path / "two", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        for topic in ("/left", "/right"):
            channel = bag.add_connection(topic, JOINT_STATE, typestore=STORE)
            bag.write(channel, 1, joint_state(START, ["a"], [0.0]))
    refused(tmp_path / "two", "choose one with --topic: /left, /right", ConfigError)
    assert len(read(tmp_path / "two", topic="/left")) == 1


def test_a_topic_that_two_publishers_share_is_refused(tmp_path):
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        channel = bag.add_connection("/js", JOINT_STATE, typestore=STORE)
        bag.write(channel, 1, joint_state(START, ["a", "b"], [0, 0]))
        bag.write(channel, 2, joint_state(START + 1, ["a", "c"], [0, 0]))
    refused(
        tmp_path / "bag",
        "message 1: expected the joints of the first message, got a message without b and with c",
    )


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_bag_that_was_cut_off_is_one_sentence(tmp_path, rng, storage):
    stamps, position = recorded(rng, 50)
    write_bag(tmp_path / "bag", stamps, position, storage=storage)
    (file,) = [path for path in (tmp_path / "bag").iterdir() if path.suffix != ".yaml"]
    whole = file.read_bytes()
    for size in (0, 5, len(whole) // 2, len(whole) - 20):
        file.write_bytes(whole[:size])
        with pytest.raises(FormatError) as caught:
            read(tmp_path / "bag")
        assert str(caught.value).startswith(str(tmp_path / "bag"))
    file.unlink()
    refused(tmp_path / "bag", "missing")


def test_messages_compressed_one_by_one_are_refused(tmp_path):
    from rosbags.rosbag2.enums import CompressionFormat, CompressionMode

    bag = Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3)
    bag.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with bag:
        channel = bag.add_connection("/js", JOINT_STATE, typestore=STORE)
        bag.write(channel, 1, joint_state(START, ["a"], [0.0]))
    refused(tmp_path / "bag", "got each compressed by itself: `ros2 bag convert`")


def mcap_file(path, encoding, schema, messages):
    from mcap.writer import Writer as McapWriter

    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start()
        number = writer.register_schema(*schema)
        channel = writer.register_channel("/joints", encoding, number)
        for i, data in enumerate(messages):
            writer.add_message(channel, START + i * 10**7, data, START)
        writer.finish()


@pytest.mark.parametrize("nested", [False, True])
def test_json_messages_of_any_shape_are_read(tmp_path, nested):
    def message(i):
        if nested:
            pairs = [{"name": "a", "position": i}, {"name": "b", "position": -i}]
            return {"arm": {"joints": pairs}}
        return {"name": ["a", "b"], "position": [i, -i]}

    data = [json.dumps(message(i)).encode() for i in range(5)]
    mcap_file(tmp_path / "x.mcap", "json", ("Joints", "jsonschema", b"{}"), data)
    assert kind_of(tmp_path / "x.mcap") == "mcap"
    fields = (
        {"names_field": "arm.joints.name", "position_field": "arm.joints.position"}
        if nested
        else {}
    )
    (found,) = read(tmp_path / "x.mcap", **fields)
    assert found.names == ("a", "b")
    assert found.position[:, 1].tolist() == [0, -1, -2, -3, -4]
    assert (found.stamps - START).tolist() == [i * 10**7 for i in range(5)]
    if nested:
        refused(tmp_path / "x.mcap", "name the fields with --names-field", ConfigError)


def test_protobuf_messages_are_read_by_their_own_description(tmp_path):
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    file = descriptor_pb2.FileDescriptorProto(name="joints.proto", syntax="proto3")
    kind = file.message_type.add(name="Joints")
    repeated = descriptor_pb2.FieldDescriptorProto.LABEL_REPEATED
    kind.field.add(name="name", number=1, type=9, label=repeated)
    kind.field.add(name="position", number=2, type=1, label=repeated)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    message = message_factory.GetMessageClass(pool.FindMessageTypeByName("Joints"))
    data = [message(name=["a"], position=[i / 3]).SerializeToString() for i in range(4)]
    files = descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()
    mcap_file(tmp_path / "x.mcap", "protobuf", ("Joints", "protobuf", files), data)
    (found,) = read(tmp_path / "x.mcap")
    assert found.position[:, 0].tolist() == [0, 1 / 3, 2 / 3, 1]


@pytest.mark.parametrize("to", ["lerobot", "lerobot2.1"])
def test_a_lerobot_set_gives_its_episodes_by_number(logs, tmp_path, to):
    import coordlog

    export(entries([logs])[0], tmp_path / "set", Options(to))
    found = read(tmp_path / "set", state="observation.qpos", action="action")
    for i, (motion, episode) in enumerate(zip(found, coordlog.open(logs), strict=True)):
        np.testing.assert_array_equal(motion.position, episode.qpos[:-1])
        assert motion.names == ("joint_0", "joint_1")
        assert motion.where["episode"] == i
        assert motion.task == f"reach the goals ({episode.header.episode['scene']})"
        np.testing.assert_array_equal(motion.stamps, np.arange(len(episode)) * 40_000_000)


def test_a_lerobot_set_with_a_hole_or_a_missing_file_is_refused_and_nothing_is_fetched(
    logs, tmp_path, monkeypatch
):
    import socket

    def never(*_args, **_kwargs):
        raise AssertionError("the network was reached for")

    monkeypatch.setattr(socket.socket, "connect", never)
    export(entries([logs])[0], tmp_path / "set", Options("lerobot2.1"))
    files = sorted((tmp_path / "set" / "data").rglob("*.parquet"))
    files[3].rename(tmp_path / "aside.parquet")
    refused(tmp_path / "set", "episode_000003.parquet: missing, though", state="observation.qpos")
    (tmp_path / "aside.parquet").rename(files[3])
    lines = tmp_path / "set" / "meta" / "episodes.jsonl"
    kept = lines.read_text().splitlines()
    lines.write_text("\n".join(kept[:2] + kept[3:]) + "\n")
    refused(tmp_path / "set", "expected episode 2, got 3: the set has a gap", state="action")
    refused(tmp_path / "set", "choose one with --state: observation.state", ConfigError, state="x")


@pytest.mark.parametrize("to", ["minari", "robomimic"])
def test_hdf5_sets_give_positions_of_every_state(logs, tmp_path, to):
    import coordlog

    export(entries([logs])[0], tmp_path / "set", Options(to))
    path = tmp_path / "set" / ("data.hdf5" if to == "robomimic" else "coordlog/shelf-v0")
    refused(path, "does not say how many samples a second", ConfigError)
    found = read(path, rate=25, names=("a", "b"))
    for motion, episode in zip(found, coordlog.open(logs), strict=True):
        np.testing.assert_array_equal(motion.position, episode.qpos)
        assert motion.names == ("a", "b")
    refused(path, "expected 2 names", ConfigError, rate=25, names=("a",))
    refused(path, "choose one with --state", ConfigError, rate=25, state="nothing")


def demo(path, change):
    with h5py.File(path, "w") as file:
        file.create_dataset("data/demo_0/obs/qpos", data=np.zeros((3, 2)))
        change(file)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda file: file.__setitem__("data/x", h5py.ExternalLink("other.h5", "/")),
            "a link to another place",
        ),
        (
            lambda file: file.create_dataset("data/x", (1,), dtype=h5py.ref_dtype),
            "object references are not followed",
        ),
        (
            lambda file: file.create_dataset("data/x", (1,), "f8", external=[("o.bin", 0, 8)]),
            "its data lies in other files",
        ),
    ],
)
def test_hdf5_that_points_outside_itself_is_refused(tmp_path, change, said):
    demo(tmp_path / "x.hdf5", change)
    refused(tmp_path / "x.hdf5", said, rate=20)


def test_damaged_hdf5_is_one_sentence(tmp_path):
    demo(tmp_path / "x.hdf5", lambda file: None)
    whole = (tmp_path / "x.hdf5").read_bytes()
    for size in (0, 100, len(whole) // 2):
        (tmp_path / "x.hdf5").write_bytes(whole[:size])
        refused(tmp_path / "x.hdf5", "not an HDF5 file that can be read", rate=20)


CSV = "time,a,b\n0.0,1.5,2\n0.1,1.25,3\n0.3,1,4\n"


@pytest.mark.parametrize(
    "data",
    [
        CSV.encode(),
        b"\xef\xbb\xbf" + CSV.encode(),
        CSV.replace("\n", "\r\n").encode(),
        CSV.replace(",", ";").encode(),
        CSV.replace(",", "\t").encode(),
    ],
)
def test_a_csv_is_read_whatever_its_line_ends(tmp_path, data):
    (tmp_path / "x.csv").write_bytes(data)
    (found,) = read(tmp_path / "x.csv", columns=("a", "b"))
    assert found.position.tolist() == [[1.5, 2], [1.25, 3], [1, 4]]
    assert found.stamps.tolist() == [0, 100_000_000, 300_000_000]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time;a\n0,0;1,5\n", "line 2: expected numbers with a decimal point, got '0,0'"),
        ("time,a_deg\n0,90\n", "column 'a_deg': expected radians, its name says degrees"),
        ("time,a [deg]\n0,90\n", "its name says degrees; pass --degrees"),
        ("time,a\n0,1.5\n0.1\n", "x.csv: line 3: expected 2 columns, got 1"),
        ("time,a\n0,1.5\n0.1,\n", "column 'a', row 1: expected a number, got nothing"),
        ("time,a\n0,left\n", "column 'a': expected numbers, got text such as 'left'"),
        ("", "expected a header of column names in line 1"),
    ],
)
def test_a_csv_that_cannot_be_used_is_one_sentence(tmp_path, text, said):
    (tmp_path / "x.csv").write_text(text)
    refused(tmp_path / "x.csv", said)


def test_a_table_without_a_clock_wants_a_rate(tmp_path):
    (tmp_path / "x.csv").write_text("a,b\n1.5,2.5\n1.25,3.5\n")
    refused(tmp_path / "x.csv", "no column of time; name it with --clock", ConfigError)
    (found,) = read(tmp_path / "x.csv", rate=50)
    assert found.stamps.tolist() == [0, 20_000_000]


@pytest.mark.parametrize("to", ["csv", "parquet"])
def test_our_own_tables_come_back_bit_for_bit(logs, tmp_path, to):
    import coordlog

    export(entries([logs])[0], tmp_path / "set", Options(to))
    path = tmp_path / "set" / ("steps.csv" if to == "csv" else "steps/00000.parquet")
    for motion, episode in zip(read(path), coordlog.open(logs), strict=True):
        np.testing.assert_array_equal(motion.position, episode.qpos[:-1])
        assert motion.names == ("joint_0", "joint_1")


def test_nanosecond_clocks_stay_whole(tmp_path):
    stamps = [START, START + 1, START + 10**7]
    pq.write_table(pa.table({"stamp": stamps, "a": [0.0, 1.0, 2.0]}), tmp_path / "x.parquet")
    assert read(tmp_path / "x.parquet")[0].stamps.tolist() == stamps


def test_what_is_no_source_says_what_would_be_one(tmp_path):
    (tmp_path / "x.dat").write_bytes(struct.pack("<I", 7))
    refused(tmp_path / "x.dat", r"expected .mcap, .db3, .hdf5")
    refused(tmp_path, "expected a folder with metadata.yaml")
    refused(tmp_path / "gone", "no such file", StorageError)


def test_the_digest_of_a_folder_is_of_names_and_contents(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name / "inner").mkdir(parents=True)
        (tmp_path / name / "inner" / "x").write_bytes(b"same")
    assert digest_of(tmp_path / "a") == digest_of(tmp_path / "b")
    (tmp_path / "b" / "inner" / "x").rename(tmp_path / "b" / "inner" / "y")
    assert digest_of(tmp_path / "a") != digest_of(tmp_path / "b")


@pytest.mark.parametrize("name", ["pipe.csv", "pipe.mcap", "pipe.parquet", "pipe.h5"])
def test_a_pipe_is_no_source_and_nobody_waits_for_it(tmp_path, name):
    os.mkfifo(tmp_path / name)
    with pytest.raises(FormatError, match="got a pipe"):
        kind_of(tmp_path / name)
