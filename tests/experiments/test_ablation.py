"""What single settings are worth: the changes can be made, and what is written of them."""

from __future__ import annotations

from typing import Any

import pytest

from coordlog.train.settings import load_settings
from experiments import ablation
from experiments.stats import rate

RUNS = [
    pytest.param(ladder, each, id=f"{name}-{each['name']}")
    for name, ladder in ablation.ladders().items()
    for each in ladder["runs"]
]
AROUND = ("env.", "reward.")


@pytest.mark.parametrize(("ladder", "each"), RUNS)
def test_every_change_changes_its_preset(ladder: dict[str, Any], each: dict[str, Any]) -> None:
    preset = each.get("preset", ladder["preset"])
    assignments = [one for one in each.get("set", ()) if not one.startswith(AROUND)]
    usual = load_settings(preset=preset)
    for one in assignments:
        assert load_settings(preset=preset, assignments=(one,)) != usual, one


def test_names_are_unique() -> None:
    for ladder in ablation.ladders().values():
        names = [each["name"] for each in ladder["runs"]]
        assert len(set(names)) == len(names)


def test_a_run_that_never_learnt_says_so() -> None:
    none = rate(0, 200)
    row = {"name": "rates", "change": "rates 1e-4", "learnt": None}
    row |= dict.fromkeys(("success", "clean", "falls"), none)
    problems = {"seed": 1, "split": "test", "episodes": 200}
    text = ablation.section(
        {"ablation-paper": {"steps": 40_000, "problems": problems, "rows": [row]}}
    )
    assert "40,000 steps" in text
    assert "| rates 1e-4 | never | 0.0 % (0.0-1.8) | 0.0 % (0.0-1.8) | 0.0 % (0.0-1.9) |" in text


def test_nothing_is_written_of_what_was_not_run() -> None:
    assert ablation.section({}) == ""
