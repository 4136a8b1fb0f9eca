"""What version 2 adds: a layout read from the file, topics of others, a commit marker that vouches
for the metadata, and files that other MCAP tools have written again.
"""

import hashlib
import struct
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from coordlog.episode import INITIAL_STATE
from coordlog.errors import FormatError
from coordlog.record import topics
from coordlog.record.metadata import encode_header
from coordlog.record.reader import read_attachments, read_episode, read_header, read_summary
from coordlog.record.recording import Recording
from coordlog.record.records import RECORD_HEAD, walk
from coordlog.record.schema import SCHEMAS
from coordlog.record.writer import EpisodeWriter, write_episode
from coordlog.spec import FINAL, INPUTS, REACH, STEP, TASK_TOPIC
from coordlog.verify.file import check, rewritten
from coordlog.verify.repair import recover
from tests.synthetic import ATTACHMENTS, TINY, assert_same, make_episode, make_header

V1 = Path(__file__).parents[1] / "data" / "v1"


def findings(path):
    return check(path, level="content")


def rewrite(
    source,
    target,
    *,
    library="other 1.0",
    skip=(),
    extra=False,
    late=False,
    edit=lambda topic, data: data,
    **options,
):
    """The same records through the Python library of MCAP, which lays them out in its own way."""
    with open(source, "rb") as stream, open(target, "wb") as out:
        reader = make_reader(stream)
        writer = Writer(out, **options)
        writer.start(profile="", library=library)
        notes = [(item.name, item.metadata) for item in reader.iter_metadata()]
        for item in reader.iter_attachments():
            writer.add_attachment(
                item.create_time, item.log_time, item.name, item.media_type, item.data
            )
        for name, values in () if late else notes:
            writer.add_metadata(name, values)
        channels, schemas = {}, {}
        if extra:
            number = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
            chatter = writer.register_channel("/chatter", "cdr", number)
            writer.add_message(chatter, 1, b"\0\1\0\0\1\0\0\0\0", 1)
        for schema, channel, message in reader.iter_messages():
            if channel.topic in skip:
                continue
            if channel.topic not in channels:
                if schema.name not in schemas:
                    schemas[schema.name] = writer.register_schema(
                        schema.name, schema.encoding, schema.data
                    )
                channels[channel.topic] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[schema.name]
                )
            writer.add_message(
                channels[channel.topic],
                message.log_time,
                edit(channel.topic, message.data),
                message.publish_time,
                message.sequence,
            )
        for name, values in notes if late else ():
            writer.add_metadata(name, values)
        writer.add_metadata("a note", {"by": "somebody"})
        writer.finish()
    return target


LAYOUTS = {
    "zstd": {},
    "lz4": {"compression": CompressionType.LZ4},
    "none": {"compression": CompressionType.NONE},
    "small chunks": {"chunk_size": 500},
    "no chunks": {"use_chunking": False},
    "no crcs": {"enable_crcs": False, "enable_data_crcs": False},
    "metadata last": {"late": True},
    "our name": {"library": "coordlog/0.1.0"},
    "another topic": {"extra": True},
}


@pytest.mark.parametrize("options", LAYOUTS.values(), ids=LAYOUTS.keys())
@pytest.mark.parametrize("version", [1, 2])
def test_what_another_tool_has_written_again_is_read(tmp_path, rng, options, version):
    if version == 1:
        source = next(V1.glob("planar/*.mcap"))
    else:
        source = tmp_path / "a.mcap"
        episode = make_episode(rng, path=True)
        write_episode(source, episode, attachments=ATTACHMENTS, display=True)
    path = rewrite(source, tmp_path / "b.mcap", **options)
    assert_same(read_episode(path), read_episode(source))
    assert read_attachments(path) == read_attachments(source)
    assert read_summary(path).result == read_summary(source).result
    assert read_header(path) == read_header(source)
    assert "rewritten by" in rewritten(path)
    assert not rewritten(source)
    if version == 2:
        assert findings(path) == []


def test_a_value_changed_behind_absent_crcs_is_not_believed(tmp_path, rng):
    source = write_episode_at(tmp_path / "a.mcap", make_episode(rng))
    options = {"use_chunking": False, "enable_crcs": False, "enable_data_crcs": False}
    path = rewrite(source, tmp_path / "b.mcap", **options)
    data = bytearray(path.read_bytes())
    episode = read_episode(source)
    for column, words in (("torque", STEP.topic), ("distance", TASK_TOPIC), ("qpos", "")):
        damaged = bytearray(data)
        at = damaged.find(episode.columns[column][7].tobytes())
        damaged[at + 1] ^= 1
        path.write_bytes(damaged)
        with pytest.raises(FormatError, match=f"{words}.* not those that were recorded"):
            read_episode(path)


@pytest.mark.parametrize("version", [1, 2])
def test_a_value_that_a_tool_changed_is_not_believed_whatever_its_crcs_say(tmp_path, rng, version):
    source = next(V1.glob("planar/*.mcap"))
    if version == 2:
        source = write_episode_at(tmp_path / "a.mcap", make_episode(rng))
    wanted = read_episode(source).qpos[3].tobytes()
    path = rewrite(
        source,
        tmp_path / "b.mcap",
        edit=lambda topic, data: data.replace(wanted, bytes([wanted[0] ^ 1]) + wanted[1:]),
    )
    for read in (read_episode, read_summary):
        with pytest.raises(FormatError, match="not those that were recorded"):
            read(path)
    assert findings(path)


def test_what_a_tool_left_out_is_missing_and_the_rest_is_there(tmp_path, rng):
    source = write_episode_at(tmp_path / "a.mcap", make_episode(rng))
    path = rewrite(source, tmp_path / "b.mcap", skip=(TASK_TOPIC + "reach",))
    episode = read_episode(path)
    assert episode.qpos.tobytes() == read_episode(source).qpos.tobytes()
    assert not episode.has("distance")
    assert "another tool left them out" in str(findings(path)[0])
    with pytest.raises(AttributeError, match=r"task 'reach'.* no column 'distance'; it has time,"):
        _ = episode.distance
    path = rewrite(source, tmp_path / "c.mcap", skip=(FINAL.topic,))
    with pytest.raises(FormatError, match="final"):
        read_episode(path)


def test_two_episodes_in_one_file_are_refused(tmp_path, rng):
    path = rewrite(write_episode_at(tmp_path / "a.mcap", make_episode(rng)), tmp_path / "b.mcap")
    with open(path, "rb") as stream:
        records = list(make_reader(stream).iter_metadata())
    with open(tmp_path / "c.mcap", "wb") as out:
        writer = Writer(out)
        writer.start(library="other")
        for index in "01":
            for record in records:
                writer.add_metadata(record.name, record.metadata | {"id": index})
        writer.finish()
    with pytest.raises(FormatError, match="two records that differ"):
        read_header(tmp_path / "c.mcap")


def write_episode_at(path, episode, **options):
    write_episode(path, episode, attachments=ATTACHMENTS, display=False, **options)
    return path


def with_schema(monkeypatch, path, episode, name, change):
    """Write an episode whose file declares a message otherwise."""
    monkeypatch.setattr(topics, "SCHEMAS", SCHEMAS | {name: change(SCHEMAS[name])})
    topics._topics.cache_clear()
    try:
        return write_episode_at(path, episode)
    finally:
        monkeypatch.undo()
        topics._topics.cache_clear()


def test_words_are_never_compared(tmp_path, episode, monkeypatch):
    path = with_schema(
        monkeypatch,
        tmp_path / "a.mcap",
        episode,
        STEP.name,
        lambda text: text.replace("control step", "a step of control").replace("[s]", "[seconds]"),
    )
    assert_same(read_episode(path), episode)
    assert findings(path) == []


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("float64[] qvel", "float64[] speed"), "'float64[] qvel', got no field of that name"),
        (("float64[] qvel", "float32[] qvel"), "'float64[] qvel', got 'float32[] qvel'"),
        (("float64 time", "float64[] time"), "'float64 time', got 'float64[] time'"),
    ],
)
def test_a_field_that_is_missing_or_of_another_type_is_named(
    tmp_path, episode, monkeypatch, change, words
):
    path = with_schema(
        monkeypatch,
        tmp_path / "a.mcap",
        episode,
        STEP.name,
        lambda text: text.replace(*change),
    )
    with pytest.raises(FormatError) as caught:
        read_episode(path)
    assert f"schema {STEP.name}: expected {words}" in str(caught.value)
    (finding,) = findings(path)
    assert words in finding.got


def test_fields_that_a_later_release_adds_are_left(tmp_path, episode, monkeypatch):
    from coordlog.record import messages

    grown = STEP._replace(
        fields=(*STEP.fields, FINAL.fields[2]._replace(name="effort", type="float32", size="7"))
    )
    text = SCHEMAS[STEP.name] + "float32[] effort  # something new\n"
    monkeypatch.setattr(messages, "step_message", lambda header: grown)
    monkeypatch.setattr(
        messages, "_filled", lambda m, columns, n: {**columns, "effort": np.ones((n, 7), "f4")}
    )
    path = with_schema(monkeypatch, tmp_path / "a.mcap", episode, STEP.name, lambda _: text)
    assert_same(read_episode(path), episode)
    assert findings(path) == []


def test_every_bit_of_the_metadata_is_vouched_for(tmp_path, rng):
    path = write_episode_at(tmp_path / "a.mcap", make_episode(rng, layout=TINY, length=3))
    data, good = path.read_bytes(), read_summary(path)
    quiet, tried = [], 0
    for span in [span for span in walk(data) if span.opcode == Opcode.METADATA]:
        for at in range(span.start, span.end, 11):
            damaged = bytearray(data)
            damaged[at] ^= 1 << int(rng.integers(8))
            path.write_bytes(damaged)
            tried += 1
            for read in (read_summary, read_episode, lambda p: Recording(p).header):
                try:
                    got = read(path)
                except FormatError:
                    continue
                quiet.append((at, got))
    assert tried > 200
    assert quiet == []
    path.write_bytes(data)
    assert read_summary(path) == good


def test_every_bit_of_a_header_of_version_1_is_vouched_for(tmp_path, rng):
    data = next(V1.glob("planar/*.mcap")).read_bytes()
    path, quiet = tmp_path / "a.mcap", []
    for span in [span for span in walk(data) if span.opcode == Opcode.METADATA]:
        for at in range(span.start, span.end, 31):
            damaged = bytearray(data)
            damaged[at] ^= 1 << int(rng.integers(8))
            path.write_bytes(damaged)
            for read in (read_summary, read_episode):
                try:
                    read(path)
                except FormatError:
                    continue
                quiet.append(at)
    assert quiet == []


def test_an_attachment_changed_behind_its_crc_is_not_believed(tmp_path, rng):
    path = write_episode_at(tmp_path / "a.mcap", make_episode(rng))
    data = bytearray(path.read_bytes())
    span = next(span for span in walk(data) if span.opcode == Opcode.ATTACHMENT)
    data[span.end - 12] ^= 1
    crc = zlib.crc32(memoryview(data)[span.start : span.end - 4])
    data[span.end - 4 : span.end] = struct.pack("<I", crc)
    path.write_bytes(data)
    with pytest.raises(FormatError, match="its digest is another"):
        read_attachments(path)


@pytest.mark.parametrize("value", ["null", "7", "[]", "true", '{"name":3}', "x" * 99])
def test_metadata_of_another_shape_name_the_record_and_the_key(value):
    from coordlog.record.metadata import decode_header

    records, tried = encode_header(make_header()), 0
    for name, strings in records.items():
        for key in strings:
            for changed in (
                {**strings, key: value},
                {k: v for k, v in strings.items() if k != key},
            ):
                tried += 1
                try:
                    decode_header(records | {name: changed})
                except FormatError as error:
                    said = str(error)
                    assert name in said or "schema version" in said or "schema_version" in said
                    assert "\n" not in said
    assert tried > 60


def test_keys_that_nobody_knows_are_kept(tmp_path, rng):
    header = make_header(weather="fine")
    header.env["later"] = {"more": [1, 2]}
    path = write_episode_at(tmp_path / "a.mcap", make_episode(rng, header=header))
    assert read_header(path) == header


def test_a_recording_reads_its_file_once(tmp_path, rng, monkeypatch):
    episode = make_episode(rng)
    path = write_episode_at(tmp_path / "a.mcap", episode)
    data, count = path.read_bytes(), []
    from coordlog.record import recording as module

    true = module.load
    monkeypatch.setattr(module, "load", lambda source: count.append(source) or true(source))
    stored = Recording(path)
    assert count == []
    assert_same(stored.episode, episode)
    assert stored.header == episode.header
    assert stored.result == read_summary(path).result
    assert stored.attachments == ATTACHMENTS
    assert stored.initial_state.tobytes() == ATTACHMENTS[INITIAL_STATE]
    assert stored.digest == hashlib.sha256(data).hexdigest()
    assert stored.rewritten == ""
    with pytest.raises(FormatError, match=r"a\.mcap: .*MJCF"):
        _ = stored.model
    assert len(count) == 1
    assert_same(Recording("in a pack", data).episode, episode)
    with pytest.raises(FormatError, match="in a pack: not an MCAP file"):
        _ = Recording("in a pack", b"what is this, then?").header


def test_arrays_own_aligned_memory_at_any_length(tmp_path, rng):
    for length in (1, 2, 26):
        episode = make_episode(rng, length=length, collisions=1.0)
        read = read_episode(write_episode_at(tmp_path / f"{length}.mcap", episode))
        for name, array in (*read.columns.items(), ("contacts", read.contacts)):
            assert array.flags.aligned, name
            assert array.flags.c_contiguous, name


def test_inputs_are_written_when_they_change(tmp_path, rng):
    episode = make_episode(rng, length=60)
    inputs = {
        "step": np.array([0, 3, 3, 40]),
        "substep": np.array([0, 0, 5, 0], np.int32),
        "qfrc_applied": rng.normal(size=(4, 33)),
        "xfrc_applied": rng.normal(size=(4, 60)),
        "eq_active": rng.random((4, 2)) < 0.5,
        "mocap_pos": rng.normal(size=(4, 6)),
        "mocap_quat": rng.normal(size=(4, 8)),
        "state": np.zeros((4, 0)),
    }
    given = replace(episode, inputs=inputs)
    path = write_episode_at(tmp_path / "a.mcap", given)
    got = read_episode(path)
    assert list(got.inputs) == [item.name for item in INPUTS.fields]
    for name, values in inputs.items():
        assert got.inputs[name].tobytes() == values.tobytes(), name
    assert findings(path) == []
    assert read_episode(write_episode_at(tmp_path / "b.mcap", episode)).inputs == {}


def test_a_task_that_is_not_installed_opens(tmp_path, rng):
    header = make_header()
    fields = [item | {"name": f"own_{item['name']}"} for item in header.env["task"]["fields"]]
    fields.append({"name": "aim", "type": "float64", "size": "3", "unit": "m", "when": "before"})
    header.env["task"] = {"name": "stack-boxes", "fields": fields}
    plain = make_episode(rng, ending="interrupted")
    names = {item.name for item in REACH}
    columns = {f"own_{n}" if n in names else n: v for n, v in plain.columns.items()}
    columns["aim"] = rng.normal(size=(len(plain) + 1, 3))
    episode = replace(plain, header=header, columns=columns, contacts=plain.contacts[:0])
    path = tmp_path / "a.mcap"
    result = write_episode(path, episode, attachments={}, display=True)
    got = read_episode(path)
    for name, values in columns.items():
        assert getattr(got, name).tobytes() == values.tobytes(), name
    assert not result.success
    assert findings(path) == []
    with open(path, "rb") as stream:
        found = {record.topic for record in make_reader(stream).get_summary().channels.values()}
    assert {"/coordlog/task/stack-boxes", "/coordlog/task/stack-boxes/final"} <= found


def test_an_episode_of_version_1_is_written_as_one_of_this_version(tmp_path):
    source = next(V1.glob("table/*.mcap"))
    old = read_episode(source)
    path = tmp_path / "a.mcap"
    write_episode(path, old, attachments=read_attachments(source), display=False)
    new = read_episode(path)
    assert (old.header.version, new.header.version, new.header.kind) == (1, 2, "simulated")
    assert set(new.columns) == set(old.columns)
    for name, values in old.columns.items():
        assert new.columns[name].tobytes() == values.tobytes(), name
    assert not new.has("torque")
    assert new.result == old.result


def test_a_file_that_expands_to_more_than_its_size_allows_is_refused(tmp_path, rng):
    source = write_episode_at(tmp_path / "a.mcap", make_episode(rng, layout=TINY, length=3))
    with open(source, "rb") as stream, open(tmp_path / "b.mcap", "wb") as out:
        writer = Writer(out, compression=CompressionType.ZSTD, chunk_size=1 << 20)
        writer.start(library="coordlog/0.1.0")
        for record in make_reader(stream).iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        schema = writer.register_schema("a/b", "ros2msg", b"")
        channel = writer.register_channel("/zeros", "cdr", schema)
        for index in range(90):
            writer.add_message(channel, index, bytes(1 << 20), index)
        writer.finish()
    assert (tmp_path / "b.mcap").stat().st_size < 1 << 17
    with pytest.raises(FormatError, match=r"chunks that expand to .* expected at most"):
        read_episode(tmp_path / "b.mcap")


def test_recovering_expands_no_more_than_the_size_of_a_file_allows(tmp_path, rng):
    whole = write_episode_at(tmp_path / "a.mcap", make_episode(rng, layout=TINY, length=3))
    data, size = whole.read_bytes(), 90 << 20
    packed = zstandard.compress(bytes(size))
    head = struct.pack("<QQQI", 0, 0, size, 0) + struct.pack("<I", 4) + b"zstd"
    body = head + struct.pack("<Q", len(packed)) + packed
    end = next(span for span in walk(data) if span.opcode == Opcode.DATA_END)
    bomb = RECORD_HEAD.pack(Opcode.CHUNK, len(body)) + body
    (tmp_path / "b.mcap").write_bytes(data[: end.start - RECORD_HEAD.size] + bomb)
    done = recover(tmp_path / "b.mcap")
    assert done.steps_kept == 3
    assert f"expands to {size} bytes, more than" in done.lost


def test_a_part_file_is_one_of_our_own(tmp_path, rng):
    episode = make_episode(rng)
    with EpisodeWriter(
        tmp_path / "a.mcap", episode.header, attachments=ATTACHMENTS, display=False
    ) as writer:
        columns = {name: values[:25] for name, values in episode.columns.items()}
        near = episode.contacts[episode.contacts["step"] < 25]
        writer.write_steps(0, columns, contacts=near)
    assert read_header(tmp_path / "a.mcap.part") == episode.header
    assert read_attachments(tmp_path / "a.mcap.part") == ATTACHMENTS
