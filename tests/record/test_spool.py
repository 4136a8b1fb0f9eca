"""What was recorded gets into the store, also what a crash had left; what is being written stays."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from coordlog.errors import StorageError
from coordlog.record.spool import Spool
from coordlog.record.store import PackStore

FILES = sorted((Path(__file__).parents[1] / "data" / "v1" / "table").glob("*.mcap"))


def names(store: PackStore) -> list[str]:
    return [Path(entry.name).name for entry in store.list()]


def test_a_finished_file_moves_into_the_store(tmp_path: Path) -> None:
    with Spool(PackStore(tmp_path / "PACK")) as spool:
        path = Path(shutil.copy(FILES[0], spool.folder))
        assert spool.publish(path).name == FILES[0].name
        assert not path.exists()
    assert names(PackStore(tmp_path / "PACK")) == [FILES[0].name]
    assert list((tmp_path / "PACK" / ".spool").iterdir()) == []


def test_what_a_crash_left_is_published_once_and_parts_are_named(tmp_path: Path) -> None:
    left = tmp_path / "PACK" / ".spool" / "dead"
    left.mkdir(parents=True)
    shutil.copy(FILES[0], left)
    (left / "b.mcap.part").write_bytes(b"half")
    with Spool(PackStore(tmp_path / "PACK")) as spool:
        assert [path.name for path in spool.published] == [FILES[0].name]
        assert spool.unfinished == [left / "b.mcap.part"]
    with Spool(PackStore(tmp_path / "PACK")) as spool:
        assert spool.published == []
        assert spool.unfinished == [left / "b.mcap.part"]
    assert names(PackStore(tmp_path / "PACK")) == [FILES[0].name]


def test_what_another_recording_is_writing_is_left_alone(tmp_path: Path) -> None:
    with Spool(PackStore(tmp_path / "PACK")) as first:
        shutil.copy(FILES[0], first.folder)
        with Spool(PackStore(tmp_path / "PACK")) as second:
            assert second.published == []
            shutil.copy(FILES[1], second.folder)
            second.publish(second.folder / FILES[1].name)
        first.publish(first.folder / FILES[0].name)
    assert sorted(names(PackStore(tmp_path / "PACK"))) == [path.name for path in FILES[:2]]


def test_the_same_bytes_twice_are_one_episode_and_others_are_refused(tmp_path: Path) -> None:
    with Spool(PackStore(tmp_path / "PACK")) as spool:
        for _ in range(2):
            spool.publish(Path(shutil.copy(FILES[0], spool.folder)))
        other = Path(shutil.copy(FILES[1], spool.folder / FILES[0].name))
        with pytest.raises(StorageError, match="replaces none"):
            spool.publish(other)
        assert other.exists()
    assert names(PackStore(tmp_path / "PACK")) == [FILES[0].name]
