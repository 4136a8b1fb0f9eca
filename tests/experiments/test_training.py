"""The command that trains a run again, written from what the run says of itself."""

from __future__ import annotations

import json

from coordlog.config import plain
from coordlog.policies.registry import SHIPPED
from coordlog.tasks.config import EnvConfig, RewardConfig
from experiments.training import KEPT, around, command


def test_constants_of_the_environment_that_are_not_as_usual_are_part_of_the_command() -> None:
    card = json.loads((SHIPPED / "table.json").read_text(encoding="utf-8"))["training"]
    run = {
        "scene": "table",
        "mode": "logs",
        "where": "",
        "settings": card["settings"],
        "seed": 3,
        "envs": 0,
        "env": card["env"],
    }
    plain = command(run)
    assert "reward." not in plain
    assert plain.endswith(f"--seed 3{KEPT}"), "it is of before `loop.average`"
    dear = run | {
        "env": {
            "config": card["env"]["config"] | {"max_steps": 90},
            "reward": card["env"]["reward"] | {"n1": 3.0},
        }
    }
    words = set(command(dear).split()) - set(plain.split())
    assert words == {"env.max_steps=90", "reward.n1=3.0"}


def test_what_is_as_usual_is_not_said() -> None:
    assert around({"config": plain(EnvConfig()), "reward": plain(RewardConfig())}) == {
        "env": {},
        "reward": {},
    }
