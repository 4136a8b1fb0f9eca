"""One mechanism for every config: names, types and ranges are refused in one sentence."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Literal

import pytest

from coordlog.config import build, change, load_toml, parse_assignment, plain
from coordlog.errors import ConfigError


@dataclass(frozen=True)
class Sample:
    """A config with a field of every type in use."""

    rate: float = 1.0
    count: int = 3
    on: bool = True
    name: str = "a"
    widths: tuple[int, ...] = (1, 2)
    limit: float | None = None
    cutoff: str | float = "max"
    kind: Literal["x", "y"] = "x"


def test_plain_values_build_the_same_config_again():
    sample = Sample(rate=2.5, widths=(4,), limit=0.5, cutoff=3.0, kind="y")
    assert build(Sample, plain(sample)) == sample
    assert change(Sample(), plain(sample)) == sample


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"rat": 1}, "unknown Sample key 's.rat'; choose one of: .*s.rate"),
        ({"rate": "fast"}, "s.rate: expected a number, got 'fast'"),
        ({"rate": True}, "s.rate: expected a number, got True"),
        ({"count": 1.5}, "s.count: expected a whole number, got 1.5"),
        ({"count": False}, "s.count: expected a whole number, got False"),
        ({"on": 1}, "s.on: expected true or false, got 1"),
        ({"name": None}, "s.name: expected a text, got None"),
        ({"widths": 3}, "s.widths: expected a list, got 3"),
        ({"widths": [1, "b"]}, "s.widths: expected a list of whole numbers, got"),
        ({"limit": "x"}, "s.limit: expected a number, got 'x'"),
        ({"cutoff": [1]}, "s.cutoff: expected a text or a number, got"),
        ({"kind": "z"}, "s.kind: expected one of x, y, got 'z'"),
        ([1, 2], r"s: expected a table of keys, got \[1, 2\]"),
    ],
)
def test_a_wrong_value_is_one_sentence(values, message):
    with pytest.raises(ConfigError, match=message):
        build(Sample, values, prefix="s.")


def test_a_whole_number_is_a_number_and_a_list_a_tuple():
    built = build(Sample, {"rate": 2, "widths": [5, 6]})
    assert built == Sample(rate=2.0, widths=(5, 6))
    assert isinstance(built.rate, float)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("a.b=1", ("a", "b", 1)),
        ("a.b = [1, 2]", ("a", "b", [1, 2])),
        ("a.b=word", ("a", "b", "word")),
        ("a.b.c=1.5", ("a", "b.c", 1.5)),
        ("a.b=", ("a", "b", "")),
    ],
)
def test_an_assignment_is_read_as_toml_or_text(text, found):
    assert parse_assignment(text) == found


@pytest.mark.parametrize("text", ["a=1", "a.b", ".b=1", "a.=1", ""])
def test_another_form_is_refused(text):
    with pytest.raises(ConfigError, match=r"--set: expected section\.key=value"):
        parse_assignment(text)


def test_a_pipe_is_no_file_of_settings_and_nobody_waits_for_it(tmp_path):
    os.mkfifo(tmp_path / "a.toml")
    with pytest.raises(ConfigError, match="expected a file with the robot's card, got a folder"):
        load_toml(tmp_path / "a.toml", "robot's card")
