"""What the hold task logs of its own, for every step."""

from __future__ import annotations

from coordlog.spec import Field

FIELDS = (
    Field("goals", "float64", "3*k", "m", "goal of each arm before the action, x y z", "before", "hold"),
    Field("distance", "float64", "k", "m", "palm to goal of each arm after the action", "after", "hold"),
    Field("boundary", "bool", "k", "", "palm within the goal boundary after the action", "after", "hold"),
    Field("goal", "bool", "k", "", "palm within the goal radius after the action", "after", "hold"),
    Field("collision", "bool", "", "", "any contact other than sole on floor, at any substep", "after", "hold"),
    Field("instability", "bool", "", "", "centre of mass left the support polygon, or torso tipped", "after", "hold"),
)
