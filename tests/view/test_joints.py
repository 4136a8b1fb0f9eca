"""Tests for the figure of joint angles and hand paths: what is drawn is what the episode holds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from coordlog.record.reader import read_attachments, read_episode
from coordlog.view.joints import joints_figure
from tests.spoken import sound


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A raw log and the smoothed one."""
    folder = tmp_path_factory.mktemp("plot")
    noisy = ("--scene", "planar", "--episodes", "1", "--noise", "0.2")
    sound("record", *noisy, "--out", folder / "raw")
    sound("smooth", folder / "raw", "--out", folder / "new")
    (raw,) = (folder / "raw").glob("*.mcap")
    return raw, folder / "new" / raw.name


def test_every_joint_is_drawn_with_its_knots_its_spline_and_its_p(files: tuple[Path, Path]) -> None:
    episode = read_episode(files[1])
    figure = joints_figure(episode, read_attachments(files[1]))
    *panels, space = figure.axes
    assert [axes.get_ylabel() for axes in panels] == [
        "spine [rad]",
        "left arm [rad]",
        "middle arm [rad]",
        "right arm [rad]",
    ]
    labels = [text.get_text() for axes in panels for text in axes.get_legend().get_texts()]
    joints = episode.header.env["action_joints"]
    assert [label.split()[0] for label in labels] == joints
    assert all("p = " in label for label in labels)
    dots, line, executed = panels[1].lines[:3]
    joint = joints.index("left_1")
    assert (dots.get_xdata() == episode.path.knot_time).all()
    assert (dots.get_ydata() == episode.path.knot_position[:, joint]).all()
    assert np.isin(episode.path.position[:, joint].round(9), np.round(line.get_ydata(), 9)).all()
    assert len(executed.get_xdata()) == len(episode) + 1
    assert len(space.lines) == 3 * 3  # knots, spline and goal of each arm


def test_a_raw_log_has_neither_knots_nor_p(files: tuple[Path, Path]) -> None:
    figure = joints_figure(read_episode(files[0]), read_attachments(files[0]))
    assert len(figure.axes[0].lines) == 2
    assert "p =" not in figure.axes[0].get_legend().get_texts()[0].get_text()


def test_the_command_writes_a_picture_and_replaces_none(
    files: tuple[Path, Path], tmp_path: Path
) -> None:
    out = tmp_path / "deeper" / "joints.png"
    call = ("plot", files[1], files[0], "--out")
    sound(*call, out)
    assert out.read_bytes()[:4] == b"\x89PNG"
    assert "not overwritten" in sound(*call, out, code=2).stderr
    assert ".svg" in sound(*call, tmp_path / "joints.docx", code=2).stderr
    assert "got a folder" in sound("plot", files[1].parent, code=2).stderr
