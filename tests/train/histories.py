"""Run folders with figures that a test has chosen."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

Row = dict[str, object]


def evaluation(update: int, value: float, *, step: int = 0) -> Row:
    return {
        "kind": "evaluation",
        "update": update,
        "step": step,
        "episodes": 10,
        "score": 10 * value,
        "success": value,
        "clean": value / 2,
    }


def training(update: int, value: float, *, step: int, episodes: int, total: int) -> Row:
    figures = {"score": 10 * value, "success": value, "clean": value / 2}
    return {
        "kind": "training",
        "update": update,
        "step": step,
        "episodes": episodes,
        "episodes_total": float(total),
        **figures,
    }


def write_run(
    folder: Path,
    rows: Sequence[Row],
    *,
    scene: str = "planar",
    mode: str = "logs",
    seed: int = 0,
    gradient: str = "mask",
) -> Path:
    settings = {
        "learner": {"gradient": gradient, "gamma": 0.98},
        "loop": {"seed": seed, "updates": 100},
    }
    said = {
        "scene": scene,
        "mode": mode,
        "seed": seed,
        "settings": settings,
        "envs": 0,
        "where": "",
        "data": "d1",
    }
    folder.mkdir(parents=True)
    (folder / "run.json").write_text(json.dumps(said))
    (folder / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    return folder
