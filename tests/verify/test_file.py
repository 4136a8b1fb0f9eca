"""Everything that can be wrong is noticed; what is right is left alone."""

import os
import zlib
from dataclasses import replace

import numpy as np
import pytest
from mcap.opcode import Opcode

from coordlog.episode import CONTACT
from coordlog.errors import StorageError
from coordlog.record.chunk import Batch, compose, definitions, encode, expand, split
from coordlog.record.container import Container
from coordlog.record.records import unpack_attachment, unpack_metadata, walk
from coordlog.record.writer import LIBRARY, EpisodeWriter, write_episode
from coordlog.spec import STEP
from coordlog.verify.file import check
from tests.synthetic import (
    ATTACHMENTS,
    HUMANOID,
    PLANAR,
    make_episode,
    rewards,
    telling,
    with_true_result,
)


def checked(path, level="content"):
    return check(path, level=level)


def written(path, episode, *, display=False):
    """Write the episode as it is, its result included."""
    with EpisodeWriter(path, episode.header, attachments=ATTACHMENTS, display=display) as writer:
        if len(episode):
            columns = {name: values[: len(episode)] for name, values in episode.columns.items()}
            writer.write_steps(0, columns, contacts=episode.contacts)
        writer._tally.result = lambda aborted: episode.result
        writer.finish(
            {name: episode.columns[name][-1] for name in episode.before},
            path=episode.path,
        )
    return path


@pytest.mark.parametrize("ending", ["goal", "fall", "limit", "interrupted"])
@pytest.mark.parametrize("layout", [HUMANOID, PLANAR], ids=["humanoid", "planar"])
@pytest.mark.parametrize("display", [False, True])
def test_a_sound_episode_has_no_findings(tmp_path, rng, layout, ending, display):
    episode = make_episode(rng, layout=layout, ending=ending, path=display)
    write_episode(tmp_path / "a.mcap", episode, attachments=ATTACHMENTS, display=display)
    assert checked(tmp_path / "a.mcap") == []


def test_an_episode_without_steps_or_contacts_is_sound(tmp_path, rng):
    for name, length in (("a", 0), ("b", 1)):
        episode = make_episode(rng, length=length, collisions=0, ending="interrupted")
        write_episode(tmp_path / f"{name}.mcap", episode, attachments={}, display=True)
        assert checked(tmp_path / f"{name}.mcap") == []


# --- bytes -------------------------------------------------------------------------------------------------------------


def test_a_flipped_bit_is_noticed_wherever_it_is(tiny_file, rng):
    data = tiny_file.read_bytes()
    bits = rng.integers(0, 8, len(data)).tolist()
    quiet = []
    with open(tiny_file, "r+b", buffering=0) as stream:
        for at, bit in ((at, bits[at]) for at in telling(data)):
            os.pwrite(stream.fileno(), bytes([data[at] ^ 1 << bit]), at)
            if not checked(tiny_file, "file"):
                quiet.append(at)
            os.pwrite(stream.fileno(), data[at : at + 1], at)
    assert checked(tiny_file, "file") == []
    assert quiet == []


def test_a_bit_flipped_in_a_chunk_names_a_step_it_reached(file, episode):
    data = file.read_bytes()
    first = 0
    for span in [span for span in walk(data) if span.opcode == Opcode.CHUNK][:-1]:
        chunk = expand(memoryview(data)[span.start : span.end])
        count = len(split(chunk, len(definitions(chunk)))[1])
        for at in range(span.start, span.end, 457):
            with open(file, "r+b") as stream:
                stream.seek(at)
                stream.write(bytes([data[at] ^ 4]))
            (finding,) = checked(file)
            assert finding.level == "file"
            assert f"bit 2 of byte {at} of the file is flipped" in finding.got
            assert (
                finding.step is None and finding.field in ("schema", "channel")
            ) or first <= finding.step < first + count
            with open(file, "r+b") as stream:
                stream.write(data)
        first += count
    assert first == len(episode)


def test_a_bit_flipped_in_a_stored_state_names_step_field_and_values(
    tmp_path, rng, episode, monkeypatch
):
    monkeypatch.setattr(
        "coordlog.record.chunk.LEVEL", -5
    )  # the fastest level stores states as they are
    monkeypatch.delattr("coordlog.record.chunk._local.compressor", raising=False)
    path = tmp_path / "a.mcap"
    write_episode(path, episode, attachments={}, display=False)
    data, found = path.read_bytes(), 0
    for step in range(0, 60, 7):
        index = int(rng.integers(0, 33))
        at = data.find(episode.qvel[step, index].tobytes())
        if at < 0:
            continue  # a match of the compressor split it
        found += 1
        damaged = bytearray(data)
        damaged[at + 2] ^= 1
        path.write_bytes(damaged)
        (finding,) = checked(path)
        assert (finding.step, finding.field, finding.wanted) == (
            step,
            f"qvel[{index}]",
            str(episode.qvel[step, index]),
        )
        assert finding.got.startswith(str(np.frombuffer(damaged[at : at + 8], "<f8")[0]))
    monkeypatch.delattr("coordlog.record.chunk._local.compressor")
    assert found > 3


def test_damage_of_several_bits_names_the_steps_of_the_chunk(file):
    data = bytearray(file.read_bytes())
    chunk = [span for span in walk(data) if span.opcode == Opcode.CHUNK][1]
    data[chunk.end - 900 : chunk.end - 890] = b"0123456789"
    file.write_bytes(data)
    (finding,) = checked(file)
    assert (finding.step, finding.field, finding.wanted) == (
        25,
        "chunk",
        "steps 25 to 49, undamaged",
    )


@pytest.mark.parametrize(
    ("needle", "field"),
    [
        (b"coordlog.policy", "metadata "),
        (b"model.xml.zst", "attachment "),
        (b'"table"', None),
        (b"coordlog/", None),
    ],
)
def test_damage_outside_the_chunks_is_named(file, needle, field):
    data = bytearray(file.read_bytes())
    at = data.find(needle)
    if at < 0:
        at = data.index(needle.strip(b'"'))
    data[at + len(needle) - 3] ^= 1
    file.write_bytes(data)
    (finding,) = checked(file)
    assert finding.step is None
    assert "flipped" in finding.got or "not a coordlog episode" in finding.got
    assert field is None or finding.field.startswith(field)


def test_a_truncated_file_lacks_its_commit_marker(file):
    file.write_bytes(file.read_bytes()[:-1])
    (finding,) = checked(file, "file")
    assert "commit marker" in finding.got
    assert str(finding).startswith(f"{file}: file: expected a finished episode, got ends after")


def test_a_missing_file_is_an_error(tmp_path):
    with pytest.raises(StorageError, match="No such file"):
        checked(tmp_path / "nowhere.mcap")


# --- structure ---------------------------------------------------------------------------------------------------------


def resealed(path, change):
    """Change the data section or the summary in place, and make both CRCs right again."""
    data = bytearray(path.read_bytes())
    start = int.from_bytes(data[-28:-20], "little")
    change(data, start)
    data[start - 4 : start] = zlib.crc32(data[: start - 13]).to_bytes(4, "little")
    data[-12:-8] = zlib.crc32(data[start:-12]).to_bytes(4, "little")
    path.write_bytes(data)


@pytest.mark.parametrize(
    ("opcode", "field"),
    [
        (Opcode.SCHEMA, "summary Schema 0"),
        (Opcode.CHANNEL, "summary Channel 0"),
        (Opcode.STATISTICS, "summary Statistics 0"),
        (Opcode.CHUNK_INDEX, "summary ChunkIndex 0"),
        (Opcode.ATTACHMENT_INDEX, "summary AttachmentIndex 0"),
        (Opcode.METADATA_INDEX, "summary MetadataIndex 0"),
        (Opcode.SUMMARY_OFFSET, "summary SummaryOffset 0"),
    ],
)
def test_a_summary_that_does_not_fit_is_noticed_behind_a_right_crc(file, opcode, field):
    def change(data, start):
        span = next(span for span in walk(data, start) if span.opcode == opcode)
        data[span.start] ^= 1

    resealed(file, change)
    assert field in [finding.field for finding in checked(file, "file")]


def test_a_message_index_that_does_not_fit_is_noticed_behind_a_right_crc(file):
    def change(data, _):
        span = next(span for span in walk(data) if span.opcode == Opcode.MESSAGE_INDEX)
        data[span.end - 1] ^= 1

    resealed(file, change)
    assert [finding.field for finding in checked(file, "file")] == ["message index of channel 1"]


def test_a_footer_that_points_elsewhere_is_noticed_behind_a_right_crc(file):
    def change(data, _):
        data[-20] ^= 1

    resealed(file, change)
    assert "footer" in [finding.field for finding in checked(file, "file")]


@pytest.mark.parametrize(("offset", "length"), [(0, 0), (-4, 4), (1 << 62, 1 << 62)])
def test_a_summary_that_misplaces_the_marker_is_noticed_behind_a_right_crc(file, offset, length):
    def change(data, start):
        last = [span for span in walk(data, start) if span.opcode == Opcode.METADATA_INDEX][-1]
        at = start - 13 + offset if offset <= 0 else offset
        data[last.start : last.start + 16] = at.to_bytes(8, "little") + length.to_bytes(8, "little")

    resealed(file, change)
    assert "summary MetadataIndex 4" in [finding.field for finding in checked(file, "file")]


def test_another_schema_text_is_noticed(tmp_path, episode, monkeypatch):
    from coordlog.record import topics
    from coordlog.record.schema import SCHEMAS

    monkeypatch.setattr(
        topics,
        "SCHEMAS",
        SCHEMAS | {STEP.name: SCHEMAS[STEP.name].replace("float64 time", "float64 when")},
    )
    topics._topics.cache_clear()
    write_episode(tmp_path / "a.mcap", episode, attachments={}, display=False)
    topics._topics.cache_clear()
    (finding,) = checked(tmp_path / "a.mcap", "file")
    assert f"schema {STEP.name}: expected 'float64 time', got no field of that name" in finding.got


def written_anew(data, change):
    """Our layout written again by somebody else, one record of the steps changed, all CRCs right."""
    container = Container(LIBRARY)
    for span in walk(data, stop=int.from_bytes(data[-28:-20], "little")):
        content = data[span.start : span.end]
        if span.opcode == Opcode.METADATA:
            container.add_metadata(*unpack_metadata(content))
        elif span.opcode == Opcode.ATTACHMENT:
            name, attached = unpack_attachment(memoryview(content))
            container.add_attachment(name, attached, media_type="", log_time=0)
        elif span.opcode == Opcode.CHUNK:
            chunk = expand(memoryview(content))
            defined = definitions(chunk)
            for inner in walk(defined, 0):
                books = container.books
                kept = books.schemas if inner.opcode == Opcode.SCHEMA else books.channels
                kept[defined[inner.start - 9 : inner.end]] = None
            batches = [
                Batch(
                    channel,
                    np.array([int.from_bytes(record[15:23], "little") for record in records]),
                    [change(bytearray(record)) for record in records],
                )
                for channel, records in split(chunk, len(defined)).items()
            ]
            container.add_chunk(compose(defined, batches))
    container.finish()
    return container.drain()


def test_a_value_changed_behind_right_crcs_in_our_layout_is_noticed(tmp_path, file):
    def last_bit(record):
        record[-1] ^= 1
        return bytes(record)

    data, path = file.read_bytes(), tmp_path / "anew.mcap"
    path.write_bytes(written_anew(data, bytes))
    assert path.read_bytes() != data
    assert checked(path, "file") == checked(path) == []
    path.write_bytes(written_anew(data, last_bit))
    (finding,) = checked(path, "file")
    assert "the messages are not those that were recorded" in finding.got


def test_a_whole_file_is_checked_without_expanding_it(file, monkeypatch):
    from coordlog.verify import file as module

    monkeypatch.setattr(module, "structure", lambda *_: pytest.fail("looked into"))
    assert checked(file, "file") == []
    data = bytearray(file.read_bytes())
    data[-29] ^= 1  # the CRC of the data section
    file.write_bytes(data)
    assert checked(file, "file") != []


# --- content -----------------------------------------------------------------------------------------------------------


def changed(episode, name, step, value, *, keep_result=False):
    column = getattr(episode, name).copy()
    column[step] = value
    other = replace(episode, **{name: column})
    return other if keep_result else with_true_result(other)


@pytest.mark.parametrize(
    ("name", "step", "value", "field"),
    [
        ("time", 7, 7.5 * 0.04, "time"),
        ("qpos", 11, np.nan, "qpos[0]"),
        ("state", 60, np.inf, "state[0]"),
        ("action", 3, -1.5, "action[0]"),
        ("distance", 5, 1e-3, "goal[0]"),
        ("boundary", 9, True, "boundary[0]"),
        ("goal", 12, True, "goal[0]"),
        ("reward", 20, 0.0, "reward[0]"),
        ("instability", 30, True, "terminated"),
        ("terminated", 31, True, "terminated"),
        ("truncated", 32, True, "terminated"),
        ("truncated", 59, True, "truncated"),
    ],
)
def test_a_rule_that_is_broken_names_the_step(tmp_path, episode, name, step, value, field):
    found = checked(written(tmp_path / "a.mcap", changed(episode, name, step, value)))
    assert {finding.level for finding in found} == {"content"}
    assert (step, field) in [(finding.step, finding.field) for finding in found]


def test_the_last_bit_of_a_reward_counts(tmp_path, episode):
    wanted = episode.reward[20]
    other = changed(episode, "reward", 20, np.nextafter(wanted, np.inf))
    (finding,) = checked(written(tmp_path / "a.mcap", other))
    assert (finding.step, finding.field, finding.wanted) == (20, "reward[0]", str(wanted[0]))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("returns", (1.0, 2.0)),
        ("success", False),
        ("clean", True),
        ("terminated", False),
        ("truncated", True),
        ("digest", "00"),
    ],
)
def test_a_marker_that_does_not_fit_is_noticed(tmp_path, rng, key, value):
    episode = make_episode(rng, collisions=0.5)
    other = replace(episode, result=replace(episode.result, **{key: value}))
    (finding,) = checked(written(tmp_path / "a.mcap", other))
    assert finding.field == f"result {key}"


def contact(**changes):
    row = np.array([(3, 0, 1, 2, 0.001, 0, 0, 0)], CONTACT)
    for name, value in changes.items():
        row[name] = value
    return row


@pytest.mark.parametrize(
    "rows",
    [
        contact(depth=-1),
        contact(depth=np.nan),
        contact(geom1=2),
        contact(geom2=20),
        contact(substep=-1),
        contact(x=np.inf),
    ],
)
def test_an_impossible_contact_is_noticed(tmp_path, rng, rows):
    episode = make_episode(rng, collisions=0)
    collision = episode.collision.copy()
    collision[3] = True
    columns = (
        episode.distance,
        episode.boundary,
        episode.goal,
        collision,
        episode.instability,
        episode.header.env["reward"],
    )
    other = with_true_result(
        replace(episode, collision=collision, contacts=rows, reward=rewards(*columns))
    )
    (finding,) = checked(written(tmp_path / "a.mcap", other))
    assert (finding.step, finding.field) == (3, "contacts")


def test_collisions_and_contacts_must_agree(tmp_path, episode):
    step = int(episode.contacts["step"][0])
    other = replace(episode, contacts=episode.contacts[episode.contacts["step"] != step])
    (finding,) = checked(written(tmp_path / "a.mcap", other))
    assert (finding.step, finding.field, finding.wanted, finding.got) == (
        step,
        "collision",
        "False",
        "True",
    )


def test_an_episode_that_just_stops_must_say_why(tmp_path, rng):
    episode = make_episode(rng, ending="interrupted")
    other = replace(episode, result=replace(episode.result, aborted=""))
    (finding,) = checked(written(tmp_path / "a.mcap", other))
    assert (finding.step, finding.field, finding.got) == (59, "terminated", "neither")


def test_steps_beyond_the_limit_are_noticed(tmp_path, rng):
    episode = make_episode(rng, length=151)
    assert [
        (finding.step, finding.field) for finding in checked(written(tmp_path / "a.mcap", episode))
    ] == [(150, "step")]


def test_diverged_physics_is_sound_when_marked_and_a_finding_when_not(tmp_path, rng):
    episode = make_episode(rng, ending="diverged: qacc is not finite")
    qpos, distance, reward = episode.qpos.copy(), episode.distance.copy(), episode.reward.copy()
    qpos[-1], distance[-1], reward[-1] = np.nan, np.nan, np.nan
    flags = {name: getattr(episode, name).copy() for name in ("boundary", "goal")}
    for flag in flags.values():
        flag[-1] = False
    diverged = with_true_result(
        replace(episode, qpos=qpos, distance=distance, reward=reward, **flags)
    )
    assert checked(written(tmp_path / "a.mcap", diverged)) == []
    hidden = replace(diverged, result=replace(diverged.result, aborted="interrupted"))
    assert {
        (finding.step, finding.field) for finding in checked(written(tmp_path / "b.mcap", hidden))
    } == {
        (60, "qpos[0]"),
        (59, "reward[0]"),
        (59, "distance[0]"),
    }


@pytest.mark.parametrize(
    ("name", "value"),
    [("knot_weight", -1.0), ("knot_position", np.nan), ("position", np.nan), ("velocity", np.inf)],
)
def test_an_impossible_path_is_noticed(tmp_path, rng, name, value):
    episode = make_episode(rng, path=True)
    values = getattr(episode.path, name).copy()
    values[3] = value
    (finding,) = checked(
        written(tmp_path / "a.mcap", replace(episode, path=replace(episode.path, **{name: values})))
    )
    assert (finding.field, finding.got) == (f"path {name}", str(value))


def test_a_display_topic_that_tells_another_story_is_noticed(tmp_path, episode, monkeypatch):
    from coordlog.record import messages

    true = encode

    def lying(codec, channel, *, log_time, sequence, columns):
        if "position" in columns:
            columns = columns | {"position": columns["position"] + (sequence == 31)[:, None]}
        return true(codec, channel, log_time=log_time, sequence=sequence, columns=columns)

    with monkeypatch.context() as patch:
        patch.setattr(messages, "encode", lying)
        write_episode(tmp_path / "a.mcap", episode, attachments={}, display=True)
    (finding,) = checked(tmp_path / "a.mcap")
    assert (finding.step, finding.field) == (31, "/joint_states")


def test_metadata_that_disagree_are_a_finding(tmp_path, episode):
    header = replace(episode.header, env=episode.header.env | {"state": ["only one"]})
    (finding,) = checked(written(tmp_path / "state.mcap", replace(episode, header=header)))
    assert (finding.field, finding.wanted, finding.got) == ("metadata state", "25 entries", "1")
