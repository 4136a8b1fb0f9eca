"""Tests for the cache of decoded columns: it never changes what is read, and nothing is decoded
twice."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

from coordlog.errors import SpecError
from coordlog.record.cache import Built, Logs, load
from coordlog.record.dataset import open as open_logs

FILES = sorted((Path(__file__).parents[1] / "data" / "v1" / "table").glob("*.mcap"))


class Decoding:
    """Runs what is to be decoded, and remembers which files that were."""

    def __init__(self) -> None:
        self.files: list[str] = []

    def __call__(
        self, build: Callable[[Sequence[Path]], Built], groups: Sequence[Sequence[Path]]
    ) -> Iterator[Built]:
        for group in groups:
            self.files += [path.name for path in group]
            yield build(group)


def loaded(paths: Sequence[Path], folder: Path) -> tuple[Logs, list[str]]:
    decoding = Decoding()
    return load(paths, folder, run=decoding), decoding.files


def test_columns_are_those_of_the_files_in_their_order(tmp_path: Path) -> None:
    logs, _ = loaded(FILES, tmp_path)
    table = open_logs(FILES).to_table()
    for name in ("state", "action", "distance", "collision", "terminated"):
        assert (
            logs.steps.column(name).combine_chunks().equals(table.column(name).combine_chunks())
        ), name
    assert [Path(file).name for file in logs.episodes.column("file").to_pylist()] == [
        path.name for path in FILES
    ]
    assert logs.episodes.column("length").to_pylist() == [
        len(episode) for episode in open_logs(FILES)
    ]


def test_only_new_files_are_decoded_and_a_deleted_cache_only_costs_time(tmp_path: Path) -> None:
    names = [path.name for path in FILES]
    first, decoded = loaded(FILES[:2], tmp_path / "cache")
    assert decoded == names[:2]
    whole, decoded = loaded(FILES, tmp_path / "cache")
    assert decoded == names[2:]
    again, decoded = loaded(FILES, tmp_path / "cache")
    assert decoded == []
    shutil.rmtree(tmp_path / "cache")
    anew, decoded = loaded(FILES, tmp_path / "cache")
    assert decoded == names
    for logs in (again, anew):
        assert logs.steps.combine_chunks().equals(whole.steps.combine_chunks())
    assert first.steps.combine_chunks().equals(
        whole.steps.slice(0, first.steps.num_rows).combine_chunks()
    )


def test_a_subset_in_another_order_is_read_from_the_same_shards(tmp_path: Path) -> None:
    whole, _ = loaded(FILES, tmp_path)
    some, decoded = loaded([FILES[2], FILES[0]], tmp_path)
    assert decoded == []
    wanted = whole.select([2, 0])
    np.testing.assert_array_equal(
        some.steps.column("terminated"), wanted.steps.column("terminated")
    )
    assert some.steps.column("state").to_pylist() == wanted.steps.column("state").to_pylist()


def test_copies_of_a_file_are_episodes_of_their_own_and_decoded_once(tmp_path: Path) -> None:
    copy = tmp_path / "copy.mcap"
    shutil.copy(FILES[0], copy)
    logs, decoded = loaded([FILES[0], copy], tmp_path / "cache")
    assert len(decoded) == 1
    assert len(logs) == 2
    assert logs.steps.num_rows == 2 * len(open_logs([copy])[0])


def test_broken_files_are_named_and_nothing_left_is_an_error(tmp_path: Path) -> None:
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(FILES[0].read_bytes()[:5000])
    logs, _ = loaded([broken, FILES[0]], tmp_path / "cache")
    assert len(logs) == 1
    assert [item.path for item in logs.skipped] == [broken]
    with pytest.raises(SpecError, match=r"got none in 1 files; .*broken\.mcap: "):
        loaded([broken], tmp_path / "cache")
