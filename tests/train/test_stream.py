"""Tests for logs that stream through a window: batches follow from the seed alone, and are of whole
episodes."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Sequence
from itertools import count, islice
from pathlib import Path

import numpy as np
import pytest

from coordlog.errors import ConfigError, FormatError, StorageError
from coordlog.parallel import mapped
from coordlog.record.addresses import sha256
from coordlog.record.dataset import open as open_logs
from coordlog.train.columns import Columns
from coordlog.train.config import ReplayConfig
from coordlog.train.loop import Trainer
from coordlog.train.replay import MixedReplay
from coordlog.train.stream import GROUP, Group, Logged, Stream, read
from coordlog.train.task import Hooks
from coordlog.train.transitions import Transitions, row_size
from tests.train import toy_arms as toy
from tests.train.test_loop import LOGS, metrics, settings, stop_after, weights

WIDTHS = (toy.N_X, toy.N_U, 2)
FILES = sorted((Path(__file__).parents[1] / "data" / "v1" / "table").glob("*.mcap"))


def listed(columns: Columns) -> list[Logged]:
    """Episodes that are named by their number."""
    return [Logged(str(at), f"{at:04}", int(length)) for at, length in enumerate(columns.length)]


def streamed(
    columns: Columns,
    *,
    rows: int,
    seed: int = 0,
    reuse: float = 8.0,
    asked: list[int] | None = None,
) -> Stream:
    """A stream of these episodes with a window of so many transitions."""

    def reader(groups: Iterator[Group]) -> Iterator[Columns]:
        for group in groups:
            places = [int(each.digest) for each in group]
            if asked is not None:
                asked.extend(places)
            yield columns.of(places)

    return Stream(listed(columns), reader, memory=rows * row_size(WIDTHS), seed=seed, reuse=reuse)


def test_the_window_holds_whole_transitions_of_the_set_and_the_newest_of_the_order() -> None:
    columns, asked = toy.logs(200), list[int]()
    stream = streamed(columns, rows=900, asked=asked)
    window = stream.open(WIDTHS, toy.reward, drawn=80)
    whole = Transitions.of_logs(columns, toy.reward)
    every = np.arange(len(whole))
    known = {row.tobytes(): at for at, row in zip(every, whole.take("state", every), strict=True)}
    for updates in (0, 30, 400):
        stream.feed(updates)
        assert 0 <= window.total - (900 + 10 * updates) < GROUP * 20
        rows = np.arange(len(window))
        same = np.array([known[row.tobytes()] for row in window.take("state", rows)])
        for name in ("action", "reward", "collision", "terminated"):
            np.testing.assert_array_equal(window.take(name, rows), whole.take(name, same))
        np.testing.assert_array_equal(window.next_state(rows), whole.next_state(same))
    first = asked[: len(columns.length)]
    assert sorted(first) == list(range(len(columns.length))), "each once a pass"
    assert asked[len(first) :][: len(first)] != first, "every pass in an order of its own"


def test_the_order_depends_on_the_seed_and_the_episodes_not_on_how_they_are_listed() -> None:
    columns = toy.logs(60)
    orders = []
    for seed, turned in ((0, False), (0, True), (1, False)):
        asked: list[int] = []
        stream = streamed(columns, rows=700, seed=seed, asked=asked)
        if turned:
            logged = list(reversed(stream._logged))
            stream = Stream(logged, stream._reader, memory=stream._memory, seed=seed)
        stream.open(WIDTHS, toy.reward, drawn=80)
        stream.feed(100)
        orders.append(asked[:60])
    assert orders[0] == orders[1] != orders[2]


def test_a_set_that_fits_is_read_once_and_stays() -> None:
    columns, asked = toy.logs(40), list[int]()
    stream = streamed(columns, rows=10_000, asked=asked)
    window = stream.open(WIDTHS, toy.reward, drawn=80)
    for updates in (0, 100, 10_000):
        stream.feed(updates)
    assert sorted(asked) == list(range(40))
    assert len(window) == window.total == stream.transitions == int(columns.length.sum())
    assert len([*stream._order()]) == -(-40 // GROUP), "nothing is read ahead for another pass"


def test_goals_in_hindsight_are_of_the_same_episode(rng: np.random.Generator) -> None:
    columns = toy.logs(200)
    stream = streamed(columns, rows=900)
    window = stream.open(WIDTHS, toy.reward, drawn=80)
    stream.feed(150)
    rows, view = window.draw(rng, 500), toy.view()
    then, _ = window.later(rng, rows, 0)
    goals = [view.points(window.take("state", at), view.goals) for at in (rows, then)]
    np.testing.assert_array_equal(*goals)  # goals differ between episodes
    asked = ReplayConfig(batch=64, warmup=64, log_hindsight=0.5)
    batch = MixedReplay(asked, toy.task(), gamma=0.9, logs=window).sample(rng)
    assert np.isfinite(batch.reward.numpy()).all()


def test_a_window_too_small_for_a_few_episodes_is_refused() -> None:
    with pytest.raises(
        ConfigError, match=r"--memory: expected at least 1 MB, room for 32 episodes"
    ):
        streamed(toy.logs(200), rows=100).open(WIDTHS, toy.reward, drawn=8)


def test_a_resumed_run_with_a_window_equals_one_that_never_stopped(tmp_path: Path) -> None:
    columns = toy.logs(200)
    wanted = settings(
        *LOGS, "loop.updates=100", "replay.log_hindsight=0.4", "loop.evaluate_every=0"
    )

    def made(name: str, hooks: Hooks | None = None) -> Trainer:
        stream = streamed(columns, rows=700, reuse=1)
        return Trainer(toy.task(), wanted, folder=tmp_path / name, logs=stream, hooks=hooks)

    whole, parts = made("whole"), made("parts")
    whole.run()
    assert made("parts", Hooks(should_stop=stop_after(2))).run().ending == "stopped"
    parts.run(resume=True)
    assert whole.stream is not None
    assert whole.stream.window.total > 4 * 700, "the window has moved on"
    assert parts.stream is not None
    assert parts.stream.state() == whole.stream.state()
    assert weights(tmp_path / "parts") == weights(tmp_path / "whole")
    assert metrics(tmp_path / "parts") == metrics(tmp_path / "whole")


def named(paths: Sequence[Path]) -> Group:
    return tuple(
        Logged(str(path), sha256(path), len(episode))
        for path, episode in zip(paths, open_logs(paths), strict=True)
    )


def test_files_are_read_once_in_their_order_copies_included(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = Path(shutil.copy(FILES[0], tmp_path / "copy.mcap"))
    group = named([FILES[2], FILES[0], copy])
    opened, real = [], os.open

    def counted(path: object, *args: int, **kwargs: int) -> int:
        opened.append(str(path))
        return real(path, *args, **kwargs)  # type: ignore[arg-type]

    monkeypatch.setattr(os, "open", counted)
    found = read(group)
    assert sorted(opened) == sorted(each.path for each in group)
    episodes = [open_logs([each.path])[0] for each in group]
    wanted = np.concatenate([episode.state[:-1] for episode in episodes])
    np.testing.assert_array_equal(found.columns.steps["state"], wanted)
    np.testing.assert_array_equal(
        found.columns.final, np.stack([episode.state[-1] for episode in episodes])
    )
    assert set(found.envs.values()) <= {each.path for each in group}


def test_a_file_that_has_changed_or_broken_ends_the_run(tmp_path: Path) -> None:
    path = Path(shutil.copy(FILES[0], tmp_path / "a.mcap"))
    (each,) = named([path])
    shutil.copy(FILES[1], path)
    with pytest.raises(StorageError, match=r"a\.mcap: changed since the run began"):
        read((each,))
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(FormatError, match=r"a\.mcap: "):
        read((each,))


def test_what_has_no_end_is_worked_on_ahead_in_another_process() -> None:
    asked = []

    def endless() -> Iterator[int]:
        for at in count():
            asked.append(at)
            yield -at

    answers = mapped(abs, endless(), jobs=1)
    assert list(islice(answers, 3)) == [0, 1, 2]
    assert 3 < len(asked) < 20, "a few ahead of what was asked for"
    answers.close()
