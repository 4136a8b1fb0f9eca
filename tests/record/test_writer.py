"""Writing, and reading back: the identity, bit for bit."""

import os
import threading
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from coordlog.episode import CONTACT
from coordlog.errors import FormatError, SpecError, StorageError
from coordlog.record.reader import (
    read_attachments,
    read_episode,
    read_header,
    read_summary,
)
from coordlog.record.writer import EpisodeWriter, write_episode
from coordlog.spec import Layout
from tests.synthetic import (
    ATTACHMENTS,
    HUMANOID,
    PLANAR,
    START,
    TINY,
    assert_same,
    make_episode,
    make_header,
)

layouts = st.builds(
    Layout,
    st.integers(1, 9),
    st.integers(1, 9),
    st.integers(1, 9),
    st.integers(1, 9),
    st.integers(1, 5),
)


def columns_of(episode, first, stop):
    return {name: values[first:stop] for name, values in episode.columns.items()}


def final_of(episode):
    return {name: episode.columns[name][-1] for name in episode.before}


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    layout=layouts | st.sampled_from([HUMANOID, PLANAR]),
    length=st.integers(0, 80),
    seed=st.integers(0, 2**32),
    display=st.booleans(),
    path=st.booleans(),
    ending=st.sampled_from(["goal", "fall", "limit", "interrupted"]),
)
def test_reading_gives_what_was_written(tmp_path, layout, length, seed, display, path, ending):
    episode = make_episode(
        np.random.default_rng(seed), length=length, layout=layout, path=path, ending=ending
    )
    file = tmp_path / "episode.mcap"
    file.unlink(missing_ok=True)
    assert write_episode(file, episode, attachments=ATTACHMENTS, display=display) == episode.result
    assert_same(read_episode(file), episode)
    assert read_attachments(file) == ATTACHMENTS
    assert read_header(file) == episode.header
    assert read_summary(file).result == episode.result
    assert read_summary(file).size == file.stat().st_size
    assert os.listdir(tmp_path) == ["episode.mcap"]


def test_returns_and_digest_do_not_depend_on_the_blocks(tmp_path, episode):
    results = []
    for size in (1, 7, 60):
        with EpisodeWriter(
            tmp_path / f"{size}.mcap", episode.header, attachments={}, display=False
        ) as writer:
            for first in range(0, 60, size):
                stop = min(first + size, 60)
                low, high = np.searchsorted(episode.contacts["step"], (first, stop))
                writer.write_steps(
                    first, columns_of(episode, first, stop), contacts=episode.contacts[low:high]
                )
            results.append(writer.finish(final_of(episode)))
        assert_same(read_episode(tmp_path / f"{size}.mcap"), episode)
    assert results == [episode.result] * 3


def test_equal_input_gives_equal_bytes_also_from_other_threads(tmp_path, rng, episode):
    other = make_episode(rng, length=33)

    def write(name):
        with EpisodeWriter(
            tmp_path / f"{name}-other.mcap", other.header, attachments={}, display=True
        ) as noise:
            noise.write_steps(0, columns_of(other, 0, 33), contacts=other.contacts)
            write_episode(tmp_path / f"{name}.mcap", episode, attachments=ATTACHMENTS, display=True)

    write("a")
    thread = threading.Thread(target=write, args=("b",))
    thread.start()
    thread.join()
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_values_that_are_not_finite_are_written_and_read(tmp_path, episode):
    qpos, reward = episode.qpos.copy(), episode.reward.copy()
    qpos[-1], qpos[-2, 0], reward[-1] = np.nan, -np.inf, np.nan
    diverged = replace(
        episode,
        qpos=qpos,
        reward=reward,
        result=replace(episode.result, aborted="diverged: qpos is not finite"),
    )
    result = write_episode(tmp_path / "nan.mcap", diverged, attachments={}, display=True)
    got = read_episode(tmp_path / "nan.mcap")
    assert got.qpos.tobytes() == qpos.tobytes()
    assert np.isnan(got.result.returns).all()
    assert repr(got.result) == repr(result)
    assert got.result.aborted == "diverged: qpos is not finite"


def test_log_time_is_the_start_plus_simulated_time_in_whole_nanoseconds(tmp_path, episode):
    from mcap.reader import make_reader

    write_episode(tmp_path / "a.mcap", episode, attachments={}, display=True)
    with open(tmp_path / "a.mcap", "rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            assert (
                message.log_time == message.publish_time == START + message.sequence * 40_000_000
            ), channel.topic


def test_everything_known_at_the_start_is_on_disk_before_the_first_step(tmp_path, episode):
    with EpisodeWriter(
        tmp_path / "a.mcap", episode.header, attachments=ATTACHMENTS, display=False
    ) as writer:
        assert read_header(writer.part) == episode.header
        assert read_attachments(writer.part) == ATTACHMENTS
        size = writer.part.stat().st_size
        writer.write_steps(
            0, columns_of(episode, 0, 25), contacts=episode.contacts[episode.contacts["step"] < 25]
        )
        assert writer.part.stat().st_size > size + 25 * 67 * 4
        assert not writer.path.exists()


def test_an_exception_leaves_the_part_and_discard_deletes_it(tmp_path, episode):
    with (
        pytest.raises(KeyError),
        EpisodeWriter(tmp_path / "a.mcap", episode.header, attachments={}, display=False),
    ):
        raise KeyError
    assert os.listdir(tmp_path) == ["a.mcap.part"]
    with EpisodeWriter(
        tmp_path / "b.mcap", episode.header, attachments={}, display=False
    ) as writer:
        writer.discard()
    assert os.listdir(tmp_path) == ["a.mcap.part"]


@pytest.mark.parametrize("taken", ["a.mcap", "a.mcap.part"])
def test_a_name_that_is_taken_is_refused(tmp_path, episode, taken):
    (tmp_path / taken).write_bytes(b"precious")
    with pytest.raises(StorageError, match=f"{taken}: the file exists and is not overwritten"):
        EpisodeWriter(tmp_path / "a.mcap", episode.header, attachments={}, display=False)
    assert (tmp_path / taken).read_bytes() == b"precious"


def test_a_name_that_is_taken_meanwhile_is_left_alone(tmp_path, episode):
    with EpisodeWriter(
        tmp_path / "a.mcap", episode.header, attachments={}, display=False
    ) as writer:
        writer.write_steps(0, columns_of(episode, 0, 60), contacts=episode.contacts)
        (tmp_path / "a.mcap").write_bytes(b"precious")
        with pytest.raises(
            StorageError, match=r"File exists; what was recorded stays in .*a\.mcap\.part"
        ):
            writer.finish(final_of(episode))
    assert (tmp_path / "a.mcap").read_bytes() == b"precious"
    (tmp_path / "a.mcap").unlink()
    (tmp_path / "a.mcap.part").rename(tmp_path / "a.mcap")
    assert_same(read_episode(tmp_path / "a.mcap"), episode)


def test_columns_of_another_shape_or_type_are_named(tmp_path, episode):
    with EpisodeWriter(
        tmp_path / "a.mcap", episode.header, attachments={}, display=False
    ) as writer:
        good = columns_of(episode, 0, 25)
        with pytest.raises(
            SpecError,
            match=r"action: expected float32 of shape \(25, 13\), got float64 of shape \(25, 13\)",
        ):
            writer.write_steps(0, good | {"action": good["action"].astype(float)})
        with pytest.raises(
            SpecError,
            match=r"qvel: expected float64 of shape \(25, 33\), got float64 of shape \(24, 33\)",
        ):
            writer.write_steps(0, good | {"qvel": good["qvel"][1:]})
        with pytest.raises(SpecError, match=r"reward: expected .* got nothing"):
            writer.write_steps(
                0, {name: column for name, column in good.items() if name != "reward"}
            )
        with pytest.raises(
            SpecError, match="first_step: expected 0 and at least one row, got 5 and 25"
        ):
            writer.write_steps(5, good)
        with pytest.raises(SpecError, match="time: expected strictly increasing"):
            writer.write_steps(0, good | {"time": good["time"][::-1]})
        with pytest.raises(SpecError, match="time: expected finite"):
            writer.write_steps(0, good | {"time": good["time"] * np.nan})
        with pytest.raises(
            SpecError, match="contacts: expected steps 0 to 24 in order, got 25 to 25"
        ):
            writer.write_steps(0, good, contacts=np.array([(25, 0, 0, 1, 0, 0, 0, 0)], CONTACT))
        with pytest.raises(SpecError, match="contacts: expected rows of"):
            writer.write_steps(0, good, contacts=np.zeros(3))
        writer.write_steps(0, good)  # nothing of the above was written
        with pytest.raises(SpecError, match="time: expected strictly increasing"):
            writer.write_steps(25, columns_of(episode, 24, 59))
        writer.write_steps(25, columns_of(episode, 25, 60))
        with pytest.raises(SpecError, match="qpos: expected"):
            writer.finish(final_of(episode) | {"qpos": np.zeros(3)})
        writer.finish(final_of(episode))
    assert len(read_episode(tmp_path / "a.mcap")) == 60


def test_a_header_of_another_schema_version_is_refused(tmp_path):
    with pytest.raises(
        SpecError, match="header: schema version 3; this release reads versions 1 to 2"
    ):
        EpisodeWriter(
            tmp_path / "a.mcap", make_header(TINY, schema_version=3), attachments={}, display=False
        )
    assert os.listdir(tmp_path) == []


def test_decoded_arrays_cannot_be_written_to(file):
    episode = read_episode(file)
    with pytest.raises(ValueError, match="read-only"):
        episode.qpos[0, 0] = 1


def test_a_file_whose_steps_are_out_of_order_is_refused(tmp_path, episode):
    with EpisodeWriter(
        tmp_path / "a.mcap", episode.header, attachments={}, display=False
    ) as writer:
        writer.write_steps(0, columns_of(episode, 0, 25))
        writer._tally.length = 30
        writer.write_steps(30, columns_of(episode, 30, 60))
        writer.finish(final_of(episode))
    with pytest.raises(
        FormatError, match=r"a.mcap: .*expected \[60\] steps and a final state, got 55"
    ):
        read_episode(tmp_path / "a.mcap")
