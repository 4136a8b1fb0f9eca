"""Every number that is plotted is the file's, at its own time."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.interpolate import CubicHermiteSpline

from coordlog.view.recording import to_rerun
from tests.view.recordings import Recording, action_places


def values(recording, entity):
    return np.stack(recording.column(entity, "Scalars:scalars"))


def nanoseconds(time):
    return np.round(time * 1e9).astype(np.int64)


def groups(episode):
    robot = episode.header.env["robot"]
    return {"shared": robot["shared"]} | {arm["name"]: arm["joints"] for arm in robot["arms"]}


@pytest.mark.parametrize("scene", ["table", "planar"])
def test_joints_actions_and_limits_are_grouped_by_the_robots_spec(shows, scene, tmp_path):
    episode = shows[scene].episode
    recording = Recording(to_rerun([shows[scene]]), tmp_path / "a.rrd")
    joints, places = episode.header.env["action_joints"], action_places(episode)
    for group, names in groups(episode).items():
        index = [joints.index(name) for name in names]
        assert_array_equal(
            values(recording, f"/joint/{group}/executed"),
            episode.qpos[:, [places[i] for i in index]],
        )
        assert_array_equal(
            recording.times(f"/joint/{group}/executed", "Scalars:scalars"),
            nanoseconds(episode.time),
        )
        assert (
            recording.column(f"/joint/{group}/executed", "SeriesLines:names")[0].tolist() == names
        )
        assert_array_equal(values(recording, f"/action/{group}"), episode.action[:, index])
        assert_array_equal(
            recording.times(f"/action/{group}", "Scalars:scalars"), nanoseconds(episode.time[:-1])
        )
        limits = values(recording, f"/joint/{group}/limits")
        assert_array_equal(limits[0], limits[1])
        assert (limits[0, ::2] < limits[0, 1::2]).all()
    assert {f"/joint/{group}/executed" for group in groups(episode)} == {
        name for name in recording.entities if name.endswith("/executed") and "joint" in name
    }


def test_knots_and_break_points_are_the_files_bit_for_bit(smoothed, tmp_path):
    episode, path = smoothed.episode, smoothed.episode.path
    recording = Recording(to_rerun([smoothed]), tmp_path / "a.rrd")
    joints = episode.header.env["action_joints"]
    for group, names in groups(episode).items():
        index = [joints.index(name) for name in names]
        assert_array_equal(values(recording, f"/joint/{group}/knots"), path.knot_position[:, index])
        assert_array_equal(
            recording.times(f"/joint/{group}/knots", "Scalars:scalars"), nanoseconds(path.knot_time)
        )
        curve, times = (
            values(recording, f"/joint/{group}/spline"),
            recording.times(f"/joint/{group}/spline", "Scalars:scalars"),
        )
        assert_array_equal(curve[::4], path.position[:, index])
        assert_array_equal(times[::4], nanoseconds(path.time))
        between = CubicHermiteSpline(path.time, path.position[:, index], path.velocity[:, index])(
            times / 1e9
        )
        assert_allclose(curve, between, atol=1e-8)  # times are rounded to nanoseconds


@pytest.mark.parametrize("scene", ["table", "planar"])
def test_outcomes_stand_at_the_state_they_led_to(shows, scene, tmp_path):
    episode = shows[scene].episode
    recording = Recording(to_rerun([shows[scene]]), tmp_path / "a.rrd")
    assert_array_equal(values(recording, "/reward"), episode.reward)
    assert_array_equal(values(recording, "/distance"), episode.distance)
    assert_array_equal(values(recording, "/log_distance/palm"), np.log10(episode.distance))
    assert_array_equal(recording.times("/reward", "Scalars:scalars"), nanoseconds(episode.time[1:]))
    assert_allclose(values(recording, "/log_distance/goal"), np.log10(0.03))
    assert_allclose(values(recording, "/log_distance/boundary"), np.log10(0.10))


def test_a_distance_of_zero_has_a_logarithm(shows, tmp_path):
    episode = shows["free"].episode
    show = replace(
        shows["free"], episode=replace(episode, distance=np.zeros_like(episode.distance))
    )
    assert_allclose(
        values(Recording(to_rerun([show]), tmp_path / "a.rrd"), "/log_distance/palm"), -4.0
    )


def test_flags_change_state_where_they_change(shows, tmp_path):
    rng = np.random.default_rng(5)
    episode = shows["planar"].episode
    T, k = episode.boundary.shape
    flags = {"collision": rng.random(T) < 0.3, "instability": np.arange(T) == T - 1}
    flags |= {"boundary": rng.random((T, k)) < 0.5, "goal": np.zeros((T, k), bool)}
    recording = Recording(
        to_rerun([replace(shows["planar"], episode=replace(episode, **flags))]), tmp_path / "a.rrd"
    )
    columns = {"collision": flags["collision"], "instability": flags["instability"]}
    columns |= {
        f"{name}_{arm}": flags[name][:, i]
        for name in ("boundary", "goal")
        for i, arm in enumerate(episode.header.arms)
    }
    for name, flag in columns.items():
        states = [str(row[0]) for row in recording.column(f"/flag/{name}", "StateChange:state")]
        times = recording.times(f"/flag/{name}", "StateChange:state")
        assert all(first != second for first, second in pairwise(states))
        for t in range(T):  # the state that holds when the outcome of step t is known
            now = states[np.searchsorted(times, nanoseconds(episode.time[t + 1]), side="right") - 1]
            assert (now != "no") == flag[t], (name, t)
        assert states[0] == states[-1] == "no"
