"""Curves that are kept are runs to `coordlog plot`, without what nobody reads."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from coordlog.errors import ConfigError
from coordlog.train.history import load_history
from experiments import curves


def run_folder(folder: Path, *, scores: list[float], seed: int = 0, success: float = 0.5) -> Path:
    folder.mkdir()
    said = {
        "scene": "free",
        "mode": "live",
        "seed": seed,
        "settings": {"loop": {"seed": seed}},
        "env": {"config": {}, "geoms": ["x"] * 99},
    }
    (folder / "run.json").write_text(json.dumps(said))
    rows = []
    for i, score in enumerate(scores, start=1):
        rows.append(
            {
                "kind": "training",
                "update": 10 * i,
                "step": 1000 * i,
                "episodes": 7,
                "episodes_total": 7 * i,
                "score": 0.0,
            }
        )
        rows.append(
            {
                "kind": "evaluation",
                "update": 10 * i,
                "step": 1000 * i,
                "episodes": 50,
                "score": score,
                "success": success,
                "clean": 0.5,
            }
        )
    (folder / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    return folder


def test_a_kept_curve_is_the_runs_own_and_small(tmp_path: Path) -> None:
    run = run_folder(tmp_path / "run", scores=[1.0, 2.0, 3.0])
    kept = curves.keep("digrad-live", run, folder=tmp_path / "kept")
    assert kept.name == "free-digrad-live-s0"
    before, after = load_history(run), load_history(kept)
    assert {row["kind"] for row in after.rows} == {"evaluation"}
    for against in ("episodes", "steps", "updates"):
        one, other = (
            history.line("score", kind="evaluation", against=against) for history in (before, after)
        )
        assert one.x.tolist() == other.x.tolist()
        assert one.y.tolist() == other.y.tolist()
    assert "geoms" not in after.said["env"]
    assert curves.kept("free", "digrad-live", folder=tmp_path / "kept") == [kept]


def test_a_run_without_evaluations_is_refused(tmp_path: Path) -> None:
    run = run_folder(tmp_path / "run", scores=[1.0])
    (run / "metrics.jsonl").write_text('{"kind": "training", "update": 1, "step": 0}\n')
    with pytest.raises(ConfigError, match="expected a run with evaluations"):
        curves.keep("digrad-live", run, folder=tmp_path / "kept")


def test_saturation_is_that_of_the_slowest_seed(tmp_path: Path) -> None:
    assert curves.saturated("free", folder=tmp_path) is None
    for seed, scores in enumerate(([0.0, 3.0, 3.05, 3.02], [0.0, 1.0, 2.95, 3.0])):
        curves.keep(
            "digrad-live",
            run_folder(tmp_path / f"run{seed}", scores=scores, seed=seed),
            folder=tmp_path / "kept",
        )
    assert curves.saturated("free", folder=tmp_path / "kept") == 3000
    curves.keep(
        "digrad-live",
        run_folder(tmp_path / "rising", scores=[0.0, 1.0, 2.0, 3.0], seed=2),
        folder=tmp_path / "kept",
    )
    assert curves.saturated("free", folder=tmp_path / "kept") is None, "still on its way"


def test_a_score_that_stays_low_is_not_saturated(tmp_path: Path) -> None:
    curves.keep(
        "digrad-live",
        run_folder(tmp_path / "run", scores=[1.0, 1.0, 1.0, 1.0], success=0.1),
        folder=tmp_path / "kept",
    )
    assert curves.saturated("free", folder=tmp_path / "kept") is None
