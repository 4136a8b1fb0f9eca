"""How the overview's panels are arranged."""

from __future__ import annotations

import rerun.blueprint as rrb

from coordlog.episode import Array
from coordlog.view.camera import look_at
from coordlog.view.layout import panes, space

TIMELINE = "episode"
RANK = "rank"
"""Orders the table: the episode to look at first has 0."""


def overview_layout(points: Array) -> rrb.Blueprint:
    """Scene and lanes on the left.

    Summary, table, the episode under the cursor and errors on the right; `points` (n, 3) must be
    seen.
    """
    scene = space("hand paths of all episodes, by how they ended", look_at(points), ["+ /world/**"])
    rates = rrb.TimeSeriesView(
        origin="/rate", name="running rates", axis_y=rrb.ScalarAxis(range=(-0.02, 1.02))
    )
    lanes = rrb.StateTimelineView(origin="/lane", name="by episode")
    table = rrb.DataframeView(
        origin="/table",
        name="table, failures first",
        query=rrb.archetypes.DataframeQuery(timeline=RANK),
    )
    words = rrb.Tabs(rrb.TextDocumentView(origin="/about", name="summary"), table, active_tab=0)
    cursor = rrb.TextDocumentView(origin="/episode", name="episode under the cursor")
    errors = rrb.Tabs(
        rrb.BarChartView(origin="/histogram", name="episodes by final distance [cm]"),
        rrb.TimeSeriesView(origin="/final", name="final distance [cm] by episode"),
    )
    left = rrb.Vertical(scene, rrb.Horizontal(lanes, rates), row_shares=[7, 3])
    right = rrb.Vertical(words, cursor, errors, row_shares=[6, 3, 3])
    panels = rrb.Horizontal(left, right, column_shares=[3, 2])
    return rrb.Blueprint(
        panels, *panes(timeline=TIMELINE, play="paused"), auto_layout=False, auto_views=False
    )
