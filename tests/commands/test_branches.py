"""Episodes that begin in the middle of logged ones."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import coordlog
from coordlog.api.logs import load_logs
from coordlog.cli import app
from coordlog.errors import CoordlogError
from coordlog.record.branches import EARLIEST, LATEST, Parents, leave
from tests.spoken import sound

SEEDS = 200


def run(*args: str | Path, cache: Path) -> str:
    return sound(*args, cache=cache).stdout


def left(mishap: np.ndarray) -> set[int]:
    return {leave(np.random.default_rng(seed), mishap) for seed in range(SEEDS)}


def test_an_episode_is_left_shortly_before_its_first_mishap() -> None:
    mishap = np.zeros(80, dtype=bool)
    mishap[[50, 51, 70]] = True
    assert left(mishap) == set(range(50 - EARLIEST, 50 - LATEST + 1))


@pytest.mark.parametrize("first", [0, LATEST - 1, LATEST + 2])
def test_an_early_mishap_leaves_what_there_is_before_it(first: int) -> None:
    mishap = np.zeros(20, dtype=bool)
    mishap[first] = True
    assert left(mishap) == set(range(max(0, first - LATEST) + 1))


def test_an_episode_without_mishap_is_left_anywhere() -> None:
    assert left(np.zeros(7, dtype=bool)) == set(range(7))


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory, cache: Path) -> Path:
    folder = tmp_path_factory.mktemp("logs")
    run(
        "record",
        "--scene",
        "spheres",
        "--policy",
        "random",
        "--episodes",
        "4",
        "--out",
        folder / "fell",
        cache=cache,
    )
    return folder


def test_a_branch_begins_in_the_very_state_it_was_left_in(
    logs: Path, cache: Path, tmp_path: Path
) -> None:
    run(
        "record",
        "--branch",
        logs,
        "--policy",
        "still",
        "--episodes",
        "3",
        "--out",
        tmp_path,
        cache=cache,
    )
    parents = {episode.header.episode["index"]: episode for episode in coordlog.open(logs)}
    branches = list(coordlog.open(tmp_path))
    assert len(branches) == 3
    assert len({branch.header.episode["id"] for branch in branches}) == 3
    for branch in branches:
        parent, step = (
            parents[branch.header.episode["index"]],
            branch.header.lineage["parameters"]["step"],
        )
        assert branch.header.lineage["transform"] == "branch"
        assert 0 <= step < len(parent.action)
        assert branch.qpos[0].tobytes() == parent.qpos[step].tobytes()
        assert branch.qvel[0].tobytes() == parent.qvel[step].tobytes()
        assert branch.state[0].tobytes() == parent.state[step].tobytes()
        assert branch.time[0] == 0.0
        assert branch.header.episode["goals"] == parent.header.episode["goals"]


def test_a_branch_replays_from_its_own_file(logs: Path, cache: Path, tmp_path: Path) -> None:
    run(
        "record",
        "--branch",
        logs,
        "--episodes",
        "2",
        "--noise",
        "0.2",
        "--out",
        tmp_path,
        cache=cache,
    )
    run("check", tmp_path, "--level", "replay", cache=cache)


def test_equal_seeds_leave_at_equal_steps_and_others_elsewhere(
    logs: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    parents = Parents(load_logs([logs], where="", skip_broken=False, jobs=1))
    steps = [
        [len(parents.leave(index, seed=seed)[1].actions) for index in range(8)]
        for seed in (0, 0, 1)
    ]
    assert steps[0] == steps[1]
    assert steps[0] != steps[2]


def test_conditions_choose_among_the_parents(logs: Path, cache: Path, tmp_path: Path) -> None:
    said = json.loads(
        run(
            "record",
            "--branch",
            logs,
            "--where",
            "index in (1, 3)",
            "--policy",
            "still",
            "--out",
            tmp_path,
            "--json",
            cache=cache,
        )
    )
    assert said["episodes"] == 2
    assert {episode.header.episode["index"] for episode in coordlog.open(tmp_path)} == {1, 3}


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (
            ("--where", "not clean"),
            "--where: chooses among the logs of --branch, of which there are none",
        ),
        (
            ("--branch", "LOGS", "--where", "index = 9"),
            "--where: no episode of 4 satisfies: index = 9",
        ),
        (("--branch", "EMPTY"), "no logs: no episodes (.mcap) under"),
        (
            ("--branch", "LOGS", "--scene", "table"),
            "--scene: expected the scene of the logs to branch from, 'spheres', got 'table'",
        ),
        (
            ("--branch", "LOGS", "--config", "FAST"),
            "do not lead here to where they led when it was recorded",
        ),
    ],
)
def test_what_cannot_be_branched_is_said_in_a_sentence(
    logs: Path,
    cache: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    args: tuple[str, ...],
    said: str,
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    (tmp_path / "empty").mkdir()
    (tmp_path / "fast.toml").write_text("[env]\nspeed = 3.0\n")
    places = {
        "LOGS": str(logs),
        "EMPTY": str(tmp_path / "empty"),
        "FAST": str(tmp_path / "fast.toml"),
    }
    with pytest.raises(
        CoordlogError
    ) as refusal:  # in this process: starting one takes longer than refusing
        app(
            ["record", *(places.get(arg, arg) for arg in args), "--out", str(tmp_path / "out")],
            standalone_mode=False,
        )
    assert said in str(refusal.value)
    assert refusal.value.exit_code == 2
