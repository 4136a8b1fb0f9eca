"""The checker's contract, and that the checkers of these tests keep it."""

import re
import runpy
import textwrap

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coordlog.smooth import DistanceChecker, Unobstructed, Verdict, feasibility, smooth
from tests.smooth.planar import PlanarArm


def test_verdict_names_the_worst_pair():
    verdict = Verdict.from_slack(np.array([[0.1, -0.2, -0.1], [0.0, 0.3, 0.1], [np.nan, 1.0, 1.0]]))
    assert verdict.free.tolist() == [False, True, False]
    assert verdict.depth.tolist() == [0.2, 0.0, np.inf]
    assert verdict.what.tolist() == [1, -1, 0]


def test_verdict_without_pairs_is_free():
    assert Verdict.from_slack(np.zeros((3, 0))).free.all()


def test_the_documented_example_is_a_checker(tmp_path):
    example = re.search(r"    class Corridor.*?(?=\Z)", feasibility.__doc__, re.DOTALL).group()
    source = "import numpy as np\nfrom coordlog.smooth import Verdict\n" + textwrap.dedent(example)
    file = tmp_path / "corridor.py"
    file.write_text(source)
    corridor = runpy.run_path(str(file))["Corridor"]()
    assert isinstance(corridor, DistanceChecker)
    time = np.linspace(0.0, 1.0, 50)
    q = 0.8 * np.stack([np.sin(3 * time), np.cos(3 * time)], axis=1)
    result = smooth(time, q + 0.01 * np.random.default_rng(0).normal(size=q.shape), corridor)
    assert (result.status, result.certified) == ("smoothed", True)
    assert result.after.jerk < 0.02 * result.before.jerk


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10_000))
def test_reach_and_drift_bound_every_change_of_slack(seed):
    rng = np.random.default_rng(seed)
    arm = PlanarArm(
        rng.uniform(0.05, 0.2, 5),
        rng.uniform(-0.5, 0.5, (3, 3)) * [1, 1, 0.1],
        sway=0.02,
        balance=0.3,
    )
    q, t = (
        rng.uniform(-2.0, 2.0, (2, 40, 5)) * [[[1.0]], [[rng.uniform()]]],
        rng.uniform(0.0, 1.0, (2, 40)),
    )
    q[1] += q[0]
    at_rest = arm.slack(t[0], q[1], 0.0) - arm.slack(t[0], q[0], 0.0)
    assert (abs(at_rest) <= abs(q[1] - q[0]) @ arm.reach.T + 1e-12).all()
    swaying = arm.slack(t[1], q[0], 0.0) - arm.slack(t[0], q[0], 0.0)
    assert (
        abs(swaying) <= arm.drift(t.min(axis=0), t.max(axis=0)) * abs(t[1] - t[0])[:, None] + 1e-12
    ).all()


def test_unobstructed_is_a_distance_checker():
    free = Unobstructed(3)
    assert isinstance(free, DistanceChecker)
    assert free.check(np.zeros(4), np.zeros((4, 3)), 0.0).free.all()
    assert free.drift(np.zeros(2), np.ones(2)).shape == (2, 0)
    with pytest.raises(AttributeError):
        free.nothing_else  # noqa: B018
