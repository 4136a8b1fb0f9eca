"""Files as other programs see them."""

import numpy as np
import pytest
from mcap.reader import NonSeekingReader, make_reader
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory

from coordlog.record.metadata import HEADER_RECORDS, RESULT, decode_result, encode_header
from coordlog.record.writer import write_episode
from coordlog.spec import ARM, CONTACTS, FINAL, JOINT_STATE_TOPIC, KNOT, SPLINE, STEP
from tests.synthetic import ATTACHMENTS, PLANAR, START, make_episode


@pytest.fixture
def shown(tmp_path, rng):
    """A smoothed episode of three arms with every topic there is, as a file."""
    episode = make_episode(rng, layout=PLANAR, path=True)
    write_episode(tmp_path / "shown.mcap", episode, attachments=ATTACHMENTS, display=True)
    return tmp_path / "shown.mcap", episode


def by_topic(path):
    found = {}
    with open(path, "rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append((message, decoded))
    return found


def test_mcap_ros2_support_decodes_the_same_values(shown):
    path, episode = shown
    found = by_topic(path)
    for index, (message, got) in enumerate(found[STEP.topic]):
        assert message.sequence == got.step == index
        for item in STEP.fields[1:]:
            assert np.array_equal(getattr(got, item.name), getattr(episode, item.name)[index]), (
                item.name
            )
    ((_, final),) = found[FINAL.topic]
    for item in FINAL.fields[1:]:
        assert np.array_equal(getattr(final, item.name), getattr(episode, item.name)[-1]), item.name
    rows = [
        (got.step, *row)
        for _, got in found[CONTACTS.topic]
        for row in zip(
            got.substep, got.geom1, got.geom2, got.depth, got.x, got.y, got.z, strict=True
        )
    ]
    assert rows == episode.contacts.tolist()
    for index, (message, got) in enumerate(found[JOINT_STATE_TOPIC]):
        assert (
            got.header.stamp.sec * 10**9 + got.header.stamp.nanosec
            == message.log_time
            == START + index * 40_000_000
        )
        assert got.name == [joint["name"] for joint in episode.header.env["joints"]]
        assert np.array_equal(got.position, episode.qpos[index])
        assert np.array_equal(got.velocity, episode.qvel[index])
    for arm, name in enumerate(episode.header.arms):
        for index, (_, got) in enumerate(found[ARM.topic + name]):
            for item in ARM.fields:
                assert getattr(got, item.name) == getattr(episode, item.name)[index, arm], item.name
    for topic, names in (
        (KNOT.topic, ("knot_time", "knot_position", "knot_weight")),
        (SPLINE.topic, ("time", "position", "velocity")),
    ):
        for name in names:
            got = np.array([getattr(got, name.removeprefix("knot_")) for _, got in found[topic]])
            assert np.array_equal(got, getattr(episode.path, name)), name


def test_the_plain_reader_finds_everything_with_crcs_validated(shown):
    path, episode = shown
    with open(path, "rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        counts = dict.fromkeys(summary.channels, 0)
        for schema, channel, message in reader.iter_messages():
            assert schema.encoding == "ros2msg"
            assert channel.message_encoding == "cdr"
            assert message.log_time == message.publish_time
            counts[channel.id] += 1
        statistics = summary.statistics
        assert statistics.channel_message_counts == counts
        assert all(counts.values())  # no channel without a message
        assert statistics.message_count == sum(counts.values())
        assert statistics.schema_count == len(summary.schemas) == 8
        assert statistics.channel_count == len(summary.channels) == 7 + 3
        assert statistics.chunk_count == len(summary.chunk_indexes) == 4
        assert statistics.message_start_time == START
        assert statistics.message_end_time == START + 60 * 40_000_000
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        assert metadata == encode_header(episode.header) | {RESULT: metadata[RESULT]}
        assert decode_result(metadata[RESULT]) == episode.result
        assert list(metadata) == [*HEADER_RECORDS, RESULT]
        assert {record.name: record.data for record in reader.iter_attachments()} == ATTACHMENTS
        assert (reader.get_header().profile, reader.get_header().library) == (
            "ros2",
            "coordlog/0.1.0",
        )


def test_a_streaming_reader_finds_them_in_order_of_time_with_every_crc_right(shown):
    path, _ = shown
    with open(path, "rb") as stream:
        list(StreamReader(stream, validate_crcs=True).records)  # the data section's too
    times = {}
    with open(path, "rb") as stream:
        for _, channel, message in NonSeekingReader(stream, validate_crcs=True).iter_messages(
            log_time_order=False
        ):
            times.setdefault(channel.topic, []).append(message.log_time)
    for topic, values in times.items():
        assert values == sorted(set(values)), topic
    with open(path, "rb") as stream:
        topics = (STEP.topic, CONTACTS.topic, JOINT_STATE_TOPIC, FINAL.topic)
        together = [
            m.log_time
            for _, _, m in NonSeekingReader(stream).iter_messages(topics, log_time_order=False)
        ]
    assert together == sorted(together)


def test_there_is_no_offset_to_an_empty_group(tmp_path, episode):
    from mcap.records import SummaryOffset

    write_episode(tmp_path / "bare.mcap", episode, attachments={}, display=False)
    with open(tmp_path / "bare.mcap", "rb") as stream:
        offsets = [
            record for record in StreamReader(stream).records if isinstance(record, SummaryOffset)
        ]
    assert len(offsets) == 5
    assert all(offset.group_length for offset in offsets)


def test_rerun_gives_a_series_per_joint(shown):
    rr = pytest.importorskip("rerun")
    path, episode = shown
    rows, names = {}, {}
    for chunk in (
        rr.chunk.McapReader(path).stream().filter(content=JOINT_STATE_TOPIC + "/**").to_chunks()
    ):
        batch = chunk.to_record_batch()
        if "Scalars:scalars" in batch.schema.names:
            times = batch["message_log_time"].cast("int64").to_pylist()
            rows.setdefault(chunk.entity_path, {}).update(
                zip(times, batch["Scalars:scalars"].to_pylist(), strict=True)
            )
        if "SeriesLines:names" in batch.schema.names:
            names[chunk.entity_path] = batch["SeriesLines:names"].to_pylist()[0]
    for entity, values in (
        ("/joint_states/position", episode.qpos[:-1]),
        ("/joint_states/velocity", episode.qvel[:-1]),
    ):
        assert rows[entity] == {
            START + index * 40_000_000: row for index, row in enumerate(values.tolist())
        }
        assert names[entity] == [joint["name"] for joint in episode.header.env["joints"]]
