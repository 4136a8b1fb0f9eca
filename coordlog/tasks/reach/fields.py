"""What the reach task logs of its own, for every step."""

from __future__ import annotations

from coordlog.spec import Field

FIELDS = (
    Field("distance", "float64", "k", "m", "palm to goal of each arm after the action"),
    Field("boundary", "bool", "k", "", "palm within the goal boundary after the action"),
    Field("goal", "bool", "k", "", "palm within the goal radius after the action"),
    Field("collision", "bool", "", "", "any contact other than sole on floor, at any substep"),
    Field(
        "instability", "bool", "", "", "centre of mass left the support polygon, or torso tipped"
    ),
)
