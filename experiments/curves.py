"""Learning curves kept small: a run folder's evaluations, so that figures can be drawn again
without the run.

    python -m experiments.curves digrad-live runs/free-live-s0     →
    experiments/curves/free-digrad-live-s0/

What is kept is a run folder as far as `coordlog plot` is concerned: what the run was about, and its
evaluation rows.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from coordlog.errors import ConfigError, CoordlogError
from coordlog.train.history import History, load_history
from coordlog.train.metrics import MetricsLog
from experiments.recipes import row_names

FOLDER = Path(__file__).parent / "curves"
LIVE, FAST = "digrad-live", "digrad-live-fast"
"""Live runs of the preset of that name, and of before, with decisions of 0.04 s."""
TICK = 0.04
"""The control step that budgets are counted in [s]; a decision may last several."""
WITHIN = 0.1
"""A score this close to its last value counts as saturated."""
SETTLED = 0.75
"""A score has settled if it has been so close for the last quarter of its run."""
LEARNT = 0.5
"""A run that succeeds more seldom than this at its end has not learnt the task: a score that stays
low is not saturated."""
ABOUT = (
    "scene",
    "mode",
    "seed",
    "envs",
    "where",
    "data",
    "log_episodes",
    "settings",
    "versions",
    "git",
)


def keep(row: str, run: Path, *, folder: Path = FOLDER) -> Path:
    """Keep the curve of a run, replacing an earlier one of the same row, scene and seed.

    Raises:
        ConfigError: if the run was never evaluated.
        StorageError: if there is no run, or the file system refuses.
    """
    history = load_history(run)
    rows = [each for each in history.rows if each["kind"] == "evaluation"]
    if not rows:
        raise ConfigError(
            f"{run}: expected a run with evaluations, got one without; train with --eval-every"
        )
    said = history.said
    target = folder / f"{said['scene']}-{row}-s{said['seed']}"
    target.mkdir(parents=True, exist_ok=True)
    about = {key: said[key] for key in ABOUT if key in said}
    about["env"] = {key: said.get("env", {}).get(key, {}) for key in ("config", "reward")}
    (target / "run.json").write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
    log = MetricsLog(target / "metrics.jsonl")
    for each in rows:
        log.write({**each, "episodes_total": episodes_until(history, each)})
    return target


def episodes_until(history: History, row: dict[str, Any]) -> float:
    """Live episodes until an evaluation, between the training rows that counted them."""
    return history._place(row, "episodes")


def kept(scene: str = "*", row: str = "*", *, folder: Path = FOLDER) -> list[Path]:
    """Folders of kept curves."""
    return sorted(path.parent for path in folder.glob(f"{scene}-{row}-s*/metrics.jsonl"))


def live(scene: str, *, folder: Path = FOLDER) -> list[Path]:
    """The live curves of a scene: those of before only where there are no others."""
    return kept(scene, LIVE, folder=folder) or kept(scene, FAST, folder=folder)


def saturated(scene: str, *, folder: Path = FOLDER) -> int | None:
    """Control steps of TICK seconds from which on the score of the slowest seed stays within WITHIN
    of its last.

    None without curves, or where one of them was still on its way when the run ended (SETTLED), or
    had learnt nothing (LEARNT).
    """
    found = [load_history(path) for path in live(scene, folder=folder)]
    curves = [history.rows for history in found]
    steps = [_from(rows) for rows in curves]
    settled = all(
        step <= SETTLED * int(rows[-1]["step"]) and rows[-1]["success"] >= LEARNT
        for step, rows in zip(steps, curves, strict=True)
    )
    ticks = [step * _period(each) / TICK for step, each in zip(steps, found, strict=True)]
    return round(max(ticks)) if ticks and settled else None


def _period(history: History) -> float:
    """The control period of a run [s]."""
    return float(history.said.get("env", {}).get("config", {}).get("control_period", TICK))


def _from(rows: list[dict[str, Any]]) -> int:
    last = float(rows[-1]["score"])
    away = [index for index, row in enumerate(rows) if abs(float(row["score"]) - last) > WITHIN]
    return int(rows[away[-1] + 1 if away else 0]["step"])


def main(arguments: list[str] | None = None) -> None:
    """Keep the curves of the runs that the command line names."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.curves", description=(__doc__ or "").split("\n", 1)[0]
    )
    parser.add_argument("row", choices=row_names())
    parser.add_argument("run", type=Path, nargs="+")
    given = parser.parse_args(arguments)
    for run in given.run:
        try:
            print(keep(given.row, run))
        except CoordlogError as error:
            sys.exit(str(error))


if __name__ == "__main__":
    main()
