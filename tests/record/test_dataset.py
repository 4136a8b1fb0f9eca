import os

import numpy as np
import pyarrow as pa
import pytest
from mcap.opcode import Opcode

from coordlog.errors import FormatError, SpecError, StorageError, TruncatedError
from coordlog.record import dataset
from coordlog.record.records import walk
from coordlog.record.writer import write_episode
from tests.record.test_reader import bad_files
from tests.synthetic import (
    ATTACHMENTS,
    PLANAR,
    TINY,
    assert_same,
    make_episode,
    make_header,
    outcome,
)


@pytest.fixture
def episodes(rng):
    return [
        make_episode(rng, length=length, ending=ending)
        for length, ending in ((30, "goal"), (1, "fall"), (77, "limit"), (0, "stopped"))
    ]


@pytest.fixture
def folder(tmp_path, episodes):
    """Four episodes, one of them in a folder below, and a recording in progress."""
    for name, episode in zip(("a.mcap", "b.mcap", "c/a.mcap", "d.mcap"), episodes, strict=True):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        write_episode(tmp_path / name, episode, attachments=ATTACHMENTS, display=name == "b.mcap")
    (tmp_path / "e.mcap.part").write_bytes(b"")
    (tmp_path / "notes.txt").write_text("not a log")
    return tmp_path


def test_a_folder_is_a_sequence_of_episodes_in_the_order_of_names(folder, episodes):
    opened = dataset.open(folder)
    assert [path.relative_to(folder).as_posix() for path in opened.paths] == [
        "a.mcap",
        "b.mcap",
        "c/a.mcap",
        "d.mcap",
    ]
    assert len(opened) == 4
    assert opened.parts == (folder / "e.mcap.part",)
    assert opened.skipped == []
    for got, wanted in zip(opened, episodes, strict=True):
        assert_same(got, wanted)
    assert_same(opened[-2], episodes[2])
    assert [len(episode) for episode in opened[1:3]] == [1, 77]
    with pytest.raises(IndexError):
        opened[4]


def test_files_and_folders_can_be_mixed(folder):
    assert len(dataset.open([folder / "c", folder / "a.mcap", str(folder / "b.mcap")])) == 3
    assert len(dataset.open(str(folder / "a.mcap"))) == 1


def test_the_table_has_every_step_bit_for_bit(folder, episodes):
    table = dataset.open(folder).to_table()
    table.validate(full=True)
    assert table.column_names == ["episode", "step", *episodes[0].columns]
    assert table["episode"].to_pylist() == [0] * 30 + [1] + [2] * 77
    assert table["step"].to_pylist() == [*range(30), 0, *range(77)]
    for item in episodes[0].header.fields:
        wanted = np.concatenate(
            [getattr(episode, item.name)[: len(episode)] for episode in episodes]
        )
        column = table[item.name].combine_chunks()
        if isinstance(column, pa.FixedSizeListArray):
            assert column.type.list_size == wanted.shape[1]
            column = column.flatten()
        assert np.asarray(column).astype(item.type).tobytes() == wanted.tobytes(), item.name
        assert table.schema.field(item.name).metadata == {
            b"unit": item.unit.encode(),
            b"doc": item.doc.encode(),
        }


def test_the_table_lies_over_the_decoded_arrays():
    from coordlog.record.arrow import arrow_array

    values = np.arange(12.0).reshape(4, 3)
    array = arrow_array(values, pa.list_(pa.field("item", pa.float64(), nullable=False), 3))
    assert array.flatten().buffers()[1].address == values.ctypes.data


def test_what_is_decoded_for_learning_has_a_row_per_episode(folder, episodes):
    paths, digests, skipped = dataset.open(folder).paths, {}, []
    (found,) = dataset.decoded(paths, skipped=skipped, digests=digests)
    found.finals.validate(full=True)
    kept = [episode for episode in episodes if len(episode)]
    assert found.finals["length"].to_pylist() == list(map(len, kept))
    assert found.finals["state"].to_pylist() == [each.state[-1].tolist() for each in kept]
    assert not skipped
    assert list(digests) == list(paths)


def test_many_files_are_decoded_in_groups(tmp_path, rng):
    wanted = [
        make_episode(rng, length=int(rng.integers(1, 9)), layout=TINY, header=make_header(TINY))
        for _ in range(40)
    ]
    for index, episode in enumerate(wanted):
        write_episode(tmp_path / f"{index:02}.mcap", episode, attachments={}, display=False)
    table = dataset.open(tmp_path).to_table()
    assert np.array_equal(
        table["episode"], np.repeat(np.arange(40), [len(episode) for episode in wanted])
    )
    assert np.array_equal(table["time"], np.concatenate([episode.time[:-1] for episode in wanted]))


def test_broken_files_are_named_or_skipped(folder, episodes):
    bad = bad_files(folder, episodes[0].header)
    del bad["folder.mcap"]  # a folder is searched, not refused
    for name in bad:
        with pytest.raises(FormatError, match=name):
            dataset.open(folder / name)
    with pytest.raises(FormatError):
        dataset.open(folder)
    opened = dataset.open(folder, skip_broken=True)
    assert len(opened) == 4
    assert {skipped.path.name: skipped.reason for skipped in opened.skipped}.keys() == bad.keys()
    for skipped in opened.skipped:
        assert bad[skipped.path.name] in skipped.reason
        assert not skipped.reason.startswith(str(folder))


def test_a_file_found_damaged_while_reading_is_named_or_skipped(folder):
    data = bytearray((folder / "c" / "a.mcap").read_bytes())
    data[len(data) // 2] ^= 1
    (folder / "c" / "a.mcap").write_bytes(data)
    with pytest.raises(FormatError, match=r"c/a\.mcap: chunk"):
        list(dataset.open(folder))
    with pytest.raises(FormatError, match=r"c/a\.mcap: chunk"):
        dataset.open(folder).to_table()
    opened = dataset.open(folder, skip_broken=True)
    assert [len(episode) for episode in opened] == [30, 1, 0]
    assert [skipped.path for skipped in opened.skipped] == [folder / "c" / "a.mcap"]
    digests, skipped = {}, []
    (found,) = dataset.decoded(opened.paths, skipped=skipped, digests=digests)
    assert found.finals["length"].to_pylist() == [30, 1]
    assert [item.path for item in skipped] == [folder / "c" / "a.mcap"]
    table = dataset.open(folder, skip_broken=True).to_table()
    assert table["episode"].to_pylist() == [0] * 30 + [1]


def test_one_file_with_wrong_messages_does_not_spoil_its_group(tmp_path, rng):
    from coordlog.record.writer import EpisodeWriter

    for name in "ac":
        write_episode(
            tmp_path / f"{name}.mcap", make_episode(rng, length=3), attachments={}, display=False
        )
    wrong = make_episode(rng, length=3)
    with EpisodeWriter(tmp_path / "b.mcap", wrong.header, attachments={}, display=False) as writer:
        writer._tally.length = 7
        writer.write_steps(7, {name: values[:3] for name, values in wrong.columns.items()})
        writer.finish(
            {name: getattr(wrong, name)[-1] for name in ("time", "qpos", "qvel", "state")}
        )
    opened = dataset.open(tmp_path, skip_broken=True)
    assert opened.to_table()["episode"].to_pylist() == [0] * 3 + [2] * 3
    assert [skipped.path.name for skipped in opened.skipped] == ["b.mcap"]
    with pytest.raises(FormatError, match=r"b\.mcap: expected \[10\] steps"):
        dataset.open(tmp_path).to_table()


def test_different_robots_are_not_mixed_in_a_table(tmp_path, rng):
    write_episode(tmp_path / "a.mcap", make_episode(rng, length=2), attachments={}, display=False)
    write_episode(
        tmp_path / "b.mcap",
        make_episode(rng, length=2, layout=PLANAR),
        attachments={},
        display=False,
    )
    opened = dataset.open(tmp_path)
    assert [episode.header.layout.k for episode in opened] == [2, 3]
    with pytest.raises(
        SpecError,
        match=r"b\.mcap: expected the layout of a\.mcap, .*k=2.*, got .*k=3.*; open them as separate sets",
    ):
        opened.to_table()


def test_what_does_not_exist_is_said(tmp_path):
    with pytest.raises(StorageError, match="nowhere: no such file or folder"):
        dataset.open(tmp_path / "nowhere")
    assert len(dataset.open(tmp_path)) == 0
    with pytest.raises(SpecError, match="no episodes"):
        dataset.open(tmp_path).to_table()


def test_a_part_file_that_is_named_is_refused(folder, episodes):
    data = (folder / "a.mcap").read_bytes()
    (folder / "f.mcap.part").write_bytes(data[: len(data) // 2])
    with pytest.raises(TruncatedError, match="coordlog recover"):
        dataset.open(folder / "f.mcap.part")


def test_a_message_index_that_points_elsewhere_is_never_believed(tmp_path, rng):
    """A table finds its messages through the index, which no CRC of its own protects."""
    path = tmp_path / "a.mcap"
    episode = make_episode(rng, length=40, layout=TINY, header=make_header(TINY))
    write_episode(path, episode, attachments={}, display=True)
    data = path.read_bytes()
    wanted = dataset.open(path).to_table()
    refused = 0
    places = [
        at
        for span in walk(data)
        if span.opcode == Opcode.MESSAGE_INDEX
        for at in range(span.start, span.end, 5)
    ]
    with open(path, "r+b", buffering=0) as stream:
        for at in places:
            os.pwrite(stream.fileno(), bytes([data[at] ^ 1 << int(rng.integers(0, 8))]), at)
            table = outcome(dataset.open(path).to_table)
            refused += isinstance(table, FormatError)
            assert isinstance(table, FormatError) or table.equals(wanted)
            os.pwrite(stream.fileno(), data[at : at + 1], at)
    assert refused > 8 * 8
