from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
import torch

from coordlog.errors import FormatError, StorageError
from coordlog.train.digrad import Update
from coordlog.train.metrics import MetricsLog, Tally, Watch, read_metrics


def update(value: float) -> Update:
    scalar = torch.tensor(value)
    return Update(
        scalar,
        torch.stack((scalar, -scalar)),
        scalar - 1,
        scalar + 1,
        torch.stack((scalar, scalar)),
        scalar,
        torch.tensor(0.5),
    )


def test_a_tally_gives_means_and_extremes_by_name() -> None:
    tally = Tally(("left", "right"))
    assert tally.row() == {}
    for value in (1.0, 2.0, 6.0):
        tally.add(update(value))
    row = tally.row()
    assert row == pytest.approx(
        {
            "critic_loss": 3,
            "q_left": 3,
            "q_right": -3,
            "value_left": 3,
            "value_right": 3,
            "behaviour": 3,
            "saturation": 0.5,
            "q_low": 0,
            "q_high": 7,
        }
    )
    other = Tally(("left", "right"))
    other.load_state(tally.state())
    for each in (tally, other):
        each.add(update(0.1))
    assert tally.row() == other.row()
    tally.clear()
    assert tally.row() == {}


def test_one_value_that_is_not_finite_shows_at_once() -> None:
    tally = Tally(("left", "right"))
    tally.add(update(1.0))
    assert tally.finite
    tally.add(update(math.nan))
    tally.add(update(1.0))
    assert not tally.finite
    event = Watch((-10.0, 10.0)).check(tally.row())
    assert event is not None
    assert event.name == "not_finite"
    assert "critic_loss" in event.advice
    assert "lower the learning rates" in event.advice


@pytest.mark.parametrize(
    ("row", "name", "words"),
    [
        ({"q_low": -10.0, "q_high": 29.0, "saturation": 0.5}, None, ""),
        (
            {"q_low": -10.0, "q_high": 31.0},
            "q_out_of_bounds",
            r"Q spans [-10, 31] but no return lies outside [-10, 10]",
        ),
        ({"q_low": -31.0, "q_high": 0.0}, "q_out_of_bounds", "learner.clip_targets = true"),
        (
            {"q_low": 0.0, "q_high": 0.0, "saturation": 0.96},
            "saturated",
            "96% of the actions are at their limits",
        ),
        ({"critic_loss": math.inf}, "not_finite", "critic_loss not finite"),
        ({}, None, ""),
    ],
)
def test_a_divergence_has_a_name_and_advice(
    row: dict[str, float], name: str | None, words: str
) -> None:
    event = Watch((-10.0, 10.0)).check(row)
    assert (event.name if event else None) == name
    assert words in (event.advice if event else "")


def test_rows_are_lines_of_strict_json(tmp_path: Path) -> None:
    log = MetricsLog(tmp_path / "run" / "metrics.jsonl")
    log.write({"update": 1, "loss": math.nan, "kind": "training"})
    log.write({"update": 2, "loss": 0.5})
    lines = (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()
    assert [json.loads(line) for line in lines] == [
        {"update": 1, "loss": None, "kind": "training"},
        {"update": 2, "loss": 0.5},
    ]
    assert read_metrics(log.path) == [json.loads(line) for line in lines]


def test_a_resumed_log_drops_what_came_after_and_a_torn_line(tmp_path: Path) -> None:
    path = tmp_path / "metrics.jsonl"
    log = MetricsLog(path)
    for number in (1, 2, 3):
        log.write({"update": number})
    with path.open("a") as file:
        file.write('{"update": 4')
    assert [row["update"] for row in read_metrics(path)] == [1, 2, 3]
    resumed = MetricsLog(path, resume_at=2)
    resumed.write({"update": 5})
    assert [row["update"] for row in read_metrics(path)] == [1, 2, 5]


def test_a_log_that_cannot_be_read_or_written_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "metrics.jsonl"
    with pytest.raises(StorageError, match="cannot be read"):
        MetricsLog(path, resume_at=3)
    path.write_text('{"update": 1}\nnonsense\n{"update": 2}\n')
    with pytest.raises(FormatError, match="line 2 is not a row"):
        read_metrics(path)
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="cannot be written"):
        MetricsLog(tmp_path / "file" / "metrics.jsonl")


def test_what_an_evaluation_touched_first_is_a_word(tmp_path: Path) -> None:
    log = MetricsLog(tmp_path / "metrics.jsonl")
    row = {"kind": "evaluation", "update": 3, "step": 8, "clean": 0.5, "touched": "table and arm"}
    log.write(dict(row))
    assert read_metrics(log.path) == [row]
    log.write({**row, "clean": "half"})
    with pytest.raises(FormatError, match="line 2 is not a row of metrics: 'clean'"):
        read_metrics(log.path)
