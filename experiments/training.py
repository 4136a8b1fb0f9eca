"""How a policy came about: the command that trains it, and what that cost."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from coordlog.api.train_plan import TrainPlan, preset_of
from coordlog.config import plain
from coordlog.tasks.config import EnvConfig, RewardConfig
from coordlog.train.metrics import read_metrics
from coordlog.train.settings import PRESETS, surroundings

KEPT = "    # as of then: the target actor was kept"
"""What runs kept before there was `loop.average`."""


def cost(folder: Path, said: dict[str, Any]) -> dict[str, Any]:
    """Updates, live steps and wall time [s] up to the policy that says this of itself, evaluations
    included.
    """
    rows = read_metrics(folder / "metrics.jsonl")
    seconds = [
        row["seconds"] for row in rows if row.get("seconds") and row["update"] <= said["updates"]
    ]
    return {
        "updates": said["updates"],
        "steps": said["steps"],
        "seconds": seconds[-1] if seconds else 0.0,
    }


def command(run: dict[str, Any]) -> str:
    """The command that trains such a run, with today's preset of that name as its base.

    `run` is what run.json holds.
    """
    scene, loop, mode = run["scene"], run["settings"]["loop"], run["mode"]
    words = ["coordlog train"]
    words += [f"--from logs/{scene}"] if mode != "live" else [f"--scene {scene}"]
    words += ["--live"] if mode == "both" else []
    words += [f"--where {json.dumps(run['where'])}"] if run["where"] else []
    preset = run.get("preset", "default")
    source = None if mode == "live" else ["logs"]
    untold = preset_of(TrainPlan(source=source, scene=scene))
    words += [f"--preset {preset}"] if preset != untold else []
    if run.get("start", "stand") != "stand":
        words += [f"--start {run['start']}"]
    if mode != "live" or loop["updates"]:
        words += [f"--updates {loop['updates']}"]
    words += [f"--steps {loop['steps']} --envs {run['envs']}"] if mode != "logs" else []
    named = {("loop", name) for name in ("updates", "steps", "seed")}
    replay = run["settings"]["replay"]
    settings = {name: dict(section) for name, section in run["settings"].items()}
    if mode != "live":  # there was one share for logs and live steps at first
        settings["replay"] = {
            **replay,
            "log_hindsight": replay.get("log_hindsight", replay["hindsight"]),
        }
    before = settings["loop"].pop("averaged", False)
    for section, values in settings.items():
        usual = PRESETS[preset].asdict()[section]
        words += [
            f"--set {section}.{k}={json.dumps(v)}"
            for k, v in values.items()
            if (section, k) not in named and v != usual.get(k)
        ]
    for section, values in around(run["env"], preset=preset if mode == "live" else "").items():
        words += [f"--set {section}.{key}={json.dumps(value)}" for key, value in values.items()]
    return " ".join([*words, f"--seed {run['seed']}"]) + (KEPT if before else "")


def around(env: dict[str, Any], *, preset: str = "") -> dict[str, dict[str, Any]]:
    """What of an environment's constants, of a `coordlog.env` record, is not as usual, or not as a
    preset asks for.
    """
    asked = surroundings(preset)
    usual = {
        "env": plain(EnvConfig()) | asked["config"],
        "reward": plain(RewardConfig()) | asked["reward"],
    }
    said = {"env": env.get("config", {}), "reward": env.get("reward", {})}
    return {
        name: {key: value for key, value in said[name].items() if value != usual[name].get(key)}
        for name in usual
    }
