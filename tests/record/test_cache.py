"""Tests for the cache of decoded columns: it never changes what is read, and nothing is decoded
twice."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from coordlog.errors import SpecError
from coordlog.record import cache
from coordlog.record.cache import EPISODES, STEPS, SUMS, Built, Logs, load
from coordlog.record.dataset import open as open_logs
from coordlog.record.digests import DIGESTS

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
    logs, _ = loaded([FILES[0], copy], tmp_path / "cache")
    stored = [
        pa.ipc.open_file(path).read_all() for path in (tmp_path / "cache").glob(f"*{EPISODES}")
    ]
    assert sum(table.num_rows for table in stored) == 1
    assert len(logs) == 2
    assert logs.episodes.column("file").to_pylist() == [str(FILES[0]), str(copy)]
    assert logs.steps.num_rows == 2 * len(open_logs([copy])[0])


def test_broken_files_are_named_and_nothing_left_is_an_error(tmp_path: Path) -> None:
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(FILES[0].read_bytes()[:5000])
    logs, _ = loaded([broken, FILES[0]], tmp_path / "cache")
    assert len(logs) == 1
    assert [item.path for item in logs.skipped] == [broken]
    with pytest.raises(SpecError, match=r"got none in 1 files; .*broken\.mcap: "):
        loaded([broken], tmp_path / "cache")


def copies(folder: Path) -> list[Path]:
    """Two of the files, old enough for their digests to be remembered."""
    folder.mkdir()
    made = []
    for path in FILES[:2]:
        made.append(Path(shutil.copy(path, folder)))
        os.utime(made[-1], (1_700_000_000, 1_700_000_000))
    return made


def test_a_warm_cache_reads_no_byte_of_a_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    logs = copies(tmp_path / "logs")
    first, decoded = loaded(logs, tmp_path / "cache")
    assert len(decoded) == 2
    for path in logs:
        path.chmod(0)  # root may read them all the same, so nothing may even try
    monkeypatch.setattr(cache, "decoded", None)
    again, decoded = loaded(logs, tmp_path / "cache")
    assert decoded == []
    assert again.steps.combine_chunks().equals(first.steps.combine_chunks())


def test_cold_each_file_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    logs, opened = copies(tmp_path / "logs"), []
    real = os.open

    def counted(path: object, *args: int, **kwargs: int) -> int:
        opened.append(str(path))
        return real(path, *args, **kwargs)  # type: ignore[arg-type]

    monkeypatch.setattr(os, "open", counted)
    loaded(logs, tmp_path / "cache")
    assert sorted(path for path in opened if path.endswith(".mcap")) == [str(path) for path in logs]


def test_a_changed_file_is_read_again_and_verify_reads_every_one(tmp_path: Path) -> None:
    logs = copies(tmp_path / "logs")
    loaded(logs, tmp_path / "cache")
    shutil.copy(FILES[2], logs[0])
    changed, decoded = loaded(logs, tmp_path / "cache")
    assert decoded == [logs[0].name]
    assert changed.steps.num_rows == sum(len(episode) for episode in open_logs(logs))
    decoding = Decoding()
    load(logs, tmp_path / "cache", run=decoding, verify=True)
    assert len(decoding.files) == 2


@pytest.mark.parametrize("kind", [STEPS, EPISODES, SUMS, DIGESTS])
@pytest.mark.parametrize("harm", ["flip", "empty", "cut", "junk"])
def test_a_damaged_cache_is_made_anew_and_never_learnt_from(
    tmp_path: Path, kind: str, harm: str
) -> None:
    logs = copies(tmp_path / "logs")
    good, _ = loaded(logs, tmp_path / "cache")
    wanted = good.steps.to_pydict()
    good_episodes = good.episodes.to_pylist()
    del good
    for path in (tmp_path / "cache").glob(f"*{kind}"):
        data = bytearray(path.read_bytes())
        data[len(data) // 2] ^= 4
        harmed = {"flip": data, "empty": b"", "cut": data[: len(data) // 2], "junk": b"junk" * 99}
        path.write_bytes(harmed[harm])
    for _ in range(2):
        again, _ = loaded(logs, tmp_path / "cache")
        assert again.steps.to_pydict() == wanted
        assert again.episodes.to_pylist() == good_episodes


@pytest.mark.parametrize("mode", [0o770, 0o777])
def test_a_folder_that_others_may_write_to_is_not_used(tmp_path: Path, mode: int) -> None:
    folder = tmp_path / "cache"
    folder.mkdir()
    folder.chmod(mode)
    logs, decoded = loaded(FILES[:1], folder)
    assert len(decoded) == len(logs) == 1
    assert "others may write to it" in logs.notes[0]
    assert list(folder.iterdir()) == []
    assert np.isfinite(np.asarray(logs.steps.column("distance").combine_chunks().flatten())).all()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a folder away")
def test_a_folder_of_another_user_is_not_used(tmp_path: Path) -> None:
    folder = tmp_path / "cache"
    folder.mkdir(mode=0o700)
    os.chown(folder, 65534, 65534)
    logs, _ = loaded(FILES[:1], folder)
    assert "belongs to another user" in logs.notes[0]
    assert list(folder.iterdir()) == []
