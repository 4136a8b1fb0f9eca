"""How a training run is followed: a bar, a window of the viewer, event files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from coordlog.monitor import Progress

if TYPE_CHECKING:
    from coordlog.train.events import EventFiles
    from coordlog.train.metrics import Row
    from coordlog.view.live import Live


@contextmanager
def watch(name: str) -> Iterator[Live]:
    """A viewer's window in which a run is watched."""
    from coordlog.view.live import Live
    from coordlog.view.viewer import Viewer

    with Viewer() as viewer, Live(name, url=viewer.url) as live:
        yield live


class Follower:
    """Hears of each row of metrics: how far the run is, and its latest figures."""

    def __init__(
        self,
        progress: Progress,
        *,
        by_steps: bool,
        window: Live | None = None,
        events: EventFiles | None = None,
    ) -> None:
        """Say nothing yet.

        Args:
            progress: Of the budget.
            by_steps: It is one of live steps; else of updates.
            window: Where figures are drawn, if anywhere.
            events: Where they are written as well, if anywhere.
        """
        self._progress, self._by_steps = progress, by_steps
        self._window, self._events = window, events
        self._note: dict[str, str] = {}

    def __call__(self, row: Row) -> None:
        """Take in a row of metrics."""
        if row["kind"] == "evaluation":
            rates = "  ".join(
                f"{name} {float(row[name] or 0):.0%}"
                for name in ("clean", "success", "falls", "home_clean")
                if name in row
            )
            if "return" in row:
                rates = f"return {float(row['return'] or 0):.2f}"
            touched = f"  touches {row['touched']} first" if row.get("touched") else ""
            self._note["held-out"] = f"{rates.replace('home_clean', 'clean from home')}{touched}"
        elif row["kind"] == "training":
            rate = f"{float(row['updates_per_second'] or 0):.0f} updates/s"
            live = f", {float(row['steps_per_second'] or 0):,.0f} steps/s" if row["step"] else ""
            self._note["speed"] = rate + live
        if self._events is not None:
            self._events(row)
        if self._window is not None:
            self._window.figures(int(row["update"] or 0), curves(row))
        done = row["step"] if self._by_steps else row["update"]
        self._progress.update(float(done or 0), "  ".join(self._note.values()))


def curves(row: Row) -> dict[str, float]:
    """The points of a row of metrics, as "panel/curve"."""
    if row["kind"] == "evaluation":
        panels = {
            "held-out": ("success", "clean", "collisions", "falls", "home_clean"),
            "score": ("score",),
            "return": tuple(name for name in row if name.startswith("return")),
        }
    else:
        panels = {
            "loss": ("critic_loss", "behaviour"),
            "value": tuple(name for name in row if name.startswith(("q_", "value_"))),
        }
    return {
        f"{panel}/{name}": float(row[name] or 0)
        for panel, names in panels.items()
        for name in names
        if name in row
    }
