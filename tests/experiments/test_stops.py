"""Where live learning stops: figures of episodes as they were recorded, and the section they
become."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import coordlog
from experiments import stops

LOGS = Path(__file__).parents[1] / "data" / "v1"


def test_figures_are_those_of_the_episodes() -> None:
    episodes = list(coordlog.open(LOGS / "spheres"))
    found = stops._row(episodes)
    assert [found[name]["count"] for name in ("touched", "fell", "success")] == [1, 1, 1]
    (touched,) = [episode for episode in episodes if episode.collision.any()]
    assert found["touch_step"] == np.flatnonzero(touched.collision)[0]
    pair, times = found["touch"]
    assert times == 1
    assert not pair.startswith(("l_", "r_")), "sides are left out"
    assert found["length"] == np.median([len(episode) for episode in episodes])


def test_returns_are_discounted_from_the_first_step() -> None:
    episodes = list(coordlog.open(LOGS / "table"))
    returns = []
    for episode in episodes:
        total = 0.0
        for reward in episode.reward.mean(axis=1)[::-1]:
            total = reward + stops.GAMMA * total
        returns.append(total)
    assert stops._row(episodes)["return"] == pytest.approx(np.median(returns))


def test_a_policy_that_touches_nothing_has_no_first_touch() -> None:
    row = stops._row(list(coordlog.open(LOGS / "table")))
    assert row["touch"] is None
    table = {
        "kind": "stops",
        "scene": "table",
        "rows": [row, row | {"steps": 150000, "reward": {"n1": 0.3, "n2": 60.0}}],
    }
    text = stops.section({"table-stops": table})
    assert "| table | stands still |  | 66.6 % (" in text
    assert "| table | 150,000 | 0.3, 60 |" in text


def test_without_a_table_there_is_no_section() -> None:
    assert stops.section({}) == ""
