"""Numbers as text never flatter, and intervals are those of the textbook."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from experiments.stats import down, median_interval, percent_down, percent_up, rate, spread, up


@given(st.integers(1, 5000).flatmap(lambda of: st.tuples(st.integers(0, of), st.just(of))))
def test_a_share_as_text_is_never_better_than_it_is(share: tuple[int, int]) -> None:
    count, of = share
    exact, low, high = (
        100 * count / of,
        float(percent_down(count, of)[:-2]),
        float(percent_up(count, of)[:-2]),
    )
    assert low <= exact + 1e-9
    assert exact - low < 0.1 + 1e-9
    assert high >= exact - 1e-9
    assert high - exact < 0.1 + 1e-9


def test_examples_at_the_edge() -> None:
    assert percent_down(9949, 10000) == "99.4 %"
    assert percent_up(1, 10000) == "0.1 %"
    assert percent_down(500, 500) == "100.0 %"
    assert (percent_down(0, 7), percent_up(0, 7)) == ("0.0 %", "0.0 %")
    assert (down(2.99), up(2.91), down(0.3), up(0.3), up(-0.05), down(-0.05)) == (
        "2.9",
        "3.0",
        "0.3",
        "0.3",
        "0.0",
        "-0.1",
    )


def test_the_interval_is_wilsons() -> None:
    for count, of in ((0, 50), (47, 50), (500, 500)):
        z, p = 1.959963984540054, count / of
        middle, half = (
            (p + z * z / (2 * of)) / (1 + z * z / of),
            z * math.sqrt(p * (1 - p) / of + z * z / (4 * of * of)) / (1 + z * z / of),
        )
        found = rate(count, of)
        assert found["low"] == pytest.approx(max(0.0, middle - half), abs=1e-12)
        assert found["high"] == pytest.approx(min(1.0, middle + half), abs=1e-12)


def test_percentiles_and_medians_leave_out_what_is_no_number() -> None:
    assert spread([3.0, math.inf, 1.0, 2.0], least=0, median=50) == {"least": 1.0, "median": 2.0}
    assert spread([math.inf], median=50) is None
    found = median_interval([1.0, 2.0, math.nan, 3.0])
    assert found is not None
    assert (found["median"], found["n"]) == (2.0, 3)
    assert found["low"] <= 2.0 <= found["high"]
    assert found == median_interval([1.0, 2.0, math.nan, 3.0]), "the same at every run"
    assert median_interval([]) is None
