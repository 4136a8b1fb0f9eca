"""Every verb does in Python what its command does, and refuses in one sentence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import coordlog
from coordlog.errors import ConfigError, CoordlogError, StorageError


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two episodes of the planar arm."""
    folder = tmp_path_factory.mktemp("api") / "logs"
    files = coordlog.record("planar", episodes=2, out=folder, noise=0.05)
    assert sorted(folder.glob("*.mcap")) == files
    assert len(files) == 2
    return folder


def test_what_is_recorded_is_sound_and_opens(logs: Path) -> None:
    checked = coordlog.check(logs)
    assert (checked.findings, checked.files) == ([], 2)
    assert checked.steps == sum(len(episode) for episode in coordlog.open(logs))


def test_a_policy_of_ones_own_records(tmp_path: Path) -> None:
    class Still:
        def begin(self, ids, state, rngs):
            """Start nothing."""

        def act(self, ids, state):
            return np.zeros((len(ids), 8), dtype=np.float32)

    tables = {"env": {"max_steps": 3}}
    (file,) = coordlog.record("planar", Still(), episodes=1, out=tmp_path, tables=tables)
    (episode,) = coordlog.open(file)
    assert (len(episode), episode.header.policy["name"]) == (3, "Still")


def test_smoothing_takes_logs_or_a_path(logs: Path, tmp_path: Path) -> None:
    report = coordlog.smooth(logs, out=tmp_path / "smoothed")
    assert report["episodes"] == 2
    time = np.linspace(0.0, 1.0, 40)
    noisy = np.sin(time)[:, None] + 0.01 * np.random.default_rng(0).normal(size=(40, 1))
    result = coordlog.smooth(time, noisy)
    assert result.after.jerk < 0.1 * result.before.jerk
    assert coordlog.smooth(logs, tmp_path / "again", jobs=1)["episodes"] == 2
    for rest, said in (
        ((3,), "expected a folder, or joint angles"),
        (("a", "b"), "expected one folder"),
    ):
        with pytest.raises(CoordlogError, match=said):
            coordlog.smooth(logs, *rest)


def test_learning_gives_a_run_folder(logs: Path, tmp_path: Path) -> None:
    pytest.importorskip("torch")
    folder = coordlog.train(logs, out=tmp_path / "run", updates=2, eval_every=0)
    assert (folder / "run.json").is_file()


def test_a_set_of_another_program_comes_out(logs: Path, tmp_path: Path) -> None:
    done = coordlog.export(logs, to="parquet", out=tmp_path / "set")
    assert done.episodes == 2


def test_a_recording_of_the_viewer_is_saved_once(logs: Path, tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    (first, *_) = sorted(logs.glob("*.mcap"))
    coordlog.view(first, save=tmp_path / "one.rrd")
    with pytest.raises(StorageError, match="not overwritten"):
        coordlog.view(first, save=tmp_path / "one.rrd")


@pytest.mark.parametrize(
    ("call", "kind", "message"),
    [
        (lambda t: coordlog.record("planer", out=t), ConfigError, "unknown scene 'planer'"),
        (lambda t: coordlog.record("planar", out=t, env=3), ConfigError, "unknown option 'env'"),
        (lambda t: coordlog.record(object(), "expert", out=t), ConfigError, "expert: expected ran"),
        (lambda t: coordlog.record(object(), 3, out=t), ConfigError, "expected something with"),
        (lambda t: coordlog.check(t), CoordlogError, "no episodes"),
        (lambda t: coordlog.check(t, level="all"), ConfigError, "unknown level 'all'"),
        (lambda t: coordlog.smooth(t), ConfigError, "expected a folder"),
        (lambda t: coordlog.smooth(t, out=t / "o", smoth=1), ConfigError, "unknown option 'smoth'"),
        (lambda t: coordlog.train(t, out=t / "r", udates=1), ConfigError, "unknown option"),
        (lambda t: coordlog.export(t, to="lerobot", out=t / "e"), CoordlogError, "no episodes"),
        (lambda t: coordlog.view(t), CoordlogError, "no episodes"),
    ],
)
def test_what_cannot_be_is_one_sentence(call, kind, message, tmp_path: Path) -> None:
    with pytest.raises(kind, match=message):
        call(tmp_path)
