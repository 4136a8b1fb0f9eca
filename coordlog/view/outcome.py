"""What an overview keeps of one episode, and what it says in words about one and about all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from coordlog.episode import Array, Episode
from coordlog.sim.state import StateView
from coordlog.view.palette import BAD, EXECUTED, FAIR, GOOD, Colour
from coordlog.view.show import Show
from coordlog.view.text import plain, title, verdict

KINDS: dict[str, Colour] = {
    "clean success": GOOD,
    "success with collision": FAIR,
    "not reached": (120, 130, 200, 255),
    "fell": BAD,
    "aborted": EXECUTED,
}
"""How an episode can end, and its colour in every panel."""
TOP = 5
"""Episodes named per reason to look at them."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """One episode in brief."""

    name: str
    file: str
    title: str
    verdict: str
    scene: str
    policy: str
    kind: str
    steps: int
    seconds: float
    collisions: int
    """Steps with a collision."""
    arms: tuple[str, ...]
    returns: Array  # (k,)
    final: Array  # (k,) m, palm to goal after the last step; NaN without steps
    palms: Array  # (T + 1, k, 3) float32, m
    goals: Array  # (k, 3) m

    @classmethod
    def of(cls, show: Show) -> Outcome:
        """Take what is needed out of an episode; palms come from its policy state, so no model is compiled."""
        episode, header = show.episode, show.episode.header
        palms = StateView.from_json(header.env).physical(episode.state, "palms")
        k = len(header.arms)
        return cls(
            name=show.name,
            file=show.file or show.name,
            title=title(episode),
            verdict=verdict(episode),
            scene=str(header.episode["scene"]),
            policy=str(header.policy["name"] or header.policy["kind"]),
            kind=kind(episode),
            steps=len(episode),
            seconds=float(episode.time[-1]),
            collisions=int(episode.collision.sum()),
            arms=header.arms,
            returns=episode.reward.sum(axis=0),
            final=episode.distance[-1] if len(episode) else np.full(k, np.nan),
            palms=palms.reshape(len(palms), k, 3).astype(np.float32),
            goals=np.array(header.episode["goals"]),
        )

    @property
    def worst(self) -> float:
        """Final distance of the arm that is farther off [m]."""
        return float(self.final.max())


def kind(episode: Episode) -> str:
    """Which of KINDS an episode is."""
    if episode.result.aborted:
        return "aborted"
    if episode.result.clean:
        return "clean success"
    if episode.instability.any():
        return "fell"
    return "success with collision" if episode.result.success else "not reached"


def about_one(outcome: Outcome) -> str:
    """An episode under the cursor, as Markdown."""
    command = f"`coordlog view {plain(outcome.file)}`"
    lines = [f"### {outcome.title}", "", f"**{outcome.verdict}**", "", command, "", "| arm | final distance | return |", "|---|---|---|"]
    for arm, final, returned in zip(outcome.arms, outcome.final, outcome.returns, strict=True):
        lines.append(f"| {plain(arm)} | {final * 100:.1f} cm | {returned:.1f} |")
    return "\n".join([*lines, "", f"{outcome.steps} steps, policy {plain(outcome.policy)}"])


def about_all(outcomes: Sequence[Outcome]) -> str:
    """How many ended how, and which episodes are worth opening, as Markdown."""
    finals = np.array([outcome.worst for outcome in outcomes])
    lines = [f"## {len(outcomes)} episodes", "", f"scenes: {', '.join(sorted({plain(outcome.scene) for outcome in outcomes}))}", ""]
    lines += ["| ended as | episodes | share |", "|---|---|---|"]
    for name in KINDS:
        count = sum(outcome.kind == name for outcome in outcomes)
        lines.append(f"| {name} | {count} | {count / len(outcomes):.1%} |")
    finite = finals[np.isfinite(finals)]
    if len(finite):
        median, worst = np.percentile(finite, [50, 90])
        lines += ["", f"final distance of the farther palm: median {median * 100:.1f} cm, nine in ten below {worst * 100:.1f} cm"]
    lines += ["", "## Open next", "", "Put the cursor of the time line on an episode to see it in the scene.", ""]
    for reason, found in _worth(outcomes).items():
        lines += [f"**{reason}**", "", *(f"- {index}: {plain(outcome.file)} – {outcome.verdict}" for index, outcome in found), ""]
    return "\n".join(lines)


def _worth(outcomes: Sequence[Outcome]) -> dict[str, list[tuple[int, Outcome]]]:
    """Reasons to look at an episode, and the episodes that give them most, with their places on the time line."""
    every = list(enumerate(outcomes))
    rankings = {
        "fell soonest": sorted((each for each in every if each[1].kind == "fell"), key=lambda each: each[1].steps),
        "most collisions": sorted((each for each in every if each[1].collisions), key=lambda each: -each[1].collisions),
        "ended farthest off": sorted((each for each in every if each[1].kind == "not reached"), key=lambda each: -each[1].worst),
        "slowest clean success": sorted((each for each in every if each[1].kind == "clean success"), key=lambda each: -each[1].steps),
        "cut short": [each for each in every if each[1].kind == "aborted"],
    }
    return {reason: found[:TOP] for reason, found in rankings.items() if found}
