"""One file smoothed: what it costs in reads, compilations and simulations, and how a folder is
planned."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path

import mujoco
import mujoco.batch  # compiles a model of its own when it loads
import pytest

from coordlog.errors import ConfigError, CoordlogError
from coordlog.record.reader import read_episode
from coordlog.sim.simulation import Simulation
from coordlog.sim.task import BoundTask
from coordlog.smooth.batch import Job, plan, smooth_file, summary

SETTINGS = {"method": "local", "cutoff": "max", "max_deviation": None, "clearance": 0.005}
DATA = Path(__file__).parents[1] / "data"


@pytest.fixture(scope="module")
def log() -> Path:
    return next(
        path
        for path in sorted(DATA.rglob("*.mcap"))
        if read_episode(path).header.episode["scene"] == "planar"
    )


def test_a_file_is_read_once_its_model_compiled_once_and_its_task_built_once(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    counts: Counter[str] = Counter()

    def counted(name, call):
        def spy(*args, **kwargs):
            counts[name] += 1
            return call(*args, **kwargs)

        return spy

    opened = os.open

    def open_(path, *args, **kwargs):
        counts["read"] += Path(os.fspath(path)) == log
        return opened(path, *args, **kwargs)

    monkeypatch.setattr(os, "open", open_)
    compile_ = mujoco.MjModel.from_xml_string
    monkeypatch.setattr(mujoco.MjModel, "from_xml_string", counted("compiled", compile_))
    monkeypatch.setattr(BoundTask, "__init__", counted("task", BoundTask.__init__))
    monkeypatch.setattr(Simulation, "step", counted("step", Simulation.step))
    row = smooth_file(Job(log, tmp_path / log.name, SETTINGS, True, False))
    assert row["status"] in ("smoothed", "partly"), row["reason"]
    assert (counts["read"], counts["compiled"], counts["task"]) == (1, 1, 1)
    assert counts["step"] == row["parameters"]["steps"]["after"]  # the log itself is not simulated


def test_a_log_that_cannot_be_used_is_a_row_and_no_error(tmp_path: Path) -> None:
    strange = tmp_path / "strange.mcap"
    strange.write_bytes(b"nothing")
    row = smooth_file(Job(strange, tmp_path / "out.mcap", SETTINGS, True, False))
    assert (row["status"], row["parameters"]) == ("skipped", {})
    assert str(strange) in row["reason"]
    assert not (tmp_path / "out.mcap").exists()


def test_nothing_to_smooth_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(CoordlogError, match=r"no episodes \(\.mcap\)"):
        plan([tmp_path], tmp_path.parent / "elsewhere", SETTINGS)


def test_unknown_options_are_refused_before_a_file_is_read(log: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="unknown method 'best'"):
        plan([log], tmp_path, SETTINGS | {"method": "best"})


def test_a_summary_is_of_what_was_executed(log: Path, tmp_path: Path) -> None:
    batch = plan([log], tmp_path, SETTINGS, write=False)
    rows = [smooth_file(job) for job in batch.jobs]
    found = summary(rows, SETTINGS, batch.files, wanted=1, seconds=1.0)
    assert (found["wanted"], found["episodes"], found["resumed"]) == (1, 1, 0)
    parameters = rows[0]["parameters"]
    ratio = parameters["after"]["jerk"] / parameters["before"]["jerk"]
    assert found["median"]["jerk"] == pytest.approx(ratio)
    assert not list(tmp_path.iterdir())
