"""Goals that are a random posture's palms come from postures that can be taken."""

import numpy as np

from coordlog.tasks.goals import anywhere


class Halved:
    """One joint whose palm is at its angle, and which may turn one way only."""

    limits = np.array([[-1.0, 1.0]])
    standing_angles = np.zeros(1)

    def __init__(self, *, stuck: bool = False) -> None:
        self.stuck = stuck

    def palms(self, angles):
        return np.tile(angles, 3)[None]

    def solve(self, goals, *, seed=None, held=None, clearance=0.0):
        return goals[0, :1]

    def legal(self, angles, *, clearance=0.0):
        return not self.stuck and bool(angles[0] > 0.0)


def test_goals_come_from_postures_that_touch_nothing(rng):
    goals = [anywhere(rng, Halved()) for _ in range(50)]
    assert min(goal.min() for goal in goals) > 0.0


def test_there_are_no_goals_where_every_posture_touches(rng):
    assert anywhere(rng, Halved(stuck=True)) is None
