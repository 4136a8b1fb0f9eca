"""Tests for `coordlog plot` of run folders."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from coordlog.api import curves
from coordlog.cli import app
from coordlog.errors import CoordlogError

FIXTURES = Path(__file__).parents[1] / "data" / "v1"


def write_run(folder: Path, *, mode: str = "logs", seed: int = 0, rows: int = 3) -> Path:
    folder.mkdir()
    said = {"scene": "planar", "mode": mode, "seed": seed, "settings": {"loop": {"seed": seed}}}
    (folder / "run.json").write_text(json.dumps(said))
    step = 0 if mode == "logs" else 8
    found = []
    for i in range(1, rows + 1):
        figures = {
            "episodes": 4,
            "score": 0.1 * i,
            "success": 0.2 * i,
            "clean": 0.1 * i + 0.05 * seed,
        }
        found.append(
            {
                "kind": "training",
                "update": i,
                "step": step * i,
                "episodes_total": 4 * i,
                **(figures if step else {}),
            }
        )
        found.append({"kind": "evaluation", "update": i, "step": step * i, **figures})
    (folder / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in found))
    return folder


def plot(*args: str | Path) -> None:
    app(["plot", *map(str, args)], standalone_mode=False)


def test_runs_become_a_picture_and_replace_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = [write_run(tmp_path / str(seed), mode="live", seed=seed) for seed in range(2)]
    out = tmp_path / "deeper" / "curves.png"
    plot(*runs, "--out", out)
    assert str(out) in capsys.readouterr().out
    assert out.read_bytes()[:4] == b"\x89PNG"
    with pytest.raises(CoordlogError, match="not overwritten"):
        plot(*runs, "--out", out)
    plot(*runs, "--out", out, "--force", "--against", "steps")


def test_what_is_drawn_is_the_mean_over_the_seeds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = []
    monkeypatch.setattr(curves, "save", lambda figure, *_, **__: drawn.append(figure))
    runs = [write_run(tmp_path / "a", mode="live"), write_run(tmp_path / "b", mode="live", seed=1)]
    plot(*runs, tmp_path / "a" / ".." / "a")
    clean = drawn[0].axes[2]
    assert clean.lines[-1].get_xdata().tolist() == [4, 8, 12], "episodes, as every run is live"
    assert clean.lines[-1].get_ydata() == pytest.approx([0.125, 0.225, 0.325]), (
        "a run named twice counts once"
    )
    plot(*runs, write_run(tmp_path / "logs"))
    assert drawn[1].axes[0].get_xlabel() == "updates", "as not every run is"


def test_bad_input_is_refused_with_a_sentence(tmp_path: Path) -> None:
    logs, live, empty = (
        write_run(tmp_path / "l"),
        write_run(tmp_path / "v", mode="live"),
        write_run(tmp_path / "e", rows=0),
    )
    episode = next((FIXTURES / "planar").glob("*.mcap"))
    refusals = {
        (tmp_path / "none",): "found nothing of that name",
        (tmp_path,): "got a folder without run.json",
        (logs, episode): "got both",
        (episode, "--against", "steps"): "expected run folders, got the episode",
        (logs, "--against", "episode"): "expected episodes, updates or steps, got 'episode'",
        (live, logs, "--against", "steps"): "learns from logs; use updates",
        (empty,): "with neither yet",
        (logs, "--out", tmp_path / "curves.doc"): ".svg",
    }
    for args, said in refusals.items():
        with pytest.raises(CoordlogError) as refusal:
            plot(*args, *(() if "--out" in args else ("--out", tmp_path / "out.png")))
        assert said in str(refusal.value)
        assert refusal.value.exit_code == 2
    assert not (tmp_path / "out.png").exists()
