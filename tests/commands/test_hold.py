"""A second task, through the command line: recorded, checked bit for bit, smoothed, learnt from,
shown. Nothing outside its folder in tasks/ knows of it."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import coordlog
from coordlog.cli import app

PACKAGE = Path(coordlog.__file__).parent
NAMED = re.compile(r"""["']hold["']|HoldTask|HoldConfig|tasks\.hold""")


def run(*args: str | Path, wanted: int = 0) -> str:
    done = CliRunner().invoke(app, [str(arg) for arg in args], catch_exceptions=False)
    assert done.exit_code == wanted, done.output
    return done.output


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hold")
    out = ("--out", folder, "--envs", "2", "--threads", "1")
    found = json.loads(run("record", "--scene", "hold", "--episodes", "2", *out, "--json"))
    assert (found["episodes"], found["success"], found["length"]) == (2, 1.0, 75.0)
    return folder


def test_it_is_recorded_with_goals_that_move_and_every_number_comes_again(logs: Path) -> None:
    assert "2 episodes, 150 steps simulated again and compared" in run("check", logs)
    for episode in coordlog.open(logs):
        assert episode.header.env["task"]["name"] == "hold"
        assert episode.header.env["task"]["seconds"] == 3.0
        assert episode.goals.shape == (76, 6)
        assert abs(episode.goals[-1] - episode.goals[0]).max() > 0.02
        assert episode.result.success
        assert episode.goal.all()


def test_one_changed_goal_is_found(logs: Path, tmp_path: Path) -> None:
    from dataclasses import replace

    from coordlog.record.reader import read_attachments, read_episode
    from coordlog.record.writer import write_episode

    (first, *_) = sorted(logs.glob("*.mcap"))
    episode = read_episode(first)
    goals = episode.goals.copy()
    goals[40, 2] += 1e-12
    changed = replace(episode, columns={**episode.columns, "goals": goals})
    write_episode(
        tmp_path / first.name, changed, attachments=read_attachments(first), display=False
    )
    assert "step 39" in run("check", tmp_path, wanted=1), "the goal after it is another"


def test_it_is_smoothed_learnt_from_and_shown(logs: Path, tmp_path: Path) -> None:
    smoothed, learnt = tmp_path / "smoothed", tmp_path / "run"
    assert "2 of 2: 2 smoothed" in run("smooth", logs, "--out", smoothed)
    run("check", smoothed)
    assert all(episode.result.success for episode in coordlog.open(smoothed))
    run("view", next(logs.glob("*.mcap")), "--no-open")
    budget = ("--updates", "20", "--eval-every", "20", "--eval-episodes", "1")
    budget += ("--set", "network.hidden=[32,32]", "--set", "replay.batch=32")
    run("train", "--from", logs, "--out", learnt, *budget)
    again = ("--episodes", "1", "--split", "test", "--out", tmp_path / "again")
    run("record", "--policy", learnt, *again)
    assert "1 episodes, 75 steps" in run("check", tmp_path / "again")


def test_nothing_outside_its_folder_and_the_registries_names_it() -> None:
    allowed = {"tasks/registry.py", "tasks/scene.py"}
    for path in PACKAGE.rglob("*.py"):
        place = path.relative_to(PACKAGE).as_posix()
        if place.startswith("tasks/hold/") or place in allowed:
            continue
        text = path.read_text(encoding="utf-8")
        if not NAMED.search(text):
            continue
        tree = ast.parse(text)
        said = {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant)}
        used = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
        modules = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
        assert "hold" not in said, place
        assert not {"HoldTask", "HoldConfig"} & used, place
        assert not any(str(name).startswith("coordlog.tasks.hold") for name in modules), place


def test_where_the_task_is_not_installed_its_logs_replay_as_far_as_the_core_goes(
    logs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from coordlog.episode import INITIAL_STATE
    from coordlog.mjcf import load_attached
    from coordlog.record.reader import read_attachments, read_episode
    from coordlog.sim.replay import Log, replay
    from coordlog.tasks import registry
    from coordlog.verify.physics import check_replay

    paths = sorted(logs.glob("*.mcap"))
    monkeypatch.delitem(registry.TASKS, "hold")
    assert check_replay(paths).findings == []
    episode, attached = read_episode(paths[0]), read_attachments(paths[0])
    start = np.frombuffer(attached[INITIAL_STATE])
    (trace,) = replay([Log.of(episode, load_attached(attached), start)])
    assert {"qpos", "qvel", "state", "ctrl", "torque"} <= set(trace.columns)
    assert not {"reward", "terminated", "truncated", "distance"} & set(trace.columns)
    for name, column in trace.columns.items():
        assert column.tobytes() == getattr(episode, name).tobytes(), name
