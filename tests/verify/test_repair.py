"""Whatever is cut off or damaged: a valid episode of true steps, or a clear refusal."""

import os
import shutil

import numpy as np
import pytest
from mcap.opcode import Opcode

from coordlog.errors import FormatError, StorageError
from coordlog.record.reader import read_attachments, read_episode, read_header
from coordlog.record.records import walk
from coordlog.record.writer import EpisodeWriter, write_episode
from coordlog.verify.file import check
from coordlog.verify.repair import ABORTED, recover, restored_whole, salvaged
from tests.record.test_reader import bad_files, foreign_mcap
from tests.synthetic import ATTACHMENTS, assert_same, make_episode, outcome, telling


def assert_prefix(got, original):
    """Every kept step, and the state it led to, is the original's."""
    for item in got.header.fields:
        count = len(got) + (item.when == "before")
        assert (
            getattr(got, item.name).tobytes() == getattr(original, item.name)[:count].tobytes()
        ), item.name
    assert (
        got.contacts.tobytes() == original.contacts[original.contacts["step"] < len(got)].tobytes()
    )
    assert got.header == original.header


def part_of(episode, folder, *, steps, display=False):
    """A recording that stopped without a word after so many steps."""
    with EpisodeWriter(
        folder / "a.mcap", episode.header, attachments=ATTACHMENTS, display=display
    ) as writer:
        for first in range(0, steps, 25):
            stop = min(first + 25, steps)
            low, high = np.searchsorted(episode.contacts["step"], (first, stop))
            columns = {name: values[first:stop] for name, values in episode.columns.items()}
            writer.write_steps(first, columns, contacts=episode.contacts[low:high])
    return writer.part


@pytest.mark.parametrize("display", [False, True])
def test_a_part_file_becomes_an_episode_up_to_the_last_known_outcome(tmp_path, episode, display):
    part = part_of(episode, tmp_path, steps=50, display=display)
    before = part.read_bytes()
    path, kept, lost, lossy = recover(part)
    assert (path, kept, lossy) == (tmp_path / "a.mcap", 49, True)
    assert lost == "step 49, whose outcome is not on disk, and whatever followed it"
    got = read_episode(path)
    assert_prefix(got, episode)
    assert got.result.aborted == ABORTED
    assert check(path) == []
    assert read_attachments(path) == ATTACHMENTS
    assert part.read_bytes() == before
    assert sorted(os.listdir(tmp_path)) == ["a.mcap", "a.mcap.part"]
    assert (b"/joint_states" in path.read_bytes()) == display


def test_a_cut_anywhere_gives_true_steps_or_a_refusal(tiny, tiny_file):
    data = tiny_file.read_bytes()
    kept = []
    for size in telling(data, within=43):
        assert restored_whole(data[:size]) is None
        salvage = outcome(salvaged, data[:size])
        if isinstance(salvage, FormatError):
            kept.append(0)
            continue
        assert_prefix(salvage.episode, tiny)
        assert salvage.lossy == (len(salvage.episode) < len(tiny))
        kept.append(len(salvage.episode))
    assert sorted(set(kept)) == [
        0,
        24,
        29,
        30,
    ]  # nothing, one chunk, two chunks, and the final state
    assert kept == sorted(kept)


def test_a_cut_at_any_byte_gives_a_valid_file_or_a_refusal(tiny_file, tmp_path):
    data, valid = tiny_file.read_bytes(), 0
    for size in range(0, len(data), 151):
        part = tmp_path / f"{size}.mcap.part"
        part.write_bytes(data[:size])
        recovered = outcome(recover, part)
        if isinstance(recovered, FormatError):
            assert str(recovered).startswith(f"{part}: ")
            assert not part.with_suffix("").exists()
            continue
        assert check(recovered.path) == []
        valid += 1
    assert valid > 15


def test_a_bit_flipped_anywhere_is_put_back_or_costs_steps_never_truth(tiny, tiny_file, rng):
    data = tiny_file.read_bytes()
    whole = 0
    for at in range(0, len(data), 29):
        damaged = bytearray(data)
        damaged[at] ^= 1 << int(rng.integers(0, 8))
        repaired = restored_whole(bytes(damaged))
        if repaired is not None:
            assert repaired in (
                data,
                bytes(damaged),
            )  # the flip may be in the summary, which is not part of an episode
            whole += 1
            continue
        salvage = outcome(salvaged, bytes(damaged))
        if not isinstance(salvage, FormatError):
            assert_prefix(salvage.episode, tiny)
    assert whole > len(data) // 29 * 0.5


def test_a_flipped_bit_is_put_back_byte_for_byte(file, episode, tmp_path):
    data = file.read_bytes()
    chunk = next(span for span in walk(data) if span.opcode == Opcode.CHUNK)
    damaged = bytearray(data)
    damaged[chunk.end - 5] ^= 64
    file.write_bytes(damaged)
    path, kept, lost, lossy = recover(file)
    assert (path.name, kept, lost, lossy) == (
        "episode.recovered.mcap",
        60,
        "nothing; a flipped bit was put back",
        False,
    )
    assert path.read_bytes() == data
    assert file.read_bytes() == damaged


def test_a_damaged_chunk_keeps_what_comes_before_it(file, episode, tmp_path):
    data = bytearray(file.read_bytes())
    chunk = [span for span in walk(data) if span.opcode == Opcode.CHUNK][1]
    data[chunk.end - 900 : chunk.end - 890] = b"0123456789"
    file.write_bytes(data)
    path, kept, lost, lossy = recover(file, tmp_path / "saved.mcap")
    assert (path.name, kept, lossy) == ("saved.mcap", 24, True)
    assert lost.startswith("step 24, whose outcome is not on disk")
    assert "chunk: " in lost
    assert_prefix(read_episode(path), episode)


def test_a_file_without_its_summary_loses_nothing(file, episode):
    data = file.read_bytes()
    part = file.rename(file.with_name("b.mcap.part"))
    for size, aborted in ((len(data) - 1, ""), (data.index(b"coordlog.result"), ABORTED)):
        part.write_bytes(data[:size])
        path, kept, lost, lossy = recover(part, part.with_name(f"{size}.mcap"))
        assert (kept, lossy) == (60, False)
        assert lost.startswith("nothing")
        assert read_episode(path).result.aborted == aborted
        assert_prefix(read_episode(path), episode)


def test_a_smoothed_episode_keeps_its_path(tmp_path, rng):
    episode = make_episode(rng, path=True)
    write_episode(tmp_path / "a.mcap", episode, attachments={}, display=False)
    os.truncate(tmp_path / "a.mcap", (tmp_path / "a.mcap").stat().st_size - 9)
    assert_same(read_episode(recover(tmp_path / "a.mcap").path), episode)


def test_a_finished_part_is_copied_and_a_finished_file_refused(file, episode):
    part = file.with_name("b.mcap.part")
    shutil.copy(file, part)
    path, kept, lost, lossy = recover(part)
    assert (path.name, kept, lost, lossy) == ("b.mcap", 60, "nothing", False)
    assert path.read_bytes() == file.read_bytes()
    with pytest.raises(
        FormatError, match=r"episode\.mcap: a finished episode: there is nothing to recover"
    ):
        recover(file)


def test_nothing_is_overwritten(tmp_path, episode):
    part = part_of(episode, tmp_path, steps=50)
    (tmp_path / "a.mcap").write_bytes(b"precious")
    with pytest.raises(StorageError, match=r"a\.mcap: the file exists and is not overwritten"):
        recover(part)
    assert (tmp_path / "a.mcap").read_bytes() == b"precious"
    assert sorted(os.listdir(tmp_path)) == ["a.mcap", "a.mcap.part"]


@pytest.mark.parametrize("steps", [0, 1])
def test_less_than_a_step_with_its_outcome_is_refused(tmp_path, episode, steps):
    with pytest.raises(FormatError, match=f"only {steps} steps are complete"):
        recover(part_of(episode, tmp_path, steps=steps))
    assert os.listdir(tmp_path) == ["a.mcap.part"]


def test_what_is_not_ours_is_refused(tmp_path, episode):
    for name in bad_files(tmp_path, episode.header):
        with pytest.raises(FormatError):
            recover(tmp_path / name)
    with pytest.raises(FormatError, match="not a coordlog episode"):
        recover(foreign_mcap(tmp_path / "foreign.mcap.part"))
    with pytest.raises(StorageError, match="No such file"):
        recover(tmp_path / "nowhere.mcap.part")


def test_a_damaged_attachment_costs_only_itself(file, episode):
    data = file.read_bytes()
    at = data.index(ATTACHMENTS["model.xml.zst"])
    data = data[:at] + b"\0\0\0" + data[at + 3 :]
    file.write_bytes(data)
    path, kept, lost, lossy = recover(file)
    assert (kept, lossy) == (60, False)
    assert "attachment 'model.xml.zst': expected CRC" in lost
    assert read_attachments(path).keys() == ATTACHMENTS.keys() - {"model.xml.zst"}
    assert read_header(path) == episode.header
