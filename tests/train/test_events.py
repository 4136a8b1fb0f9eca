"""Tests for event files: TensorBoard reads back what was written."""

from __future__ import annotations

import builtins
import math
from pathlib import Path

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from coordlog.errors import ConfigError
from coordlog.train.events import EventFiles, require_tensorboard
from coordlog.train.metrics import Row


def row(update: int, loss: float, kind: str = "training") -> Row:
    return {
        "kind": kind,
        "update": update,
        "step": 2 * update,
        "critic_loss": loss,
        "episodes": 3,
        "advice": "none",
        "q_left": None,
    }


def read(folder: Path) -> dict[str, list[tuple[int, float]]]:
    events = EventAccumulator(str(folder)).Reload()
    return {
        tag: [(event.step, event.value) for event in events.Scalars(tag)]
        for tag in events.Tags()["scalars"]
    }


def test_every_figure_of_every_row_is_read_back(tmp_path: Path) -> None:
    with EventFiles(tmp_path) as write:
        write(row(10, 0.5))
        assert read(tmp_path)["training/critic_loss"] == [(10, 0.5)], (
            "it can be watched while it is written"
        )
        write(row(20, 0.25))
        write(row(20, 2.0, "evaluation"))
    assert read(tmp_path) == {
        "training/critic_loss": [(10, 0.5), (20, 0.25)],
        "training/episodes": [(10, 3.0), (20, 3.0)],
        "evaluation/critic_loss": [(20, 2.0)],
        "evaluation/episodes": [(20, 3.0)],
    }


def test_what_a_resumed_run_takes_again_is_shown_once(tmp_path: Path) -> None:
    for losses in ({10: 0.5, 20: 0.4, 30: 0.3}, {20: 0.25, 30: 0.125}):
        with EventFiles(tmp_path) as write:
            for update, loss in losses.items():
                write(row(update, loss))
    assert read(tmp_path)["training/critic_loss"] == [(10, 0.5), (20, 0.25), (30, 0.125)]


def test_without_a_row_there_is_no_file(tmp_path: Path) -> None:
    with EventFiles(tmp_path / "none"):
        pass
    assert not (tmp_path / "none").exists()


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    require_tensorboard()
    found = builtins.__import__

    def missing(name: str, *args: object, **kwargs: object) -> object:
        if name == "torch.utils.tensorboard":
            raise ImportError(name)
        return found(name, *args, **kwargs)  # type: ignore[arg-type]

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(ConfigError, match=r"pip install 'coordlog\[tensorboard\]'"):
        require_tensorboard()


def test_a_figure_that_is_no_number_stays_one(tmp_path: Path) -> None:
    with EventFiles(tmp_path) as write:
        write(row(10, math.nan))
    ((step, value),) = read(tmp_path)["training/critic_loss"]
    assert step == 10
    assert math.isnan(value)
