"""Ship a policy with the package, or measure again those that ship.

    python -m experiments.ship runs/table-logs-s0
        copy its best policy to coordlog/policies/, write the card, measure both goal radii
    python -m experiments.ship runs/spheres-s0 --shield --last
        its last policy instead, and one that is to act behind the shield
    python -m experiments.ship runs/table-live-s0 --kind live
        as `--policy pretrained:live`, beside the one that ships already
    python -m experiments.ship
        measure every shipped policy again

A card (SCENE.json) says how its policy was trained and what it does on held-out goals.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from pathlib import Path
from typing import Any

from coordlog.errors import ConfigError, CoordlogError
from coordlog.policies.registry import FILES, KINDS, PRETRAINED, SHIPPED, SUFFIX, about
from coordlog.train.run import recall
from experiments import tables
from experiments.evaluate import EPISODES, HOME, RADII, evaluate
from experiments.training import command, cost

MAX_BYTES = 1_000_000
ROW = "shipped"


def ship(folder: Path, *, shield: bool, last: bool, kind: str, episodes: int) -> None:
    """Make the best policy of a run the one that ships for its scene, or the last; behind the
    shield if it is to be.

    A hundred or two held-out problems cannot tell policies apart that differ by a point or two:
    where a run's evaluations differ by no more than that, what has learnt longest is the better
    guess.

    Raises:
        ConfigError: if the run has no evaluated policy, or one larger than a package should carry.
    """
    source = folder / f"{FILES[last]}{SUFFIX}"
    if not source.is_file():
        raise ConfigError(
            f"{folder}: expected a run folder with {source.name}, found none; train with evaluations (--eval-every)"
        )
    if source.stat().st_size > MAX_BYTES:
        raise ConfigError(
            f"{source}: expected at most {MAX_BYTES:,} bytes to ship, got {source.stat().st_size:,}"
        )
    scene = about(source)["scene"]
    SHIPPED.mkdir(exist_ok=True)
    stem = f"{scene}-{kind}" if kind else scene
    target = SHIPPED / f"{stem}{SUFFIX}"
    shutil.copyfile(source, target)
    target.chmod(0o644)
    card = {"scene": scene, "kind": kind, "shield": shield}
    card["training"] = training(folder, about(source))
    tables.write(card, stem, folder=SHIPPED)  # what is measured is what ships
    again(stem, episodes=episodes)


def again(stem: str, *, episodes: int) -> None:
    """Measure a shipped policy, and say so on its card, SHIPPED/STEM.json."""
    file = SHIPPED / f"{stem}{SUFFIX}"
    card = json.loads((SHIPPED / f"{stem}.json").read_text(encoding="utf-8"))
    scene, kind = card["scene"], card.get("kind", "")
    row, name = (f"{ROW}-{kind}", f"{PRETRAINED}:{kind}") if kind else (ROW, PRETRAINED)
    table = evaluate(row, scene, name, torso="free", episodes=episodes, seed=None)
    table["policy"]["cost"] = card["training"]["cost"]
    tables.write(table, tables.name_of(row, scene))
    held_out = {each: _short(table[each]) for each in (*RADII, HOME) if each in table}
    card = {
        "scene": scene,
        "kind": kind,
        "file": file.name,
        "sha256": table["policy"]["sha256"],
        "bytes": file.stat().st_size,
        "shield": card["shield"],
        "held_out": {"problems": table["problems"], **held_out},
        "training": card["training"],
    }
    tables.write(card, stem, folder=SHIPPED)


def training(folder: Path, said: dict[str, Any]) -> dict[str, Any]:
    """How a policy came about.

    `logs_sha256` is that of the digests of all logged episodes, one after the other.
    """
    run = recall(folder)
    loop = run["settings"]["loop"]
    if run["mode"] == "logs":
        loop["updates"] = max(
            loop["updates"], said["updates"]
        )  # a run that went on says what it began with
    return {
        "command": command(run),
        "preset": run.get("preset", "default"),
        "seed": run["seed"],
        "mode": run["mode"],
        "log_episodes": run["log_episodes"],
        "logs_sha256": run["data"],
        "cost": cost(folder, said),
        "versions": run["versions"],
        "git": run["git"],
        "settings": run["settings"],
        "env": {key: run["env"][key] for key in ("config", "reward")},
    }


def _short(found: dict[str, Any]) -> dict[str, Any]:
    return {name: found[name]["rate"] for name in ("success", "clean", "collisions", "falls")} | {
        "error": found["error"]
    }


def main(arguments: list[str] | None = None) -> None:
    """Ship what the command line names, or measure again."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.ship", description=(__doc__ or "").split("\n", 1)[0]
    )
    parser.add_argument(
        "run", type=Path, nargs="*", help="run folders; none: measure again what ships"
    )
    parser.add_argument("--episodes", type=int, default=EPISODES)
    parser.add_argument(
        "--shield", action="store_true", help="they act behind the shield (`record --shield`)"
    )
    parser.add_argument("--last", action="store_true", help="their last policies, not their best")
    parser.add_argument("--kind", choices=KINDS, default="", help="ask for them as pretrained:KIND")
    given = parser.parse_args(arguments)
    how = {"shield": given.shield, "last": given.last, "kind": given.kind}
    try:
        for folder in given.run:
            ship(folder, **how, episodes=given.episodes)
        for path in sorted(SHIPPED.glob(f"*{SUFFIX}")) if not given.run else []:
            again(path.stem, episodes=given.episodes)
    except CoordlogError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
