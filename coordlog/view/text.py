"""What an episode says about itself, as Markdown."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import rerun as rr

from coordlog.episode import Episode
from coordlog.view.show import Stage

MARKDOWN = "text/markdown"


def say(stream: rr.RecordingStream, stage: Stage) -> None:
    """Log what a show says about itself, and a banner if it was cut short."""
    said = {"about": about(stage.episode, file=stage.show.file)}
    if stage.episode.result.aborted:
        said["banner"] = banner(stage.episode)
    for place, text in said.items():
        document = rr.TextDocument(text, media_type=MARKDOWN)
        stream.log(stage.entity(place), document, static=True)


def verdict(episode: Episode) -> str:
    """How the episode went, in a few words."""
    seconds, result = episode.time[-1], episode.result
    if result.aborted:
        return f"ABORTED after {seconds:.2f} s: {plain(result.aborted)}"
    if episode.header.kind == "observed":
        return f"observed for {seconds:.2f} s"
    if not episode.has("distance"):  # another program's environment: no goals of ours
        return f"ended after {seconds:.2f} s"
    if result.clean:
        return f"clean success after {seconds:.2f} s"
    if result.success:
        return f"success after {seconds:.2f} s, not clean: {_blemish(episode)}"
    if episode.instability.any():
        return f"fell after {seconds:.2f} s"
    return f"goal not reached in {seconds:.2f} s" + (
        f"; {_blemish(episode)}" if episode.collision.any() else ""
    )


def title(episode: Episode) -> str:
    """Which episode this is, in a few words."""
    start = episode.header.episode
    words = [plain(start["split"])] if start["split"] else []
    words += [f"seed {start['seed']}"] if start["seed"] is not None else []
    return " ".join([f"{plain(start['scene'])} ·", *words, f"episode {start['index']}"])


def banner(episode: Episode) -> str:
    """What must be read first about an episode that did not end by itself."""
    reason, shown = (
        plain(episode.result.aborted),
        f"{len(episode)} steps ({episode.time[-1]:.2f} s)",
    )
    return (
        f"### This episode was cut short: {reason}. What is there, {shown}, is shown; how it went "
        "says nothing about the policy."
    )


def _touched(episode: Episode) -> str:
    """Steps with a collision, "" where nothing is known of them."""
    if not episode.has("collision"):
        return ""
    return f"{int(episode.collision.sum())} steps, {len(episode.contacts)} contacts"


def about(episode: Episode, *, file: str = "") -> str:
    """Result, origin and lineage of one episode."""
    start, env, policy, lineage = (
        getattr(episode.header, name) for name in ("episode", "env", "policy", "lineage")
    )
    lines = [f"**{title(episode)}: {verdict(episode)}**", "", *_arms(episode), ""]
    facts = {
        "made by": lineage["transform"],
        "policy": policy["name"] or policy["kind"],
        "exploration noise": _pairs(policy["noise"]),
        "steps": f"{len(episode)} of {start['control_period'] * 1000:g} ms",
        "collisions": _touched(episode),
        "from": ", ".join(parent[:12] for parent in lineage["parents"]),
        "checkpoint": policy["checkpoint_sha256"][:12],
        "robot": start["robot"],
        "start pose": start["start"],
        "file": file,
        "run": start["run"],
        "coordlog, MuJoCo": f"{env['coordlog_version']}, {env['mujoco_version']}"
        f" on {env['architecture']}",
    }
    facts = {name: value for name, value in facts.items() if value} | {"episode": start["id"]}
    (first, told), *others = facts.items()
    lines += [
        f"| {first} | {plain(told)} |",
        "|---|---|",
        *(f"| {name} | {plain(value)} |" for name, value in others),
    ]
    if lineage["parameters"]:
        lines += [
            "",
            "### Parameters",
            "",
            *(f"- {plain(name)}: {plain(value)}" for name, value in lineage["parameters"].items()),
        ]
    return "\n".join(lines)


def plain(value: object) -> str:
    """Text from a file, made harmless in a Markdown table."""
    return "".join(" " if letter in "|\r\n`" else letter for letter in str(value))


def _arms(episode: Episode) -> list[str]:
    if not episode.has("distance"):
        returns = zip(episode.header.arms, episode.result.returns, strict=True)
        return [
            "| reward | sum |",
            "|---|---|",
            *(f"| {plain(name)} | {value:.4g} |" for name, value in returns),
        ]
    rows = ["| arm | final distance | nearest | return |", "|---|---|---|---|"]
    for i, arm in enumerate(episode.header.arms):
        distance = episode.distance[:, i] if len(episode) else np.array([np.nan])
        returned = episode.reward[:, i].sum()
        rows.append(
            f"| {plain(arm)} | {distance[-1] * 100:.1f} cm | {distance.min() * 100:.1f} cm | "
            f"{returned:.1f} |"
        )
    return rows


def _blemish(episode: Episode) -> str:
    parts = [
        f"{int(flag.sum())} steps of {name}"
        for name, flag in _faults(episode).items()
        if flag.any()
    ]
    return " and ".join(parts)


def _faults(episode: Episode) -> Mapping[str, np.ndarray]:
    return {"collision": episode.collision, "instability": episode.instability}


def _pairs(values: Mapping[str, object]) -> str:
    return ", ".join(f"{name} {value}" for name, value in values.items())
