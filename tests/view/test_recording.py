"""Whole recordings: several shows, what is cut short, what cannot be shown."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from coordlog.errors import ConfigError, FormatError
from coordlog.view.camera import camera, crosses
from coordlog.view.recording import to_rerun
from coordlog.view.show import distinctions, stages
from tests.view.recordings import Recording


def named(show, name):
    return replace(show, name=name)


def text(recording, entity):
    return str(recording.column(entity, "TextDocument:text")[0][0])


def test_a_recording_and_its_blueprint_are_an_application_of_their_own(shows, tmp_path):
    names = set()  # a viewer shows all recordings of one application by the blueprint of the first
    for i in range(2):
        recording = Recording(to_rerun([shows["free"]]), tmp_path / f"{i}.rrd")
        (entry,), (blueprint,) = recording.reader.recordings(), recording.reader.blueprints()
        assert entry.application_id == blueprint.application_id
        assert entry.application_id.startswith("coordlog-")
        names.add(entry.application_id)
    assert len(names) == 2


def test_two_shows_stand_side_by_side_on_one_time_axis(shows, smoothed, tmp_path):
    recording = Recording(
        to_rerun([named(shows["table"], "raw"), named(smoothed, "smoothed")]), tmp_path / "a.rrd"
    )
    shift = [
        recording.column(f"/{name}/world", "Transform3D:translation")[0][0]
        for name in ("raw", "smoothed")
    ]
    assert_allclose(shift[1] - shift[0], [0.0, 1.0, 0.0])
    for name in ("raw", "smoothed"):
        times = recording.times(f"/{name}/world/robot/box", "Boxes3D:centers")
        assert len(times) == len(shows["table"].episode) + 1
    names = [
        recording.column(f"/{name}/joint/left/executed", "SeriesLines:names")[0][0]
        for name in ("raw", "smoothed")
    ]
    assert names == ["l_shoulder_y (raw)", "l_shoulder_y (smoothed)"]


def test_ghosts_stand_in_the_place_of_the_last_and_are_translucent(shows, tmp_path):
    recording = Recording(
        to_rerun([named(shows["table"], "a"), named(shows["table"], "b")], ghosts=True),
        tmp_path / "a.rrd",
    )
    alpha = {
        name: recording.column(f"/{name}/world/robot/box", "Boxes3D:colors")[0] & 255
        for name in "ab"
    }
    assert (alpha["a"] < 128).all()
    assert (alpha["b"] == 255).all()
    assert "/a/world/world/box" not in recording.entities
    assert "/b/world/world/box" in recording.entities
    assert_allclose(
        recording.column("/a/world", "Transform3D:translation")[0],
        recording.column("/b/world", "Transform3D:translation")[0],
    )


def test_robots_of_different_kinds_can_stand_together(shows, tmp_path):
    recording = Recording(
        to_rerun([named(shows["planar"], "planar"), named(shows["table"], "table")]),
        tmp_path / "a.rrd",
    )
    assert {"/planar/joint/middle/executed", "/table/joint/left/executed"} <= recording.entities


def test_names_are_shortened_to_what_tells_them_apart():
    assert distinctions(["table-s0-000003-ab", "table-s0-000004-ab"]) == ["000003", "000004"]
    assert distinctions(["raw", "smoothed"]) == ["raw", "smoothed"]
    assert distinctions(["a-b", "a-b-c"]) == ["b", "b-c"]


@pytest.mark.parametrize("names", [[], ["a", "a"]])
def test_shows_need_names_of_their_own(shows, names):
    with pytest.raises(ConfigError, match="each with a name of its own"):
        to_rerun([named(shows["free"], name) for name in names])


def test_a_name_that_is_no_path_is_escaped(shows, tmp_path):
    shown = [named(shows["free"], "runs/1 a"), named(shows["free"], "runs/2 b")]
    recording = Recording(to_rerun(shown), tmp_path / "a.rrd")
    assert any(entity.endswith("/reward") and "1" in entity for entity in recording.entities)


def test_an_aborted_episode_says_so_first(shows, tmp_path):
    whole = Recording(to_rerun([shows["free"]]), tmp_path / "whole.rrd")
    assert "/banner" not in whole.entities
    cut = replace(shows["free"], episode=shows["free"].episode.with_result(aborted="interrupted"))
    recording = Recording(to_rerun([cut]), tmp_path / "cut.rrd")
    assert "interrupted" in text(recording, "/banner")
    assert "cut short" in text(recording, "/banner")
    assert "ABORTED" in text(recording, "/about")


def test_an_episode_cut_before_its_first_step_is_shown(shows, tmp_path):
    episode = shows["free"].episode
    columns = {name: getattr(episode, name)[:1] for name in ("time", "qpos", "qvel", "state")}
    led_to = (
        "action",
        "reward",
        "distance",
        "boundary",
        "goal",
        "collision",
        "instability",
        "terminated",
        "truncated",
        "contacts",
    )
    columns |= {name: getattr(episode, name)[:0] for name in led_to}
    empty = replace(
        episode, result=replace(episode.result, length=0, aborted="interrupted"), **columns
    )
    recording = Recording(to_rerun([replace(shows["free"], episode=empty)]), tmp_path / "a.rrd")
    assert len(recording.column("/world/robot/box", "Boxes3D:centers")) == 1


def test_a_diverged_state_is_shown_as_far_as_it_is_one(shows, tmp_path):
    episode = shows["free"].episode
    qpos = episode.qpos.copy()
    qpos[-1] = np.nan
    show = replace(
        shows["free"], episode=replace(episode, qpos=qpos).with_result(aborted="diverged: NaN")
    )
    assert np.isfinite(np.concatenate(camera(stages([show])))).all()
    recording = Recording(to_rerun([show]), tmp_path / "a.rrd")
    assert np.isfinite(recording.column("/world/robot/box", "Boxes3D:centers")[-2]).all()


def test_the_text_names_policy_result_and_lineage(smoothed, tmp_path):
    header = replace(
        smoothed.episode.header,
        lineage={
            "parents": ["ab" * 32],
            "transform": "smooth local",
            "parameters": {"clearance": 0.005},
        },
    )
    show = replace(
        smoothed, episode=replace(smoothed.episode, header=header), file="out/table|x.mcap"
    )
    said = text(Recording(to_rerun([show]), tmp_path / "a.rrd"), "/about")
    for word in (
        "table",
        "test seed 3 episode 0",
        "random",
        "smooth local",
        "abababababab",
        "clearance: 0.005",
        "out/table x.mcap",
        "left",
    ):
        assert word in said


def test_without_a_model_there_is_one_sentence(shows):
    with pytest.raises(FormatError, match="no model attached"):
        to_rerun([replace(shows["free"], attachments={})])


def test_the_model_must_be_the_episodes(shows):
    with pytest.raises(FormatError, match="expected nq = 34"):
        to_rerun([replace(shows["free"], attachments=shows["planar"].attachments)])


def test_the_eye_sees_everything(shows):
    for scene in ("table", "planar"):
        stage = stages([shows[scene]])[0]
        view = camera([stage])
        towards = (view.target - view.eye) / np.linalg.norm(view.target - view.eye)
        points = stage.motion.palms.reshape(-1, 3) - view.eye
        angle = np.arccos(points @ towards / np.linalg.norm(points, axis=1))
        assert angle.max() < np.radians(40.0)  # half the diagonal of the view


def test_a_line_through_a_box_is_found():
    low, high = np.array([1.0, -1.0, -1.0]), np.array([2.0, 1.0, 1.0])
    ends = np.array(
        [[3.0, 0.0, 0.0], [0.5, 0.0, 0.0], [3.0, 9.0, 0.0], [1.5, 0.0, 0.0], [-3.0, 0.0, 0.0]]
    )
    assert crosses(np.zeros(3), ends, low, high).tolist() == [True, False, False, True, False]
