"""Learning curves in small form: the evaluation rows of runs, results/curves/SCENE-ROW-sSEED.jsonl."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent / "curves"
LIVE = "digrad-live"
WITHIN = 0.1
"""A score this close to its last value counts as saturated."""


def read(scene: str, row: str) -> dict[str, list[dict[str, Any]]]:
    """Evaluation rows of every seed by file name."""
    found = {}
    for path in sorted(FOLDER.glob(f"{scene}-{row}-s*.jsonl")):
        rows = [json.loads(text) for text in path.read_text(encoding="utf-8").splitlines()]
        found[path.stem] = [each for each in rows if each.get("kind") == "evaluation"]
    return found


def saturated(scene: str) -> int | None:
    """Live steps from which on the score of the slowest seed stays within WITHIN of its last; None without curves."""
    steps = [_from(rows) for rows in read(scene, LIVE).values() if rows]
    return max(steps) if steps else None


def _from(rows: list[dict[str, Any]]) -> int:
    last = float(rows[-1]["score"])
    away = [index for index, row in enumerate(rows) if abs(float(row["score"]) - last) > WITHIN]
    return int(rows[away[-1] + 1 if away else 0]["step"])
