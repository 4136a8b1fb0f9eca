"""Clocks are judged and cut without a number being changed."""

from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from coordlog.errors import ConfigError, FormatError
from coordlog.exchange.joints import (
    JointMap,
    doubts,
    in_radians,
    joints_of,
    mapped,
    read_map,
    require_known,
)
from coordlog.exchange.motion import NS, Motion, prepared, timing

ARM = """<mujoco><worldbody><body><geom size=".1"/>
<joint name="shoulder_pan" range="-3 3"/><body pos="0 0 .1"><geom size=".1"/>
<joint name="elbow" range="-150 150"/><body pos="0 0 .1"><geom size=".1"/>
<joint name="rail" type="slide" axis="0 0 1" range="0 .5"/></body></body></body></worldbody></mujoco>"""


@pytest.fixture(scope="module")
def known():
    return joints_of(mujoco.MjModel.from_xml_string(ARM.replace("-3 3", "-170 170")))


def moved(stamps, position=None, names=("a", "b"), **more):
    stamps = np.asarray(stamps, np.int64)
    if position is None:
        position = np.arange(len(stamps) * len(names), dtype=float).reshape(-1, len(names))
    return Motion(Path("x.csv"), "csv", "all rows", tuple(names), stamps, position, **more)


def cut(motion, *, gap=None, starts=None, split_clock=False, rate=0.0):
    return list(prepared(motion, gap=gap, starts=starts, split_clock=split_clock, rate=rate))


def test_a_clock_is_described_as_it_ran():
    stamps = np.cumsum([0, 10, 10, 11, 9, 400, 10, 0, 10]) * 1_000_000
    said = timing(stamps)
    assert (said.samples, said.period) == (9, 0.01)
    assert said.gaps == ((4, 0.4),)
    assert said.duplicates == (7,)
    assert said.jitter == pytest.approx(np.std([10, 10, 11, 9, 10, 10]) / 1e3)
    assert "1 gaps (longest 0.4 s), 1 repeated stamps" in str(said)


@given(
    st.lists(st.integers(1, 5 * NS), min_size=1, max_size=30),
    st.floats(0.1, 4.0),
)
def test_cutting_at_gaps_loses_no_sample_and_leaves_no_gap(steps, gap):
    motion = moved(np.cumsum([0, *steps]))
    pieces = cut(motion, gap=gap)
    np.testing.assert_array_equal(np.concatenate([p.stamps for p in pieces]), motion.stamps)
    np.testing.assert_array_equal(np.concatenate([p.position for p in pieces]), motion.position)
    assert all((np.diff(piece.stamps) <= gap * NS).all() for piece in pieces)
    assert all(b.stamps[0] - a.stamps[-1] > gap * NS for a, b in pairwise(pieces))


def test_cuts_are_made_where_they_are_asked_for():
    motion = moved(np.arange(10) * NS)
    pieces = cut(motion, starts=np.array([3 * NS, int(6.5 * NS), 99 * NS]))
    assert [len(piece) for piece in pieces] == [3, 4, 3]


def test_time_that_runs_backwards_is_refused_or_cut():
    motion = moved([0, 10, 20, 15, 25])
    with pytest.raises(FormatError, match=r"x.csv: all rows: sample 3: expected time to go on"):
        cut(motion)
    assert [len(piece) for piece in cut(motion, split_clock=True)] == [3, 2]


def test_repeated_stamps_are_left_out_and_said():
    (piece,) = cut(moved([0, 10, 10, 20]))
    assert piece.stamps.tolist() == [0, 10, 20]
    assert piece.position[:, 0].tolist() == [0, 2, 6]
    assert "1 samples repeat the stamp before" in piece.notes[0]


def test_a_number_that_is_none_is_named():
    position = np.ones((4, 2))
    position[2, 1] = np.nan
    with pytest.raises(FormatError, match="sample 2: joint b: expected a number, got nan; 1 of 4"):
        cut(moved([0, 1, 2, 3], position))


def test_nothing_is_resampled_unless_asked_and_then_by_straight_lines():
    stamps = np.array([0, 7, 20, 31]) * 10_000_000
    motion = moved(stamps, np.stack([stamps / NS, -2 * stamps / NS], axis=1))
    assert cut(motion)[0].notes == ()
    (piece,) = cut(motion, rate=50)
    assert piece.stamps.tolist() == list(range(0, 310_000_001, 20_000_000))
    np.testing.assert_allclose(piece.position[:, 1], -2 * piece.stamps / NS, atol=1e-12)
    assert "resampled from 4 to 16 samples at 50 Hz" in piece.notes[0]


def test_joints_that_the_model_lacks_are_named_with_the_nearest(known):
    motion = moved([0, 1], names=("shoulder_pan_joint", "elbow"))
    with pytest.raises(FormatError, match=r"1 of 2 joints .*shoulder_pan_joint \(nearest: should"):
        require_known(motion, known)
    with pytest.raises(FormatError, match="elbow twice"):
        require_known(moved([0, 1], names=("elbow", "elbow")), known)


def test_a_map_renames_scales_and_leaves_out(tmp_path, known):
    path = tmp_path / "map.toml"
    path.write_text('[joints]\na = "elbow"\nb = ""\n[scale]\na = 0.5\n[offset]\na = 1\n')
    motion = mapped(moved([0, 1, 2], velocity=np.ones((3, 2))), read_map(path))
    assert motion.names == ("elbow",)
    assert motion.position[:, 0].tolist() == [1, 2, 3]
    assert motion.velocity[:, 0].tolist() == [0.5, 0.5, 0.5]
    assert motion.notes == ("left out as told: b",)
    require_known(motion, known)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[joint]\na = 1", "expected the tables joints, scale, offset, got 'joint'"),
        ("[scale]\na = 'x'", "expected a number, got 'x'"),
        ("[joints", "expected TOML"),
    ],
)
def test_a_map_that_is_none_is_said(tmp_path, text, said):
    path = tmp_path / "map.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=said):
        read_map(path)


def test_a_map_of_a_joint_that_is_not_there_is_said():
    with pytest.raises(ConfigError, match=r"--joints: c: not in x.csv: all rows \(nearest"):
        mapped(moved([0, 1]), JointMap(scale={"c": 1.0}))


def test_degrees_are_suspected_said_and_turned_only_when_told(known):
    angles = np.stack([np.linspace(-90, 120, 5), np.linspace(0, 100, 5)], axis=1)
    motion = moved(np.arange(5), angles, names=("shoulder_pan", "elbow"))
    (said,) = doubts(motion, known)
    assert "shoulder_pan reaches 120: degrees are suspected; --degrees" in said
    turned = in_radians(motion, True, [True, True])
    np.testing.assert_allclose(turned.position, np.radians(angles))
    assert doubts(turned, known) == []
    assert in_radians(motion, False, [True, True]) is motion


def test_a_joint_outside_its_range_is_said(known):
    motion = moved([0, 1], np.array([[0.0], [0.9]]), names=("rail",))
    assert doubts(motion, known) == ["rail goes from 0 to 0.9, outside the model's 0 to 0.5"]
