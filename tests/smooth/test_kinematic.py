"""Observed episodes smoothed: slides, endless joints and meshes of the user's model, or no model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from coordlog.exchange.importing import Plan, import_source
from coordlog.exchange.robot_model import read_model
from coordlog.record.recording import Recording
from coordlog.smooth.batch import Job, smooth_file
from tests.kinematics.test_any_joint import GANTRY

SETTINGS = {"method": "local", "cutoff": "max", "max_deviation": 0.3, "clearance": 0.002}


def motion() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    s = np.linspace(0.0, 1.0, 120)
    time = np.arange(120) * 0.02 + 0.0005 * rng.normal(size=120)
    bump = 16.0 * s**2 * (1.0 - s) ** 2
    q = np.stack([-0.5 + 1.4 * s, 0.13 * bump - 0.1, 8.0 * s], axis=1)
    q += 0.004 * rng.normal(size=q.shape) * np.minimum(1.0, 20.0 * np.minimum(s, 1.0 - s))[:, None]
    return time - time[0], q


def imported(folder: Path, *, turn: bool, model: bool) -> Path:
    """A CSV of the gantry's joints, imported; the wrist's angle wrapped, or left out."""
    time, q = motion()
    q[:, 2] = (q[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    names = ["x", "z", "turn"][: 3 if turn else 2]
    np.savetxt(
        folder / "a.csv",
        np.c_[time, q[:, : len(names)]],
        delimiter=",",
        header=",".join(["time", *names]),
        comments="",
        fmt="%.17g",
    )
    (folder / "gantry.xml").write_text(GANTRY)
    robot = read_model(str(folder / "gantry.xml")) if model else None
    done = import_source(folder / "a.csv", folder / "logs", Plan(), robot)
    return done.paths[0]


def test_the_path_takes_the_place_of_the_joints_and_says_so(tmp_path: Path) -> None:
    log = imported(tmp_path, turn=True, model=True)
    row = smooth_file(Job(log, tmp_path / "out.mcap", SETTINGS, True, False))
    parameters = row["parameters"]
    assert (row["status"], parameters["certified"], parameters["steps_of"]) == (
        "smoothed",
        True,
        "path",
    ), row["reason"]
    raw, smooth = Recording(log), Recording(tmp_path / "out.mcap")
    assert smooth.header.lineage["parents"] == [raw.digest]
    assert smooth.header.kind == "observed"
    np.testing.assert_array_equal(smooth.episode.time, raw.episode.time)
    away = np.abs(smooth.episode.qpos - raw.episode.qpos)
    away[:, 2] = np.minimum(away[:, 2] % (2.0 * np.pi), 2.0 * np.pi - away[:, 2] % (2.0 * np.pi))
    assert away.max() <= 0.3
    assert max(parameters["deviation"].values()) == pytest.approx(away.max(), abs=1e-6)
    assert parameters["clearance"]["after"] >= 0.002
    assert parameters["after"]["jerk"] < 0.1 * parameters["before"]["jerk"]
    assert smooth.episode.path is not None


def test_without_a_model_nothing_is_certified(tmp_path: Path) -> None:
    log = imported(tmp_path, turn=False, model=False)
    row = smooth_file(Job(log, tmp_path / "out.mcap", SETTINGS, True, False))
    assert (row["status"], row["parameters"]["certified"]) == ("partly", False)
    assert "carries no model" in row["reason"]


def test_a_wrapped_joint_of_no_model_is_refused_by_name(tmp_path: Path) -> None:
    log = imported(tmp_path, turn=True, model=False)
    row = smooth_file(Job(log, tmp_path / "out.mcap", SETTINGS, True, False))
    assert row["status"] == "skipped"
    assert "turn steps by 6.2" in row["reason"]
    assert not (tmp_path / "out.mcap").exists()
