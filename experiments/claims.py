"""What the paper claims against what was measured.

Every number is taken from a table, and a verdict follows from the numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from experiments import cells, curves, tables
from experiments.cells import Tables

NOT_RUN = "not run"


class Checked(NamedTuple):
    """One claim."""

    claim: str
    shown: str
    """What the paper shows for it."""
    measured: str
    verdict: str


def section(found: Tables) -> str:
    """The table of claims."""
    lines = cells.head("the paper's claim", "what it shows", "what we measured", "verdict")
    for check in CHECKS:
        checked = check(found)
        lines.append(
            cells.line(
                *(checked if checked.measured else checked._replace(measured=NOT_RUN, verdict=""))
            )
        )
    return "## What the paper claims, checked\n\n" + "\n".join(lines) + "\n"


def _each(found: Tables, suffix: str) -> dict[str, Any]:
    """Tables of this name by scene."""
    return {
        scene: found[f"{scene}-{suffix}"] for scene in tables.SCENES if f"{scene}-{suffix}" in found
    }


def _listed(texts: dict[str, str]) -> str:
    return "; ".join(f"{scene} {text}" for scene, text in texts.items())


def _where(holds: dict[str, bool]) -> str:
    """A verdict over scenes."""
    yes, no = (
        [scene for scene, each in holds.items() if each is wanted] for wanted in (True, False)
    )
    if not no:
        return "holds" if yes else ""
    return f"does not hold: {', '.join(no)}" + (f"; holds: {', '.join(yes)}" if yes else "")


def decision(found: Tables) -> Checked:
    """Real time, as acting."""
    of = {scene: table["decision"] for scene, table in _each(found, "shipped").items()}
    texts = {scene: f"{cells.up(1e6 * each['act']['median'], 0)} µs" for scene, each in of.items()}
    period = (
        f" of a control period of {1e3 * next(iter(of.values()))['control_period']:g} ms"
        if of
        else ""
    )
    verdict = _where(
        {scene: each["act"]["median"] <= each["control_period"] / 20 for scene, each in of.items()}
    )
    return Checked(
        "It performs in real time: deciding",
        "no time is given",
        _listed(texts) + period,
        verdict + (" (≤ 1/20)" if verdict else ""),
    )


def planning(found: Tables) -> Checked:
    """Real time, as planning."""
    of = _each(found, "planning")
    texts = {}
    for scene, each in of.items():
        kinematic, physics, theirs = (
            1e3 * each[name]["cpu"]["median"] for name in ("kinematic", "physics", "ompl")
        )
        texts[scene] = (
            f"{cells.up(kinematic, 0)} ms (in the simulation {cells.up(physics, 0)}) against {cells.down(theirs, 0)} ms"
        )
    verdict = _where(
        {scene: each["ratios"]["kinematic"]["cpu"]["median"] <= 1.0 for scene, each in of.items()}
    )
    return Checked(
        "Unlike sampling-based planners, which cannot plan in real time",
        "no planner is run",
        _listed(texts)
        + (" for RRTConnect + IK + simplify, which is as much real time" if of else ""),
        f"cheaper than the planner: {verdict}" if verdict else "",
    )


def smoothing(found: Tables) -> Checked:
    """What smoothing costs and keeps."""
    of = _each(found, "planning")
    texts = {
        scene: f"{cells.up(1e3 * each['physics']['smooth']['median'], 0)} ms"
        for scene, each in of.items()
    }
    verdict = _where(
        {
            scene: each["physics"]["smooth"]["median"] <= each["physics"]["seconds"]["median"]
            for scene, each in of.items()
        }
    )
    return Checked(
        "Smoothing is cheap beside optimisation methods",
        "no time is given",
        _listed(texts) + (" a trajectory with `local`, proof included" if of else ""),
        f"less than the motion takes: {verdict}" if verdict else "",
    )


def growth(found: Tables) -> Checked:
    """O(log n)."""
    rows = found.get("growth", {}).get("rows", [])
    texts = [
        f"{row['knots']} knots: {row['paper']['checks']:,} configurations, {cells.up(row['paper']['cpu'], 1)} s"
        for row in rows
    ]
    verdict = ""
    if rows:
        more, longer = (
            rows[-1][a][b] / rows[0][a][b] for a, b in (("paper", "checks"), ("paper", "cpu"))
        )
        knots = rows[-1]["knots"] / rows[0]["knots"]
        verdict = f"does not hold: {knots:g} × the knots take {cells.down(more)} × the checks and {cells.down(longer)} × the time"
        verdict = (
            verdict
            if more > 2
            else f"holds: {knots:g} × the knots take {cells.up(more)} × the checks"
        )
    return Checked(
        "Smoothing runs in O(log n)",
        "n joints times −log₂(precision) steps; a step checks every knot, which is not counted",
        "the paper's method: " + "; ".join(texts) if texts else "",
        verdict,
    )


def saturation(found: Tables) -> Checked:
    """4 000 episodes."""
    reached = {scene: curves.saturated(scene) for scene in tables.SCENES}
    known = {scene: steps for scene, steps in reached.items() if steps is not None}
    texts = {scene: f"{steps:,} steps" for scene, steps in known.items()}
    still = [scene for scene, steps in reached.items() if steps is None and curves.live(scene)]
    return Checked(
        "Learning saturates at 4 000 episodes (600 000 steps) in every scene",
        "learning curves of unnamed numbers of seeds",
        _listed(texts)
        + (" until the score stays within 0.1 of its last" if known else "")
        + (f"; not within the runs made: {', '.join(still)}" if still else ""),
        _where(
            {scene: steps <= 600_000 for scene, steps in known.items()}
            | dict.fromkeys(still, False)
        ),
    )


def avoidance(found: Tables) -> Checked:
    """Goals are reached and obstacles avoided."""
    of = {scene: tables.of_row(found, "shipped", scene) for scene in tables.SCENES}
    texts = {scene: cells.good(each, "3 cm", "clean") for scene, each in of.items() if each}
    return Checked(
        "The goal is reached without collision and in balance, in all four scenes",
        "pictures of one motion each",
        _listed(texts) + (" of held-out problems clean" if texts else "") + _alone(found),
        _where(
            {scene: each[0]["3 cm"]["clean"]["rate"] >= 0.95 for scene, each in of.items() if each}
        )
        + (" (≥ 95 %)" if texts else ""),
    )


def _alone(found: Tables) -> str:
    """What the networks do whose shield was counted in."""
    texts = {
        scene: cells.good(each, "3 cm", "clean")
        for scene in tables.SCENES
        if (each := tables.of_row(found, "bare", scene))
    }
    return f"; without its shield {_listed(texts)}" if texts else ""


def spine(found: Tables) -> Checked:
    """The articulated torso."""
    of = _each(found, "reach")
    texts = {}
    for scene, each in of.items():
        texts[scene] = (
            f"a posture exists for {cells.share(each['free'])}, with the spine locked for {cells.share(each['locked'])}"
        )
    return Checked(
        "The articulated torso plays an important role",
        "pictures",
        _listed(texts),
        _where({scene: each["locked"]["high"] < each["free"]["low"] for scene, each in of.items()}),
    )


def noise(found: Tables) -> Checked:
    """Noise removed, ends kept."""
    of = {
        scene: each["physics"]
        for scene, each in _each(found, "planning").items()
        if each["physics"].get("smoother")
    }
    texts = {
        scene: f"jerk {cells.down(each['smoother']['median'], 0)} × lower, ends within {each['end_error']['high']:.0e} rad"
        f", executed {cells.share(each['success'])}"
        for scene, each in of.items()
    }
    return Checked(
        "Noise is removed and the final configuration stays",
        "one trajectory",
        _listed(texts),
        _where(
            {
                scene: each["end_error"]["high"] < 1e-6 and each["smoother"]["median"] > 1
                for scene, each in of.items()
            }
        ),
    )


def together(found: Tables) -> Checked:
    """Both hands at once."""
    of = {
        scene: table["3 cm"]["apart"]
        for scene, table in _each(found, "shipped").items()
        if table["3 cm"]["apart"]
    }
    texts = {
        scene: f"{cells.up(each['median'], 0)} steps (p95 {cells.up(each['p95'], 0)})"
        for scene, each in of.items()
    }
    return Checked(
        "Both hands reach their goals simultaneously",
        "one nearly symmetric pair of paths",
        _listed(texts) + (" of 40 ms between the palms' first arrivals" if of else ""),
        _where({scene: each["median"] <= 12 for scene, each in of.items()})
        + (" (half a second)" if of else ""),
    )


CHECKS: tuple[Callable[[Tables], Checked], ...] = (
    *(avoidance, decision, planning, smoothing, growth),
    *(saturation, spine, noise, together),
)
