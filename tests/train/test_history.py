"""Tests for the curves of runs: where a point stands, what a mean is a mean of, and which runs
belong together."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from coordlog.errors import ConfigError, FormatError, StorageError
from coordlog.train.history import Line, band, grouped, load_history
from tests.train.histories import evaluation, training, write_run

LIVE = [
    training(0, 0.0, step=64, episodes=0, total=0),
    training(20, 0.2, step=128, episodes=8, total=8),
    evaluation(20, 0.4, step=128),
    training(40, 0.0, step=256, episodes=0, total=8),
    training(60, 0.6, step=384, episodes=16, total=24),
    evaluation(70, 0.8, step=448),
    training(80, 0.9, step=512, episodes=8, total=32),
]


def test_a_figure_stands_where_its_row_does_and_empty_intervals_have_none(tmp_path: Path) -> None:
    history = load_history(write_run(tmp_path / "run", LIVE, mode="live"))
    assert history.live
    for against, wanted in {
        "updates": [20, 60, 80],
        "steps": [128, 384, 512],
        "episodes": [8, 24, 32],
    }.items():
        x, y = history.line("success", kind="training", against=against)  # type: ignore[arg-type]
        assert x.tolist() == wanted
        assert y.tolist() == [0.2, 0.6, 0.9], "a row of no episodes says nothing of success"
    assert history.line("success", kind="evaluation", against="episodes").x.tolist() == [8, 28], (
        "between the counts around it"
    )
    assert history.line("score", kind="evaluation", against="steps").y.tolist() == [4.0, 8.0]


def test_of_rows_at_one_place_the_last_counts_and_a_null_does_not(tmp_path: Path) -> None:
    rows = [evaluation(10, 0.1), evaluation(10, 0.2), {**evaluation(20, 0.3), "score": None}]
    history = load_history(write_run(tmp_path / "run", rows))
    assert not history.live
    assert [
        part.tolist() for part in history.line("success", kind="evaluation", against="updates")
    ] == [[10, 20], [0.2, 0.3]]
    assert history.line("score", kind="evaluation", against="updates").x.tolist() == [10]


def test_a_band_is_the_mean_and_sample_deviation_as_far_as_all_runs_go() -> None:
    lines = [
        Line(np.array([0.0, 10.0, 20.0]), np.array([0.0, 1.0, 1.0])),
        Line(np.array([5.0, 10.0, 30.0]), np.array([1.5, 2.0, 4.0])),
    ]
    x, mean, deviation = band(lines)
    assert x.tolist() == [5, 10, 20]
    pairs = [(0.5, 1.5), (1.0, 2.0), (1.0, 3.0)]
    np.testing.assert_allclose(mean, [np.mean(pair) for pair in pairs])
    np.testing.assert_allclose(deviation, [abs(a - b) / np.sqrt(2) for a, b in pairs])
    assert band(lines[:1]).deviation.tolist() == [0, 0, 0]
    apart = [Line(np.array([0.0]), np.array([1.0])), Line(np.array([5.0]), np.array([1.0]))]
    assert len(band(apart).x) == 0


def test_runs_that_differ_in_nothing_but_the_seed_belong_together(tmp_path: Path) -> None:
    rows = [evaluation(10, 0.1)]
    folders = [write_run(tmp_path / f"mask{seed}", rows, seed=seed) for seed in range(3)]
    folders += [
        write_run(tmp_path / f"sum{seed}", rows, seed=seed, gradient="sum") for seed in range(2)
    ]
    folders += [write_run(tmp_path / "live", LIVE, mode="live")]
    found = grouped([load_history(folder) for folder in folders])
    assert {
        label: [history.folder.name for history in group] for label, group in found.items()
    } == {
        "from logs, learner.gradient = mask": ["mask0", "mask1", "mask2"],
        "from logs, learner.gradient = sum": ["sum0", "sum1"],
        "live": ["live"],
    }


@pytest.mark.parametrize(
    ("name", "text", "error", "said"),
    [
        ("run.json", None, StorageError, "holds no run"),
        ("run.json", "{", ConfigError, "expected JSON"),
        ("run.json", "[1]", ConfigError, "expected a JSON object"),
        ("run.json", '{"scene": "table"}', ConfigError, "mode, settings, seed missing"),
        ("metrics.jsonl", None, StorageError, "cannot be read"),
        ("metrics.jsonl", "5\n", FormatError, "line 1 is not a row"),
    ],
)
def test_a_folder_that_is_no_run_is_refused(
    tmp_path: Path, name: str, text: str | None, error: type[Exception], said: str
) -> None:
    folder = write_run(tmp_path / "run", [evaluation(10, 0.1)])
    (folder / name).unlink()
    if text is not None:
        (folder / name).write_text(text)
    with pytest.raises(error, match=said):
        load_history(folder)
