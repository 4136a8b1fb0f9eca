"""The page is what the tables say, rows without a table say so, and verdicts follow the numbers."""

from __future__ import annotations

import copy
import json
from typing import Any

import pytest

from coordlog.policies.registry import SHIPPED
from experiments import cells, claims, planning, tables
from experiments.recipes import recipes, row_names
from experiments.report import PAGE, README, readme, render, scene_table, shipped
from experiments.stats import rate


@pytest.fixture(scope="module")
def found() -> dict[str, Any]:
    return tables.read_all()


def made(
    row: str, scene: str, count: int, *, of: int = 500, seed: int | None = None, torso: str = "free"
) -> dict[str, Any]:
    share = rate(count, of)
    figures = dict.fromkeys(("success", "clean"), share) | {
        name: rate(of - count, of) for name in ("collisions", "falls")
    }
    figures |= {
        "error": {"median": 0.0401, "p95": 0.05},
        "score": {"mean": 3.129},
        "clearance": None,
    }
    figures |= {"steps": {"median": 111.0, "p95": 120.0}, "apart": {"median": 4.0, "p95": 13.0}}
    decision = {
        "act": {"median": 61e-6, "p95": 1e-4},
        "begin": {"median": 0.0, "p95": 0.0},
        "calls": 9,
        "control_period": 0.04,
    }
    return {
        "row": row,
        "scene": scene,
        "torso": torso,
        "training_seed": seed,
        "policy": {"training": {}},
        "3 cm": figures,
        "2 cm": figures,
        "decision": decision,
        "problems": {"seed": 1, "split": "test", "episodes": of},
    }


def row_of(text: str, title: str) -> list[str]:
    (line,) = [line for line in text.splitlines() if line.startswith(f"| {title} |")]
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_the_page_is_up_to_date(found: dict[str, Any]) -> None:
    assert PAGE.read_text(encoding="utf-8") == render(found), (
        "python -m experiments.report writes it anew"
    )


def test_the_readme_is_up_to_date(found: dict[str, Any]) -> None:
    text = README.read_text(encoding="utf-8")
    assert text == readme(text, found), "python -m experiments.report writes it anew"


def test_every_table_is_called_what_it_is_and_belongs_to_a_row(found: dict[str, Any]) -> None:
    for name, table in found.items():
        if "row" in table:
            assert name == tables.name_of(
                table["row"], table["scene"], torso=table["torso"], seed=table["training_seed"]
            )
            assert table["row"] in row_names()
            assert table["problems"]["split"] == "test"
            assert table["problems"]["seed"] != 0, "seed 0 chooses the best policy of a run"


def test_a_row_that_has_no_table_says_so() -> None:
    text = scene_table({"table-expert": made("expert", "table", 500)}, "table")
    assert row_of(text, "DiGrad live")[1:4] == ["", "", "not run"]
    assert row_of(text, "DiGrad from logs")[-1] == "not run"
    assert row_of(text, "Scripted expert")[1:5] == [
        "1",
        "500",
        "100.0 % (99.2-100.0)",
        "100.0 % (99.2-100.0)",
    ]
    assert len({len(line.split("|")) for line in text.strip().splitlines()}) == 1, (
        "every line has every column"
    )


def test_a_row_that_only_some_scenes_have_is_not_missed_elsewhere() -> None:
    title = recipes()["rows"]["bare"]["title"]
    assert title in scene_table({}, "spheres")
    assert title not in scene_table({}, "table")


def test_a_shield_is_said_beside_the_scene() -> None:
    behind = made("shipped", "spheres", 480) | {
        "policy": {"training": {}, "shield": "velocity damper"}
    }
    text = shipped({"a": behind, "b": made("bare", "spheres", 430)})
    assert row_of(text, "spheres, with its shield")[4] == "met"
    assert row_of(text, "spheres, without its shield")[4] == "missed by 9.0 points"


def test_several_seeds_are_counted_and_span_a_range() -> None:
    both = {
        str(seed): made("digrad-live", "free", count, seed=seed)
        for seed, count in enumerate((497, 489, 500))
    }
    cells = row_of(scene_table(both, "free"), "DiGrad live")
    assert cells[1] == "3"
    assert cells[4] == "99.0 % (97.8-100.0)"  # 1486 of 1500 is 99.07
    assert cells[6] == "1.0 % (0.0-2.2)"


def test_a_target_is_met_or_missed_by_so_much() -> None:
    assert row_of(shipped({"a": made("shipped", "table", 495)}), "table")[4] == "met"
    assert (
        row_of(shipped({"a": made("shipped", "table", 494)}), "table")[4] == "missed by 0.2 points"
    )
    assert (
        row_of(shipped({"a": made("shipped", "spheres", 600, of=1000)}), "spheres")[4]
        == "missed by 35.0 points"
    )


def test_a_claim_without_a_table_is_not_run_and_one_with_follows_its_numbers(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert claims.decision({}).measured == ""
    monkeypatch.setattr(claims.curves, "saturated", lambda _: None)
    assert claims.saturation({}).verdict.startswith("does not hold: "), (
        "there are curves, and none has settled"
    )
    monkeypatch.setattr(claims.curves, "live", lambda _: [])
    assert claims.section({}).count(claims.NOT_RUN) == len(claims.CHECKS)
    table = {"table-shipped": made("shipped", "table", 500)}
    assert claims.decision(table).verdict.startswith("holds")
    table["table-shipped"]["decision"]["act"]["median"] = 0.0021
    assert claims.decision(table).verdict.startswith("does not hold: table")
    assert claims.avoidance({"a": made("shipped", "table", 470)}).verdict.startswith(
        "does not hold"
    )
    reach = {
        "table-reach": {"free": rate(50, 50), "locked": rate(10, 50)},
        "shelf-reach": {"free": rate(50, 50), "locked": rate(50, 50)},
    }
    assert claims.spine(reach).verdict == "does not hold: shelf; holds: table"
    grown = {
        "growth": {
            "rows": [
                {"knots": n, "paper": {"checks": n * 260, "cpu": n * 1e-3}} for n in (100, 400)
            ]
        }
    }
    assert "does not hold: 4 × the knots take 4.0 × the checks" in claims.growth(grown).verdict


def test_planning_follows_its_numbers() -> None:
    middle = {"median": 0.05, "low": 0.04, "high": 0.06, "n": 10}
    way = {name: rate(9, 10) for name in ("success", "clean", "certified")} | dict.fromkeys(
        ("cpu", "seconds", "jerk", "smooth"), middle
    )
    ratios = {name: middle | {"median": 1.2} for name in ("cpu", "jerk", "jerk_same_duration")}
    table: dict[str, Any] = {name: copy.deepcopy(way) for name in planning.WAYS}
    table |= {"problems": {"episodes": 10}, "ratios": {"kinematic": ratios, "physics": ratios}}
    text = planning.section({"shelf-planning": table})
    assert "| shelf | OMPL RRTConnect + IK + simplify | 10 | 50.0 (40.0-60.0) |" in text
    assert "no proof" in text
    assert "| 1.20 (" in text
    assert "does not hold: shelf" in claims.planning({"shelf-planning": table}).verdict


def test_costs_are_said_where_they_were_measured() -> None:
    table = made("digrad-logs", "table", 500, seed=0)
    assert cells.costs([table]) == []
    table["policy"]["cost"] = {"updates": 10000, "steps": 0, "seconds": 212.0}
    assert cells.costs([table]) == ["table: 10,000 updates in 3.6 min"]


def test_every_recipe_says_what_it_is_and_how() -> None:
    for name, recipe in recipes()["rows"].items():
        assert recipe["title"], name
        assert recipe["about"], name
        assert recipe["commands"], name
        assert recipe.get("needs", "logs") in recipes(), name


def test_cards_say_what_the_tables_say(found: dict[str, Any]) -> None:
    for path in SHIPPED.glob("*.json"):
        card = json.loads(path.read_text(encoding="utf-8"))
        row = f"shipped-{card['kind']}" if card.get("kind") else "shipped"
        table = found[f"{card['scene']}-{row}"]
        assert card["sha256"] == table["policy"]["sha256"]
        for radius in ("3 cm", "2 cm"):
            for name in ("success", "clean", "collisions", "falls"):
                assert card["held_out"][radius][name] == table[radius][name]["rate"]
        assert card["held_out"]["problems"] == table["problems"]
