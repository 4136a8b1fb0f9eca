"""What is not a finished coordlog episode is refused, in a sentence that says what it is
instead."""

import os

import pytest
from mcap.writer import Writer

from coordlog.errors import FormatError, StorageError, TruncatedError
from coordlog.record.container import Container
from coordlog.record.metadata import encode_header
from coordlog.record.reader import (
    probe,
    read_attachments,
    read_episode,
    read_header,
    read_summary,
)
from coordlog.record.writer import LIBRARY
from tests.synthetic import ATTACHMENTS, assert_same

READERS = (probe, read_episode, read_header, read_summary)


def foreign_mcap(path, *, profile="", library="libmcap 1.4.0"):
    with open(path, "wb") as stream:
        writer = Writer(stream)
        writer.start(profile=profile, library=library)
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/chatter", "cdr", schema)
        writer.add_message(channel, log_time=1, publish_time=1, data=b"\0\1\0\0\1\0\0\0\0")
        writer.add_metadata("rosbag2", {"serialized_metadata": "version: 8"})
        writer.finish()
    return path


def other_version(path, header):
    container = Container(LIBRARY)
    for name, values in encode_header(header).items():
        container.add_metadata(
            name, values | ({"schema_version": "7"} if name == "coordlog.episode" else {})
        )
    container.finish()
    path.write_bytes(container.drain())
    return path


def bad_files(folder, header):
    """A file of every kind that must be refused, and words that must be in the refusal."""
    (folder / "empty.mcap").write_bytes(b"")
    (folder / "text.mcap").write_text("time,x,y\n0,1,2\n" * 99)
    (folder / "magic.mcap").write_bytes(b"\x89MCAP0\r\n")
    (folder / "stub.mcap").write_bytes(b"\x89MC")
    (folder / "folder.mcap").mkdir()
    foreign_mcap(folder / "foreign.mcap")
    foreign_mcap(folder / "bag.mcap", profile="ros2", library="rosbag2 libmcap 1.1.1")
    other_version(folder / "newer.mcap", header)
    return {
        "empty.mcap": "the file is empty",
        "text.mcap": "not an MCAP file",
        "magic.mcap": "only 8 bytes of an MCAP file: nothing to recover",
        "stub.mcap": "only 3 bytes of an MCAP file: nothing to recover",
        "folder.mcap": "a folder, not an episode file",
        "foreign.mcap": "an MCAP file, but not a coordlog episode: its header says 'libmcap 1.4.0'",
        "bag.mcap": "an MCAP file, but not a coordlog episode: its header says 'ros2    rosbag2 libmcap 1.1.1'",
        "newer.mcap": "schema version 7; this release reads versions 1 to 2: a release of coordlog that writes version 7",
    }


@pytest.mark.parametrize("read", READERS)
def test_what_is_not_an_episode_is_named_and_refused(tmp_path, episode, read):
    for name, words in bad_files(tmp_path, episode.header).items():
        with pytest.raises(FormatError) as caught:
            read(tmp_path / name)
        assert str(caught.value).startswith(f"{tmp_path / name}: "), name
        assert words in str(caught.value), name
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("read", READERS)
def test_a_missing_file_is_a_storage_error(tmp_path, read):
    with pytest.raises(StorageError, match=r"nowhere\.mcap: cannot read: No such file"):
        read(tmp_path / "nowhere.mcap")


@pytest.mark.parametrize("read", [probe, read_episode, read_summary])
def test_a_truncated_file_says_how_to_recover_it(file, read):
    os.truncate(file, file.stat().st_size // 2)
    with pytest.raises(
        TruncatedError,
        match="without its commit marker; recover what is complete with `coordlog recover`",
    ):
        read(file)
    assert read_header(file).episode["scene"] == "table"


def test_a_finished_file_without_commit_marker_is_truncated(tmp_path, episode):
    container = Container(LIBRARY)
    for name, values in encode_header(episode.header).items():
        container.add_metadata(name, values)
    container.finish()
    (tmp_path / "a.mcap").write_bytes(container.drain())
    for read in (read_episode, read_summary):
        with pytest.raises(TruncatedError, match="commit marker"):
            read(tmp_path / "a.mcap")


def test_large_opening_metadata_is_read_in_full(tmp_path, episode):
    from coordlog.record.writer import write_episode

    episode.header.env["geoms"] = [f"geom_{index}" for index in range(20_000)]
    write_episode(tmp_path / "a.mcap", episode, attachments=ATTACHMENTS, display=False)
    assert read_header(tmp_path / "a.mcap") == episode.header
    assert read_summary(tmp_path / "a.mcap").result == episode.result


def test_a_damaged_chunk_is_refused_unless_asked_for(tmp_path, file, episode):
    from coordlog.record.records import walk

    data = bytearray(file.read_bytes())
    chunk = next(span for span in walk(data) if span.opcode == 6)
    data[chunk.start + 24] ^= 1  # its stored CRC: the content itself is whole
    file.write_bytes(data)
    with pytest.raises(FormatError, match=r"episode\.mcap: chunk: expected CRC"):
        read_episode(file)
    assert_same(read_episode(file, verify=False), episode)


def test_a_damaged_attachment_is_refused(file):
    data = file.read_bytes()
    at = data.index(ATTACHMENTS["model.xml.zst"])
    file.write_bytes(data[:at] + b"\0" + data[at + 1 :])
    with pytest.raises(FormatError, match=r"attachment 'model\.xml\.zst': expected CRC"):
        read_attachments(file)


def test_reading_the_summary_touches_only_the_ends(tmp_path, rng):
    from coordlog.record.writer import write_episode
    from tests.synthetic import make_episode

    path = tmp_path / "long.mcap"
    write_episode(path, make_episode(rng, length=500), attachments=ATTACHMENTS, display=False)
    data = bytearray(path.read_bytes())
    middle = slice(len(data) // 4, len(data) * 3 // 4)
    data[middle] = bytes(len(data[middle]))
    path.write_bytes(data)
    assert read_summary(path).result.length == 500
    with pytest.raises(FormatError):
        read_episode(path)
