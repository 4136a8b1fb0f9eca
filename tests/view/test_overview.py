"""A folder of episodes at one glance."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from coordlog.errors import ConfigError
from coordlog.view.outcome import KINDS, Outcome, by_urgency, kind, worth_a_look
from coordlog.view.overview import WINDOW, running, to_overview
from tests.view.recordings import Recording, simulated_palms

JUDGED = [name for name in KINDS if name != "without goals"]
"""How an episode with goals can end."""


@pytest.fixture
def folder(shows):
    """Five episodes that ended in five ways."""
    episode = shows["spheres"].episode
    up = np.ones(len(episode), bool)
    episode = replace(episode, collision=~up, instability=~up)
    fell = replace(episode, instability=up)
    ended = {
        "clean success": episode.with_result(success=True, clean=True),
        "success with collision": replace(episode, collision=up).with_result(success=True),
        "not reached": episode,
        "fell": fell,
        "aborted": fell.with_result(aborted="interrupted"),
    }
    assert list(ended) == JUDGED
    return [
        replace(shows["spheres"], name=name, episode=each, file=f"logs/{name}.mcap")
        for name, each in ended.items()
    ]


def test_episodes_are_told_apart_by_how_they_ended(folder, tmp_path):
    assert [kind(show.episode) for show in folder] == JUDGED
    recording = Recording(to_overview(folder), tmp_path / "a.rrd")
    states = [str(row[0]) for row in recording.column("/lane/result", "StateChange:state")]
    assert states == JUDGED
    assert_array_equal(
        recording.times("/lane/result", "StateChange:state", "episode"), np.arange(5)
    )


def test_paths_are_those_of_the_palms(folder, tmp_path):
    recording = Recording(to_overview(folder), tmp_path / "a.rrd")
    palms = simulated_palms(folder[0])
    strips = recording.column("/world/paths/spheres/fell", "LineStrips3D:strips")[0]
    assert_allclose(strips[0], palms[:, 0], atol=1e-6)
    assert_allclose(strips[1], palms[:, 1], atol=1e-6)
    cursor = recording.column("/world/cursor/path", "LineStrips3D:strips")
    assert len(cursor) == 5
    assert_allclose(cursor[3][1], palms[:, 1], atol=1e-6)
    goals = recording.column("/world/cursor/goal", "Points3D:positions")
    assert_allclose(goals[2], folder[2].episode.header.episode["goals"], atol=1e-6)


def test_table_text_and_histogram_count_every_episode(folder, tmp_path):
    recording = Recording(to_overview(iter(folder)), tmp_path / "a.rrd")
    files = [str(row[0]) for row in recording.column("/table", "file")]
    assert files == [show.file for show in reversed(folder)]
    ended = [str(row[0]) for row in recording.column("/table", "ended_as")]
    assert ended == list(reversed(JUDGED))
    said = str(recording.column("/about", "TextDocument:text")[0][0])
    assert "5 episodes" in said
    assert all(f"**1 {name}** (20.0%)" in said for name in JUDGED)
    named = [
        line.split(" | ")[1:3]
        for line in said.splitlines()
        if line[:3] in {f"| {i}" for i in range(5)}
    ]
    assert named == [[name, name] for name in reversed(JUDGED)]
    one = [str(row[0]) for row in recording.column("/episode", "TextDocument:text")]
    assert "coordlog view logs/not reached.mcap" in one[2]
    worst = [float(row[0]) for row in recording.column("/final", "Scalars:scalars")]
    assert_allclose(worst, 100 * folder[0].episode.distance[-1].max())
    rates = np.stack(recording.column("/rate", "Scalars:scalars"))
    assert_allclose(rates[-1], [0.2, 0.4, 0.2])


def test_the_earliest_fall_and_the_farthest_miss_come_first(folder):
    late, missed = Outcome.of(folder[3]), Outcome.of(folder[2])
    early = replace(late, steps=late.steps // 2)
    farther = replace(missed, final=missed.final + 0.1)
    clean = [Outcome.of(folder[0])] * 20
    assert by_urgency([*clean, missed, late, farther, early])[:5] == [23, 21, 22, 20, 0]
    assert worth_a_look([*clean, missed, late, farther, early]) == [23, 21, 22, 20, *range(8)]
    many = [*[missed] * 20, late, *clean]
    assert worth_a_look(many) == [20, *range(6), *range(21, 26)]


def test_robots_and_scenes_may_be_mixed_and_need_no_model(shows, tmp_path):
    mixed = [replace(shows[name], attachments={}) for name in ("planar", "table", "free")]
    recording = Recording(to_overview(mixed), tmp_path / "a.rrd")
    assert {f"/world/paths/{name}" for name in ("planar", "table", "free")} <= {
        entity.rsplit("/", 1)[0] for entity in recording.entities
    }
    assert not any(entity.startswith("/world/start") for entity in recording.entities)


def test_rates_are_means_of_the_last_episodes_only():
    flags = np.arange(3 * WINDOW) >= WINDOW
    rate = running(flags)
    assert_allclose(rate[: WINDOW + 1], np.append(np.zeros(WINDOW), 1 / WINDOW))
    assert_allclose(rate[2 * WINDOW - 1 :], 1.0)
    assert running(np.array([True]))[0] == 1.0


def test_no_episodes_is_an_error():
    with pytest.raises(ConfigError, match="at least one episode"):
        to_overview([])
