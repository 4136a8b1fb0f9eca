"""Where a policy that learnt live stops: what it touches first and when, and whether it is paid for
falling.

    python -m experiments.stops table runs/table-live-s0 runs/table-live-n2-s0

Writes experiments/tables/SCENE-stops.json. The return of standing still on the same problems says
what there is to lose.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from typing import Any

import numpy as np

import coordlog
from coordlog.episode import Episode
from coordlog.errors import CoordlogError
from coordlog.policies.registry import about, policy_file
from coordlog.train.settings import PRESETS
from experiments import cells, tables
from experiments.cells import Tables
from experiments.curves import LIVE, TICK
from experiments.evaluate import HOME
from experiments.figures import coordlog_command
from experiments.measure import SEED, SPLIT
from experiments.stats import rate

EPISODES = 100
GAMMA = PRESETS["default"].learner.gamma
STILL = "still"


def measure(scene: str, runs: list[str], *, episodes: int = EPISODES) -> tables.Table:
    """Figures of the policies of these runs on the same held-out problems, and of standing
    still.
    """
    rows = [_row(_episodes(scene, policy, episodes)) | _trained(policy, scene) for policy in runs]
    rows.append(_row(_episodes(scene, STILL, episodes)))
    problems = {"seed": SEED, "split": SPLIT, "episodes": episodes}
    return {"kind": "stops", "scene": scene, "gamma": GAMMA, "problems": problems, "rows": rows}


def _episodes(scene: str, policy: str, count: int) -> list[Episode]:
    with tempfile.TemporaryDirectory() as folder:
        drawn = ("--split", SPLIT, "--seed", str(SEED), "--episodes", str(count))
        coordlog_command(
            "record", "--scene", scene, "--policy", policy, *drawn, "--no-display", "--out", folder
        )
        return list(coordlog.open(folder))


def _trained(policy: str, scene: str) -> dict[str, Any]:
    """How long a policy learnt, and by which reward."""
    file = policy_file(policy, scene)
    assert file is not None, "a run folder or a policy file"
    said = about(file)
    return {"steps": said["steps"], "reward": said["env"]["reward"]}


def _row(episodes: list[Episode]) -> dict[str, Any]:
    """What happened, and what it was worth in the rewards that all arms get on average, undivided
    by any scale.
    """
    touched = [episode for episode in episodes if episode.collision.any()]
    first = Counter(_first(episode) for episode in touched)
    returns = [
        float((episode.reward.mean(axis=1) * GAMMA ** np.arange(len(episode))).sum())
        for episode in episodes
    ]
    return {
        "touched": rate(len(touched), len(episodes)),
        "fell": rate(sum(bool(episode.instability.any()) for episode in episodes), len(episodes)),
        "success": rate(sum(episode.result.success for episode in episodes), len(episodes)),
        "touch": first.most_common(1)[0] if first else None,
        "touch_step": float(np.median([episode.collision.argmax() for episode in touched]))
        if touched
        else None,
        "length": float(np.median([len(episode) for episode in episodes])),
        "return": float(np.median(returns)),
    }


def _first(episode: Episode) -> str:
    """The pair of geoms that touched first, their sides of the body left out."""
    names, contact = episode.header.env["geoms"], episode.contacts[0]
    return " and ".join(
        sorted(
            names[contact[key]].removeprefix("l_").removeprefix("r_") for key in ("geom1", "geom2")
        )
    )


ABOUT = """## Where live learning stopped, and why it goes now

`python -m experiments.stops SCENE RUN`: live runs with decisions of 0.04 s (`--preset default`) on held-out problems, beside a robot that
stands still; the reward is the paper's, its constants are ours. *Return* is what the critic learns to expect, discounted by {gamma:g} a
step, the median over problems. Where falling at once returns more than standing until the episode ends, falling is what is learnt: n2,
the price of a fall, is then too low. Where it is not, what is left is a way that begins by leading away from the goals.

"""
WHY = """
At 25 decisions a second one action changes the value by a percent or two, and imitation in hindsight pulls, by an estimate from the
gradients, a hundred times harder: a way around something can only be learnt from values, and they were not heard. The preset `live` lets
a decision last 0.12 s, lets imitation fade to a fortieth of what it was, begins half of the episodes elsewhere and a quarter near goals,
does not charge an action with what the noise of a later one did, and makes the actor ascend the mean of its critics
([training](training.md#live-from-nothing)). [What each is worth on its own](#what-each-part-of-the-recipe-is-worth).

"""


def section(found: Tables) -> str:
    """Every scene that was looked at."""
    of = [found[f"{scene}-stops"] for scene in tables.SCENES if f"{scene}-stops" in found]
    lines = cells.head(
        *(
            "scene",
            "live steps",
            "n1, n2",
            "success",
            "touches something",
            "first",
            "at step",
            "falls",
            "length",
            "return",
        )
    )
    for table in of:
        for row in table["rows"]:
            reward, touch = row.get("reward"), row["touch"]
            lines.append(
                cells.line(
                    table["scene"],
                    f"{row['steps']:,}" if reward else "stands still",
                    f"{reward['n1']:g}, {reward['n2']:g}" if reward else "",
                    cells.share(row["success"]),
                    cells.share(row["touched"], better=False),
                    f"{touch[0]} ({touch[1]} of {row['touched']['count']})" if touch else "",
                    f"{row['touch_step']:.0f}" if touch else "",
                    cells.share(row["fell"], better=False),
                    f"{row['length']:.0f}",
                    f"{row['return']:.1f}",
                )
            )
    return ABOUT.format(gamma=GAMMA) + "\n".join(lines) + "\n" + _now(found) if of else ""


def _now(found: Tables) -> str:
    """What the same scenes come to with the preset that goes on from there."""
    lines = cells.head(
        "scene",
        "seeds",
        "decisions",
        "control steps of 0.04 s",
        "clean",
        "clean from home",
        "falls",
    )
    for scene in tables.SCENES:
        of = tables.of_row(found, LIVE, scene)
        if of:
            longest = max(table["policy"]["cost"]["steps"] for table in of)
            period = of[0]["decision"]["control_period"]
            clean, home = (cells.good(of, key, "clean") for key in ("3 cm", HOME))
            steps = f"{longest:,}", f"{round(longest * period / TICK):,}"
            falls = cells.bad(of, "3 cm", "falls")
            lines.append(cells.line(scene, str(len(of)), *steps, clean, home, falls))
    return WHY + "\n".join(lines) + "\n" if len(lines) > 2 else ""


def main(arguments: list[str] | None = None) -> None:
    """Look at the runs that the command line names."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.stops", description=(__doc__ or "").split("\n", 1)[0]
    )
    parser.add_argument("scene", choices=tables.SCENES)
    parser.add_argument("run", nargs="+", help="run folders")
    parser.add_argument("--episodes", type=int, default=EPISODES)
    given = parser.parse_args(arguments)
    try:
        print(
            tables.write(
                measure(given.scene, given.run, episodes=given.episodes), f"{given.scene}-stops"
            )
        )
    except CoordlogError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
