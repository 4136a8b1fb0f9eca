"""Odd sources by kind: read as a person would read them, or refused in one sentence."""

import json
from contextlib import suppress

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from coordlog.errors import ConfigError, FormatError
from coordlog.exchange.importing import Plan, understood
from coordlog.exchange.lerobot_source import _names
from coordlog.exchange.sources import Reading
from tests.exchange.bags import (
    JOINT_STATE,
    START,
    STORE,
    T,
    joint_state,
    recorded,
    stamp,
    write_bag,
)

N = 8
TIME = np.arange(N) / 50
Q = np.column_stack([0.3 * np.sin(TIME), 0.2 * np.cos(TIME)])
JOINTS = {"a": Q[:, 0], "b": Q[:, 1]}


def read(path, **reading):
    return [each.motion for each in understood(path, Plan(Reading(**reading)), None)]


def refused(path, said, error=FormatError, **reading):
    with pytest.raises(error, match=said) as caught:
        read(path, **reading)
    assert "\n" not in str(caught.value)


def csv(tmp_path, columns, *, sep=",", end="\n", spell=repr):
    rows = zip(*(map(spell, np.asarray(each).tolist()) for each in columns.values()), strict=True)
    text = end.join([sep.join(columns), *(sep.join(row) for row in rows), ""])
    (tmp_path / "x.csv").write_text(text, newline="")
    return tmp_path / "x.csv"


def parquet(tmp_path, columns):
    pq.write_table(pa.table(columns), tmp_path / "x.parquet")
    return tmp_path / "x.parquet"


@pytest.mark.parametrize(
    ("name", "factor"),
    [("time_ms", 1e3), ("t [us]", 1e6), ("stamp_ns", 1e9), ("timestamp (s)", 1), ("seconds", 1)],
)
def test_the_unit_of_a_clock_is_read_from_its_name(tmp_path, name, factor):
    (found,) = read(csv(tmp_path, {name: TIME * factor, **JOINTS}))
    assert found.timing.period == pytest.approx(0.02)
    assert found.names == ("a", "b")


@pytest.mark.parametrize("scale", [1, 10**3, 10**6, 10**9])
def test_the_unit_of_an_epoch_is_read_from_its_size(tmp_path, scale):
    since = np.rint((1_700_000_000 + TIME) * scale) if scale > 1 else 1.7e9 + TIME
    whole = since.astype(np.int64) if scale > 1 else since
    (found,) = read(csv(tmp_path, {"time": whole, **JOINTS}))
    assert found.timing.period == pytest.approx(0.02, abs=1e-6)


def test_milliseconds_without_a_word_are_suspected_and_can_be_said(tmp_path):
    path = csv(tmp_path, {"time": np.arange(N) * 20, **JOINTS})
    (found,) = read(path)
    assert "--clock time:ms" in " ".join(found.notes)
    (found,) = read(path, clock="time:ms")
    assert found.timing.period == pytest.approx(0.02)
    refused(path, "expected a unit of s, ms, us, ns, got 'h'", ConfigError, clock="time:h")


def test_dates_and_ros_stamps_are_clocks(tmp_path):
    dates = [f"2024-01-01 00:00:{at:09.6f}" for at in TIME]
    (found,) = read(csv(tmp_path, {"time": dates, **JOINTS}, spell=str))
    assert found.timing.period == pytest.approx(0.02)
    stamps = {"header.stamp.sec": [7] * N, "header.stamp.nanosec": (TIME * 1e9).astype(int)}
    (found,) = read(csv(tmp_path, {**stamps, **JOINTS}))
    assert found.stamps[0] == 7 * 10**9
    assert found.timing.period == pytest.approx(0.02)


@pytest.mark.parametrize(
    "name", ["a (deg)", "a_deg", "a [°]", "a/deg", "a deg", "deg_a", "A(Degrees)", "a_in_degrees"]
)
def test_degrees_in_a_header_are_seen_however_they_are_spelled(tmp_path, name):
    path = csv(tmp_path, {"time": TIME, name: Q[:, 0] * 57})
    refused(path, "its name says degrees; pass --degrees")
    (found,) = read(path, degrees=True)
    assert found.names[0].lower() == "a"
    np.testing.assert_allclose(found.position[:, 0], np.radians(Q[:, 0] * 57))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('time,a\n0,"0,5"\n', "line 2: expected numbers with a decimal point, got '0,5'"),
        ("time;a\n0;1,5e-3\n", "line 2: expected numbers with a decimal point"),
        ("0,1\n1,2\n", "line 1: expected a header of column names, got numbers"),
        ("# time,a\n0,1\n", "line 1: expected a header of column names, got a comment"),
        ("time,a,a\n0,1,2\n", "line 1: column 'a' stands twice"),
        ("time,a\n0,1\n1,N/A\n", "column 'a', row 1: expected a number, got 'N/A'"),
        ("time,a\n0,1\n1\n", "line 3: expected 2 columns, got 1"),
        ("time,a\n", "expected a row per sample"),
        ("time,a\nx,1\ny,2\n", "expected seconds, or dates and times"),
        ("episode,time,a\n0,0,1\n1,0,1\n0,1,1\n", "row 2: 0 comes again after others"),
        ("time,a\n0,1\n0,1\n", "expected two samples of different stamps in a row, got 1"),
        ("time,a\n2,1\n1,1\n", "expected time to go on, got a step back of 1 s"),
    ],
)
def test_a_table_that_cannot_be_meant_is_refused_by_its_line(tmp_path, text, said):
    (tmp_path / "x.csv").write_text(text)
    if "different stamps" in said:
        from coordlog.exchange.importing import import_source

        with pytest.raises(FormatError, match=said):
            import_source(tmp_path / "x.csv", tmp_path / "out", Plan(), None)
        assert not (tmp_path / "out").exists()
        return
    refused(tmp_path / "x.csv", said)


def test_other_encodings_are_refused_and_line_ends_are_not(tmp_path):
    (tmp_path / "x.csv").write_bytes("time,a°\n0,1\n".encode("latin-1"))
    refused(tmp_path / "x.csv", "line 1: expected UTF-8, got the byte 0xb0")
    for end in ("\r\n", "\r"):
        (found,) = read(csv(tmp_path, {"time": TIME, **JOINTS}, end=end))
        np.testing.assert_array_equal(found.position, Q)


def test_what_is_not_taken_is_named_and_counts_of_rows_are_no_joints(tmp_path):
    columns = {"": range(N), "time": TIME, **JOINTS, "touch": ["true"] * N}
    (found,) = read(csv(tmp_path, columns, spell=str))
    assert found.names == ("a", "b")
    assert "columns that were not taken: a column without a name, touch" in found.notes
    (tmp_path / "x.csv").write_text("time,a\n0,1\n1,2.37")
    (found,) = read(tmp_path / "x.csv")
    assert "the last line has no end" in " ".join(found.notes)


def test_an_option_that_means_nothing_for_a_source_is_refused(tmp_path):
    path = csv(tmp_path, {"time": TIME, **JOINTS})
    refused(path, "--topic is for rosbag2, mcap; this is csv", ConfigError, topic="/x")
    with pytest.raises(ConfigError, match="choose fewer a second"):
        list(understood(path, Plan(resample=1e9), None))


LISTS = pa.array(Q.tolist())


@pytest.mark.parametrize(
    "columns",
    [
        {"time": TIME, "position": LISTS},
        {"time": TIME, "position": LISTS, "name": pa.array([["a", "b"]] * N)},
        {"time": TIME, "joints": pa.array([{"a": x, "b": y} for x, y in Q])},
        {"time": TIME, "arm": pa.array([{"a": {"pos": x, "vel": y}} for x, y in Q])},
        {"time": pa.array((TIME * 1e9).astype(int), pa.duration("ns")), **JOINTS},
        {"at": pa.array((TIME * 1e9).astype(int), pa.timestamp("ns", "Asia/Tokyo")), **JOINTS},
        {"time": TIME, "observation.state": LISTS, "action": LISTS},
    ],
)
def test_lists_structs_and_times_of_parquet_are_read(tmp_path, columns):
    (found,) = read(parquet(tmp_path, columns))
    np.testing.assert_array_equal(found.position, Q[:, : found.position.shape[1]])
    assert found.timing.period == pytest.approx(0.02)


def test_lists_with_holes_name_their_row(tmp_path):
    short, none = Q.tolist(), Q.tolist()
    short[3], none[4] = short[3][:1], None
    refused(parquet(tmp_path, {"time": TIME, "q": pa.array(short)}), "'q', row 3: expected 2 num")
    refused(parquet(tmp_path, {"time": TIME, "q": pa.array(none)}), "'q', row 4: expected a list")
    unit = pa.schema(
        [("time", pa.float64()), pa.field("a", pa.float64(), metadata={"unit": "deg"})]
    )
    refused(parquet(tmp_path, pa.table({"time": TIME, "a": Q[:, 0]}, schema=unit)), "degrees")


DYNAMIC = "control_msgs/msg/DynamicJointState"
VALUE = "control_msgs/msg/InterfaceValue"
OWN = get_typestore(Stores.LATEST)
OWN.register(
    get_types_from_msg("string[] interface_names\nfloat64[] values\n", VALUE)
    | get_types_from_msg(
        "std_msgs/Header header\nstring[] joint_names\n"
        "control_msgs/InterfaceValue[] interface_values\n",
        DYNAMIC,
    )
)


def dynamic(path, rows, interfaces=("position", "velocity")):
    """A bag of dynamic joint states; a row is the values of each joint."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        channel = bag.add_connection("/dynamic", DYNAMIC, typestore=OWN)
        for i, row in enumerate(rows):
            values = [
                OWN.types[VALUE](interface_names=list(interfaces), values=np.array(each, float))
                for each in row
            ]
            header = T["std_msgs/msg/Header"](stamp=stamp(START + i * 10**7), frame_id="")
            message = OWN.types[DYNAMIC](
                header=header, joint_names=["a", "b"], interface_values=values
            )
            bag.write(channel, i, bytes(OWN.serialize_cdr(message, DYNAMIC)))
    return path


def test_dynamic_joint_states_are_read_or_say_what_they_lack(tmp_path):
    (found,) = read(dynamic(tmp_path / "ok", [[(x, 1.0), (y, 2.0)] for x, y in Q]))
    assert found.names == ("a", "b")
    np.testing.assert_array_equal(found.position, Q)
    assert found.velocity.tolist() == [[1.0, 2.0]] * N
    refused(dynamic(tmp_path / "one", [[(1.0, 1.0)]]), "expected interfaces of 2 joints, got 1")
    refused(dynamic(tmp_path / "few", [[(1.0,)] * 2]), "expected a value for each of position")
    efforts = dynamic(tmp_path / "effort", [[(1.0,)] * 2], ("effort",))
    refused(efforts, "expected an interface 'position', got effort")


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_a_bag_compressed_whole_is_read_and_one_by_message_is_refused(tmp_path, rng, storage):
    stamps, position = recorded(rng, 20)
    for mode in (CompressionMode.FILE, CompressionMode.MESSAGE):
        bag = Writer(tmp_path / mode.name, version=9, storage_plugin=storage)
        bag.set_compression(mode, CompressionFormat.ZSTD)
        with bag:
            channel = bag.add_connection("/js", JOINT_STATE, typestore=STORE)
            for ns, row in zip(stamps.tolist(), position, strict=True):
                bag.write(channel, ns, joint_state(ns, "xyz", row))
    (found,) = read(tmp_path / "FILE")
    np.testing.assert_array_equal(found.position, position)
    refused(tmp_path / "MESSAGE", "got each compressed by itself")
    (bare,) = (path for path in (tmp_path / "MESSAGE").iterdir() if path.suffix != ".yaml")
    refused(bare, "got each compressed by itself")
    (file,) = (path for path in (tmp_path / "FILE").iterdir() if path.suffix != ".yaml")
    refused(file, "a compressed file or an archive: unpack it first")
    file.write_bytes(file.read_bytes()[:-9])
    refused(tmp_path / "FILE", "not a bag that can be read")


def joint_states(path, messages):
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        channel = bag.add_connection("/js", JOINT_STATE, typestore=STORE)
        for i, data in enumerate(messages):
            bag.write(channel, i + 1, data)
    return path


def test_joint_states_that_are_none_name_their_message(tmp_path):
    good = [joint_state(START + i, ["a", "b"], [i, i]) for i in range(3)]
    for name, odd, said in (
        ("none", joint_state(START, [], []), "message 1: expected joints, got not a single one"),
        ("other", joint_state(START, ["a", "c"], [0, 0]), "without b and with c"),
        ("effort", joint_state(START, ["a", "b"], []), "expected a position for each of 2"),
        ("cut", good[1][:-3], "message 1: a JointState that was cut off"),
        ("unset", joint_state(0, ["a", "b"], [0, 0]), "header stamp, got zero, as in 1 of 3"),
    ):
        refused(joint_states(tmp_path / name, [good[0], odd, good[2]]), said)
    refused(joint_states(tmp_path / "empty", [joint_state(START, [], [])]), "not a single one")
    twice = joint_states(tmp_path / "twice", [joint_state(START, ["a", "a"], [0, 0])])
    refused(twice, "expected each joint once, got a twice")
    (twice / "metadata.yaml").unlink()
    refused(twice, "a bag without its metadata.yaml: give its .mcap or .db3 file itself")
    (tmp_path / "locked.db3").write_bytes(np.random.default_rng(0).bytes(4096))
    refused(tmp_path / "locked.db3", "another kind, or encrypted")


def test_hdf5_that_goes_in_circles_or_refers_within_a_record_is_refused(tmp_path):
    for name, spoil, said in (
        (
            "circle",
            lambda data: data.__setitem__("loop", data),
            "/data/loop: a group within itself",
        ),
        ("soft", lambda data: data.__setitem__("x", h5py.SoftLink("/data/y")), "a link to another"),
        (
            "record",
            lambda data: data.create_dataset(
                "x", (2,), np.dtype([("a", "f8"), ("r", h5py.ref_dtype)])
            ),
            "object references are not followed",
        ),
    ):
        with h5py.File(tmp_path / f"{name}.hdf5", "w") as file:
            data = file.create_group("data")
            data.create_group("demo_0")["obs/qpos"] = Q
            spoil(data)
        refused(tmp_path / f"{name}.hdf5", said, rate=20.0)


def test_minari_sets_of_other_spaces_and_formats_say_what_they_have(tmp_path):
    (tmp_path / "data").mkdir()
    about = tmp_path / "data" / "metadata.json"
    with h5py.File(tmp_path / "data" / "main_data.hdf5", "w") as file:
        file["episode_0/observations/arm"] = Q
    about.write_text(json.dumps({"data_format": "hdf5"}))
    refused(tmp_path, "choose one with --state: observations/arm", ConfigError, rate=20.0)
    (found,) = read(tmp_path, rate=20.0, state="observations/arm")
    np.testing.assert_array_equal(found.position, Q)
    about.write_text(json.dumps({"data_format": "arrow"}))
    refused(tmp_path, "expected a Minari set in hdf5, got arrow", rate=20.0)


@pytest.mark.parametrize(
    "names",
    [["a", "b"], [["a", "b"]], {"motors": ["a", "b"]}, {"l": ["a"], "r": ["b"]}, {"b": 1, "a": 0}],
)
def test_names_of_a_lerobot_feature_are_read_in_every_shape(names):
    for shape in ([2], [2, 1], [1, 2]):
        assert _names({"names": names, "shape": shape}) == ("a", "b")
    assert _names({"names": ["a"], "shape": [2]}) == ()


def lerobot(tmp_path, **changed):
    """A LeRobot v2.1 set of one episode, some of its columns changed."""
    states = pa.FixedSizeListArray.from_arrays(Q.ravel(), 2)
    rows = {"observation.state": states, "timestamp": TIME, "frame_index": np.arange(N)}
    rows |= {"episode_index": np.zeros(N, int), **changed}
    (tmp_path / "meta").mkdir()
    (tmp_path / "data").mkdir()
    info = {
        "codebase_version": "v2.1",
        "fps": 50,
        "features": {
            "observation.state": {"dtype": "float32", "shape": [2], "names": ["a", "b"]},
            "timestamp": {"dtype": "float32", "shape": [1]},
        },
        "total_episodes": 1,
        "data_path": "data/{episode_index}.parquet",
    }
    text = "\ufeff" + json.dumps(info)  # as some editors save it
    (tmp_path / "meta" / "info.json").write_text(text, "utf-8")
    (tmp_path / "meta" / "episodes.jsonl").write_text(f'{{"episode_index": 0, "length": {N}}}')
    kept = {name: column for name, column in rows.items() if column is not None}
    pq.write_table(pa.table(kept), tmp_path / "data" / "0.parquet")
    return tmp_path


def test_a_small_lerobot_set_is_read(tmp_path):
    (motion,) = read(lerobot(tmp_path))
    np.testing.assert_array_equal(motion.position, Q)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"timestamp": np.where(TIME > 0.1, np.nan, TIME)}, "'timestamp', row 6: .* got nan"),
        ({"timestamp": [None] * N}, "'timestamp': expected numbers, got null"),
        ({"timestamp": ["now"] * N}, "'timestamp': expected numbers, got string"),
        ({"frame_index": None}, "expected a column 'frame_index', got observation.state"),
        ({"observation.state": TIME}, "expected lists of 2 numbers, got double"),
        ({"observation.state": [["x", "y"]] * N}, "expected lists of 2 numbers, got list"),
        ({"observation.state": [[0.0]] * N}, "expected 2 numbers a row, got 8 in 8"),
    ],
)
def test_columns_of_a_lerobot_set_that_are_none_are_named(tmp_path, changed, said):
    refused(lerobot(tmp_path, **changed), said)


def mcap(path, data, **options):
    with path.open("wb") as stream:
        writer = McapWriter(stream, **options)
        writer.start(profile="", library="theirs")
        schema = writer.register_schema("S", "jsonschema", b"{}")
        channel = writer.register_channel("/j", "json", schema)
        for i, message in enumerate(data):
            writer.add_message(channel, START + i * 10**7, message, START)
        writer.finish()
    return path


SAID = [json.dumps({"name": ["a", "b"], "position": row}).encode() for row in Q.tolist()]


@pytest.mark.parametrize("compression", list(CompressionType))
def test_mcap_of_any_compression_is_read_if_its_summary_names_channels(tmp_path, compression):
    (motion,) = read(mcap(tmp_path / "x.mcap", SAID, compression=compression))
    np.testing.assert_array_equal(motion.position, Q)
    without = mcap(tmp_path / "y.mcap", SAID, compression=compression, repeat_channels=False)
    refused(without, "its summary names no channels")


def test_mcap_that_is_damaged_anywhere_is_refused_or_gives_all_its_samples(tmp_path):
    path = mcap(tmp_path / "x.mcap", SAID)
    whole = path.read_bytes()
    for at in range(20, len(whole) - 60, 29):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 16]) + whole[at + 1 :])
        with suppress(FormatError, ConfigError):
            (motion,) = read(path)
            np.testing.assert_array_equal(motion.position, Q)


def test_json_that_is_too_deep_is_refused(tmp_path):
    refused(mcap(tmp_path / "x.mcap", [b"[" * 100_000]), "message 0: expected JSON")


def test_a_simulations_clock_may_begin_at_zero(tmp_path):
    def bag(path, start, zero):
        with Writer(path, version=9) as writer:
            channel = writer.add_connection("/joint_states", JOINT_STATE, typestore=STORE)
            for i, row in enumerate(Q):
                ns = 0 if i == zero else start + i * 10**7
                writer.write(channel, START + i, joint_state(ns, ["a", "b"], row))
        return path

    (motion,) = read(bag(tmp_path / "simulated", 0, 0))
    assert motion.stamps.tolist() == [i * 10**7 for i in range(N)]
    refused(bag(tmp_path / "real", START, 0), "message 0: expected a header stamp, got zero")
    refused(bag(tmp_path / "later", 0, 3), "message 0: expected a header stamp, got zero")


def test_a_minari_set_whose_metadata_is_broken_is_refused(tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "metadata.json").write_text("{")
    refused(tmp_path, "metadata.json: expected JSON", rate=20.0)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_bag_whose_clocks_were_both_set_back_is_not_sorted_into_one(tmp_path, rng, storage):
    stamps, position = recorded(rng, 60)
    stamps[30:] -= 500_000_000
    bag = write_bag(tmp_path / "bag", stamps, position, storage=storage)
    refused(bag, "sample 30: expected time to go on, got a step back")
    refused(bag, "sample 30: expected time to go on, got a step back", stamps="log")
    first, second = (
        each.motion for each in understood(bag, Plan(Reading(), split_clock=True), None)
    )
    np.testing.assert_array_equal(np.concatenate([first.position, second.position]), position)


def test_bars_part_columns_and_spaces_do_not(tmp_path):
    (found,) = read(csv(tmp_path, {"time": TIME, **JOINTS}, sep="|"))
    np.testing.assert_array_equal(found.position, Q)
    refused(csv(tmp_path, {"time": TIME, **JOINTS}, sep=" "), "parted by a comma")
    comma = csv(tmp_path, {"time": TIME, **JOINTS}, spell=lambda x: f"{x:.3f}".replace(".", ","))
    refused(comma, "line 2: expected 3 columns, got 6.*if these are decimal commas")


@pytest.mark.parametrize(
    ("info", "said"),
    [("null", "expected a table, got None"), ("[1]", r"expected a table, got \[1")],
)
def test_metadata_that_is_no_table_is_refused(tmp_path, info, said):
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta/info.json").write_text(info)
    refused(tmp_path, said)


def test_a_pointer_of_git_lfs_and_a_folder_of_tables_are_said(tmp_path):
    (tmp_path / "x.parquet").write_text("version https://git-lfs.github.com/spec/v1\nsize 1\n")
    refused(tmp_path / "x.parquet", "expected Parquet, got a Git LFS pointer")
    refused(tmp_path, "a folder of tables: give its files")
