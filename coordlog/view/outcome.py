"""What an overview keeps of one episode, and what it says in words about one and about all."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from coordlog.episode import Array, Episode
from coordlog.view.palette import BAD, EXECUTED, FAIR, GOOD, Colour
from coordlog.view.show import Show
from coordlog.view.text import plain, title, verdict

KINDS: dict[str, Colour] = {
    "clean success": GOOD,
    "success with collision": FAIR,
    "not reached": (120, 130, 200, 255),
    "fell": BAD,
    "aborted": EXECUTED,
    "without goals": (150, 150, 150, 255),
}
"""How an episode can end, and its colour in every panel."""
URGENT = (
    "aborted",
    "fell",
    "not reached",
    "success with collision",
    "clean success",
    "without goals",
)
"""The same, those that ask most to be looked at first."""
TOP = 12
"""Episodes named in the summary."""
OF_ONE_KIND = 5
"""And at most so many that ended alike, as long as there are others."""


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
        """Take what is needed out of an episode.

        Palms come from its policy state, so no model is compiled. An observed episode, or one of
        another program's environment, has neither palms nor goals.
        """
        episode, header = show.episode, show.episode.header
        arms, goals = header.arms, np.array(header.episode["goals"])
        if episode.has("distance"):
            palms = episode.physical("palms")
        else:
            arms, goals, palms = (), np.zeros((0, 3)), np.zeros((len(episode) + 1, 0))
        k = len(arms)
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
            collisions=int(episode.collision.sum()) if episode.has("collision") else 0,
            arms=arms,
            returns=episode.reward.sum(axis=0),
            final=episode.distance[-1] if k and len(episode) else np.full(k, np.nan),
            palms=palms.reshape(len(palms), k, 3).astype(np.float32),
            goals=goals,
        )

    @property
    def worst(self) -> float:
        """Final distance of the arm that is farther off [m]."""
        return float(self.final.max()) if len(self.final) else float("nan")

    @property
    def urgency(self) -> tuple[float, ...]:
        """Sorts episodes, those to look at first in front: the failures, the earliest fall, most
        collisions, largest distance.
        """
        soon = self.steps if self.kind == "fell" else -self.steps
        far = -self.worst if self.kind == "not reached" and np.isfinite(self.worst) else 0.0
        return (
            URGENT.index(self.kind),
            far,
            -self.collisions if self.kind == "success with collision" else 0,
            soon,
        )

    @property
    def why(self) -> str:
        """What makes it worth a look, in a few words."""
        if self.kind == "without goals":
            return self.verdict
        touched = f"{self.collisions} steps of collision"
        if self.kind == "success with collision":
            return touched
        when = (
            f"after {self.seconds:.2f} s"
            if self.kind in ("aborted", "fell")
            else f"{self.worst * 100:.1f} cm off"
        )
        return f"{when}, {touched}" if self.collisions else when


def kind(episode: Episode) -> str:
    """Which of KINDS an episode is."""
    if episode.result.aborted:
        return "aborted"
    if not episode.has("distance"):
        return "without goals"
    if episode.result.clean:
        return "clean success"
    if episode.instability.any():
        return "fell"
    return "success with collision" if episode.result.success else "not reached"


def about_one(outcome: Outcome) -> str:
    """An episode under the cursor, as Markdown."""
    command = f"`coordlog view {plain(outcome.file)}`"
    lines = [
        f"### {outcome.title}",
        "",
        f"**{outcome.verdict}**",
        "",
        command,
        "",
    ]
    if outcome.arms:
        lines += ["| arm | final distance | return |", "|---|---|---|"]
    for arm, final, returned in zip(outcome.arms, outcome.final, outcome.returns, strict=False):
        lines.append(f"| {plain(arm)} | {final * 100:.1f} cm | {returned:.1f} |")
    return "\n".join([*lines, "", f"{outcome.steps} steps, policy {plain(outcome.policy)}"])


def about_all(outcomes: Sequence[Outcome]) -> str:
    """How many ended how, and which episodes to open next, as Markdown."""
    scenes = ", ".join(sorted({plain(outcome.scene) for outcome in outcomes}))
    counts = {name: sum(outcome.kind == name for outcome in outcomes) for name in KINDS}
    shares = [
        f"**{count} {name}** ({count / len(outcomes):.1%})"
        for name, count in counts.items()
        if count
    ]
    lines = [f"### {len(outcomes)} episodes: {scenes}", "", ", ".join(shares)]
    finals = np.array([outcome.worst for outcome in outcomes])
    finite = finals[np.isfinite(finals)]
    if len(finite):
        median, most = np.percentile(finite, [50, 90])
        lines += [
            "",
            f"Final distance of the farther palm: median {median * 100:.1f} cm, nine in ten below "
            f"{most * 100:.1f} cm.",
        ]
    lines += ["", "### Open next", "", "| # | episode | ended as | why |", "|---|---|---|---|"]
    names = _short([outcome.file for outcome in outcomes])
    lines += [
        f"| {i} | {plain(names[i])} | {outcomes[i].kind} | {outcomes[i].why} |"
        for i in worth_a_look(outcomes)
    ]
    return "\n".join(
        [
            *lines,
            "",
            "Put the cursor of the time line on its number to see its hands and the command that "
            "opens it.",
        ]
    )


def by_urgency(outcomes: Sequence[Outcome]) -> list[int]:
    """Numbers of all episodes, the one to look at first in front."""
    return sorted(range(len(outcomes)), key=lambda i: outcomes[i].urgency)


def worth_a_look(outcomes: Sequence[Outcome]) -> list[int]:
    """Numbers of at most TOP episodes: the most urgent of every kind, then more of the most urgent
    kind.
    """
    ranked, seen = by_urgency(outcomes), dict.fromkeys(KINDS, 0)
    chosen = []
    for i in ranked:
        seen[outcomes[i].kind] += 1
        if seen[outcomes[i].kind] <= OF_ONE_KIND:
            chosen.append(i)
    chosen = chosen[:TOP]
    more = [i for i in ranked if i not in chosen][: TOP - len(chosen)]
    return sorted(chosen + more, key=lambda i: outcomes[i].urgency)


def _short(files: Sequence[str]) -> list[str]:
    """Files by what tells them apart: the folders they share are left out."""
    folder = os.path.commonpath([os.path.dirname(file) for file in files])
    return [
        (os.path.relpath(file, folder) if folder else file).removesuffix(".mcap") for file in files
    ]
