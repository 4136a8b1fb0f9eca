"""Tests for the figure of learning curves: what is drawn is what it was given."""

from __future__ import annotations

import numpy as np

from coordlog.view.curves import Curve, curves_figure

X, MEAN, DEVIATION = (
    np.array([0.0, 10.0, 20.0]),
    np.array([0.1, 0.5, 0.7]),
    np.array([0.0, 0.1, 0.2]),
)
RUNS = [(X, MEAN - 0.1), (X, MEAN + 0.1)]


def test_a_mean_stands_in_its_deviation_with_every_run_behind_it() -> None:
    curves = [
        Curve("live", X, MEAN / 2, DEVIATION, dashed=True),
        Curve("live", X, MEAN, DEVIATION, RUNS),
    ]
    figure = curves_figure(
        {
            "free": {"success": curves},
            "table": {"score": [Curve("logs", X, MEAN, DEVIATION, RUNS[:1])]},
        },
        against="episodes",
    )
    panels = {axes.get_title(): axes for axes in figure.axes}
    assert list(panels)[:2] == ["free: score, -ln Σ error", "free: success"], "and no others"
    axes = panels["free: success"]
    dashed, *runs, mean = axes.lines
    assert (dashed.get_linestyle(), dashed.get_color()) == ("--", mean.get_color())
    assert [line.get_ydata().tolist() for line in runs] == [
        (MEAN - 0.1).tolist(),
        (MEAN + 0.1).tolist(),
    ]
    assert (mean.get_ydata() == MEAN).all()
    (area,) = axes.collections
    corners = area.get_paths()[0].vertices
    assert np.isin(np.concatenate([MEAN - DEVIATION, MEAN + DEVIATION]), corners[:, 1]).all()
    assert axes.get_xlabel() == "episodes"
    assert len(panels["table: score, -ln Σ error"].lines) == 1, "a single run is its own mean"
    assert not panels["free: score, -ln Σ error"].lines


def test_a_label_says_how_many_runs_and_groups_differ_in_colour() -> None:
    curves = [Curve("mask", X, MEAN, DEVIATION, RUNS), Curve("sum", X, MEAN, DEVIATION, RUNS[:1])]
    axes = curves_figure({"free": {"score": curves}}, against="updates").axes[0]
    assert [text.get_text() for text in axes.get_legend().get_texts()] == [
        "mask (2 runs)",
        "sum (1 run)",
    ]
    assert axes.lines[-1].get_color() != axes.lines[-2].get_color()
