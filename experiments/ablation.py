"""What single settings are worth: the same live run again with one change at a time.

    python -m experiments.ablation paper runs/ablation-paper
    python -m experiments.ablation recipe runs/ablation-recipe --only live,starts

The changes stand in experiments/ablations.toml. A run that was stopped goes on, one that is
finished is not run again; experiments/tables/ablation-NAME.json holds those that are.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

from coordlog.errors import CoordlogError
from coordlog.train.metrics import read_metrics
from experiments import cells, tables
from experiments.actors import actor
from experiments.cells import Tables
from experiments.evaluate import ENVS, RADII, environment
from experiments.figures import coordlog_command
from experiments.measure import SEED, SPLIT, figures, run

FILE = Path(__file__).with_name("ablations.toml")
EPISODES = 200
LEARNT = 0.5
"""Clean share of an evaluation while training from which on a run counts as having learnt."""


def ladders() -> dict[str, Any]:
    """Every series of runs: scene, steps, preset, and the changes by name."""
    return tomllib.loads(FILE.read_text(encoding="utf-8"))


def learn(ladder: dict[str, Any], each: dict[str, Any], folder: Path, *, every: int) -> None:
    """Train one run, or go on with it."""
    changes = [word for change in each.get("set", ()) for word in ("--set", change)]
    preset, steps = each.get("preset", ladder["preset"]), each.get("steps", ladder["steps"])
    resume = ["--resume"] if (folder / "run.json").exists() else []
    coordlog_command(
        *("train", "--scene", ladder["scene"], "--preset", preset, "--steps", str(steps)),
        *("--eval-every", str(every), "--out", str(folder), *changes, *resume),
    )


def measure(scene: str, each: dict[str, Any], folder: Path) -> tables.Table:
    """The best policy of a run on held-out problems, and when it had learnt."""
    rows = read_metrics(folder / "metrics.jsonl")
    seen = [row for row in rows if row["kind"] == "evaluation"]
    env = environment(scene, str(folder), radius=RADII["3 cm"], torso="free", envs=ENVS)
    chosen, _ = actor(str(folder), env, shield=None)
    found = figures(run(env, chosen, episodes=EPISODES))
    kept = {key: found[key] for key in ("success", "clean", "collisions", "falls")}
    return {
        "name": each["name"],
        "change": each["change"],
        "learnt": next((row["step"] for row in seen if row["clean"] >= LEARNT), None),
    } | kept


def series(name: str, folder: Path, *, every: int, only: list[str]) -> Path:
    """Run what is left of a series, and write its table after each run."""
    ladder = ladders()[name]
    measured = tables.read_all().get(f"ablation-{name}", {}).get("rows", [])
    rows = {row["name"]: row for row in measured}
    for each in ladder["runs"]:
        if each["name"] in rows or (only and each["name"] not in only):
            continue
        learn(ladder, each, folder / each["name"], every=every)
        rows[each["name"]] = measure(ladder["scene"], each, folder / each["name"])
        _write(name, ladder, rows)
        print(f"{each['name']}: {cells.share(rows[each['name']]['clean'])}", flush=True)
    return _write(name, ladder, rows)


def _write(name: str, ladder: dict[str, Any], rows: dict[str, Any]) -> Path:
    """The table in the order of the file."""
    problems = {"seed": SEED, "split": SPLIT, "episodes": EPISODES}
    ordered = [rows[each["name"]] for each in ladder["runs"] if each["name"] in rows]
    table = {"kind": "ablation", "steps": ladder["steps"], "problems": problems, "rows": ordered}
    return tables.write(table, f"ablation-{name}")


def section(found: Tables) -> str:
    """Every series that was run."""
    parts = []
    for name, ladder in ladders().items():
        table = found.get(f"ablation-{name}")
        if table is None:
            continue
        about = ladder["about"].format(steps=table["steps"], **table["problems"]).lstrip()
        lines = cells.head("change", "learnt at", "success", "clean", "falls")
        lines += [cells.line(row["change"], *_cells(row)) for row in table["rows"]]
        parts.append(about + "\n" + "\n".join(lines) + "\n")
    return "\n".join(parts)


def _cells(row: dict[str, Any]) -> list[str]:
    learnt = f"{row['learnt']:,}" if row["learnt"] else "never"
    good = (cells.share(row[key]) for key in ("success", "clean"))
    return [learnt, *good, cells.share(row["falls"], better=False)]


def main(arguments: list[str] | None = None) -> None:
    """Run the series that the command line names."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.ablation", description=(__doc__ or "").split("\n", 1)[0]
    )
    parser.add_argument("name", choices=list(ladders()))
    parser.add_argument("folder", type=Path, help="of run folders")
    parser.add_argument("--every", type=int, default=2000, help="updates between evaluations")
    parser.add_argument("--only", default="", help="names of runs, with commas between")
    given = parser.parse_args(arguments)
    only = given.only.split(",") if given.only else []
    try:
        print(series(given.name, given.folder, every=given.every, only=only))
    except CoordlogError as error:
        sys.exit(str(error))
    except subprocess.CalledProcessError as error:
        sys.exit(f"a run ended with {error.returncode}, and says why above; the others: --only")


if __name__ == "__main__":
    main()
