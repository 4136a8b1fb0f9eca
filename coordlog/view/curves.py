"""Learning curves as a printed figure (the paper's Figure 4): a row of panels per scene, mean and
deviation over seeds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, PercentFormatter

from coordlog.episode import Array
from coordlog.view.palette import JOINTS, cycle

PANELS = {
    "score": "score, -ln Σ error",
    "success": "success",
    "clean": "clean success",
    "return": "return",
}
"""Figures that are drawn, and what stands above them; the last is that of environments that are not
ours, which have no other.
"""
RATES = ("success", "clean")


@dataclass(frozen=True, eq=False)
class Curve:
    """Some runs' mean as a line, their deviation as an area around it, and every single run pale
    behind it.
    """

    label: str
    x: Array  # (n,)
    mean: Array  # (n,)
    deviation: Array  # (n,)
    runs: Sequence[tuple[Array, Array]] = ()
    dashed: bool = False
    """For figures of episodes in which actions were explored.

    Drawn without the area and the single runs.
    """


def curves_figure(scenes: Mapping[str, Mapping[str, Sequence[Curve]]], *, against: str) -> Figure:
    """The figure.

    Args:
        scenes: Curves by scene and by figure, the keys of PANELS. Curves of one label have one
            colour.
        against: What x counts.
    """
    names = [name for name in PANELS if any(name in curves for curves in scenes.values())]
    figure = Figure(figsize=(4.4 * len(names), 3.3 * len(scenes) + 0.5), layout="constrained")
    grid = figure.subplots(len(scenes), len(names), squeeze=False, sharex="row")
    for axes_of_scene, (scene, curves) in zip(grid, scenes.items(), strict=True):
        labels = list(
            dict.fromkeys(curve.label for members in curves.values() for curve in members)
        )
        colours = {
            label: tuple(part / 255 for part in cycle(JOINTS, i)[:3])
            for i, label in enumerate(labels)
        }
        for axes, name in zip(axes_of_scene, names, strict=True):
            for curve in curves.get(name, ()):
                _draw(axes, curve, colours[curve.label])
            axes.set(title=f"{scene}: {PANELS[name]}", xlabel=against)
            axes.xaxis.set_major_formatter(EngFormatter(sep=""))
            axes.set_xlim(left=0)
            axes.grid(alpha=0.25)
            if name in RATES:
                axes.set_ylim(-0.03, 1.03)
                axes.yaxis.set_major_formatter(PercentFormatter(1.0))
        if axes_of_scene[0].lines:
            axes_of_scene[0].legend(fontsize=7, frameon=False)
    return figure


def _draw(axes: Axes, curve: Curve, colour: tuple[float, ...]) -> None:
    if curve.dashed:
        axes.plot(
            curve.x,
            curve.mean,
            "--",
            color=colour,
            linewidth=0.9,
            alpha=0.7,
            label=f"{curve.label}, while exploring",
        )
        return
    for x, y in curve.runs if len(curve.runs) > 1 else ():
        axes.plot(x, y, color=colour, linewidth=0.6, alpha=0.35)
    axes.fill_between(
        curve.x,
        curve.mean - curve.deviation,
        curve.mean + curve.deviation,
        color=colour,
        alpha=0.2,
        linewidth=0,
    )
    count = f"{len(curve.runs)} run" + ("s" if len(curve.runs) > 1 else "")
    axes.plot(
        curve.x,
        curve.mean,
        marker=".",
        color=colour,
        linewidth=1.6,
        label=f"{curve.label} ({count})",
    )
