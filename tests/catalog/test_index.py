"""A catalogue says what the files say, however it came to be, and is never believed against them."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from coordlog.catalog.index import Catalog
from coordlog.catalog.rows import COLUMNS, KEPT
from coordlog.errors import StorageError
from coordlog.record.pack_writer import PackWriter
from coordlog.record.reader import read_episode
from tests.catalog.logs import write


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("made")
    return [write(folder / f"{number}.mcap", number) for number in range(5)]


@pytest.fixture
def logs(made: list[Path], tmp_path: Path) -> Path:
    folder = tmp_path / "logs"
    (folder / "below").mkdir(parents=True)
    for path in made:
        shutil.copy2(path, folder / ("below" if path.stem == "3" else "") / path.name)
    return folder


def rows(folder: Path) -> pa.Table:
    catalog = Catalog(folder)
    catalog.refresh()
    return catalog.rows()


def test_a_row_says_what_the_file_says(logs: Path) -> None:
    for row in rows(logs).to_pylist():
        path = logs / row["path"]
        episode = read_episode(path)
        assert row["digest"] == hashlib.sha256(path.read_bytes()).hexdigest()
        assert (row["size"], row["mtime"]) == (path.stat().st_size, path.stat().st_mtime_ns)
        assert row["returns"] == list(episode.result.returns)
        for name in ("length", "success", "clean", "terminated", "truncated", "aborted"):
            assert row[name] == getattr(episode.result, name)
        for name in ("run", "scene", "robot", "split", "seed", "index", "start", "start_time"):
            assert row[name] == episode.header.episode[name]
        assert row["collided"] == episode.collision.any()
        assert row["fell"] == episode.instability.any()
        assert row["policy"] == "expert"
    assert rows(logs).num_rows == 5


def test_only_what_is_new_or_changed_is_read(logs: Path, made: list[Path]) -> None:
    change = Catalog(logs).refresh()
    assert (change.new, change.changed, change.gone) == (5, 0, 0)
    change = Catalog(logs).refresh()
    assert (change.new, change.changed, change.gone) == (0, 0, 0)
    assert len(Catalog(logs).parts()) == 1
    (logs / "1.mcap").unlink()
    shutil.copy(made[2], logs / "0.mcap")
    shutil.copy(made[2], logs / "new.mcap")
    change = Catalog(logs).refresh()
    assert (change.new, change.changed, change.gone) == (1, 1, 1)
    found = dict(
        zip(*(rows(logs).column(name).to_pylist() for name in ("path", "seed")), strict=True)
    )
    assert found == {"0.mcap": 2, "2.mcap": 2, "4.mcap": 4, "below/3.mcap": 3, "new.mcap": 2}


class Editing(RuleBasedStateMachine):
    """Files come, go and change in any order: the catalogue that was kept up equals a new one."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = Path(tempfile.mkdtemp())
        self.logs = self.folder / "logs"
        self.logs.mkdir()
        self.clock = 10**18

    @rule(number=st.integers(0, 3), name=st.sampled_from(["a", "b/c", "d"]))
    def put(self, number: int, name: str) -> None:
        source = self.folder / f"{number}.mcap"
        if not source.exists():
            write(source, number)
        target = self.logs / f"{name}.mcap"
        target.parent.mkdir(exist_ok=True)
        shutil.copy(source, target)
        self.clock += 1000
        os.utime(target, ns=(self.clock, self.clock))

    @rule(name=st.sampled_from(["a", "b/c"]))
    def remove(self, name: str) -> None:
        (self.logs / f"{name}.mcap").unlink(missing_ok=True)

    @rule(name=st.sampled_from(["a", "d"]))
    def damage(self, name: str) -> None:
        (self.logs / f"{name}.mcap").write_bytes(b"broken")

    @rule()
    def compact(self) -> None:
        Catalog(self.logs).compact()

    @rule()
    def lose(self) -> None:
        for path in list((self.logs / ".catalog").glob("*"))[:1]:
            path.write_bytes(path.read_bytes()[:-9])

    @invariant()
    def kept_up_equals_new(self) -> None:
        kept = rows(self.logs)
        copy = self.folder / "copy"
        shutil.rmtree(copy, ignore_errors=True)
        shutil.copytree(self.logs, copy, ignore=shutil.ignore_patterns(".catalog"))
        assert kept.to_pylist() == rows(copy).to_pylist()
        again = Catalog(self.logs)
        again.rebuild()
        assert again.rows().to_pylist() == kept.to_pylist()

    def teardown(self) -> None:
        shutil.rmtree(self.folder)


Editing.TestCase.settings = settings(max_examples=6, stateful_step_count=6, deadline=None)
TestEditing = Editing.TestCase


def test_a_broken_file_is_named_and_not_read_again(logs: Path) -> None:
    (logs / "bad.mcap").write_bytes(b"nothing")
    catalog = Catalog(logs)
    assert catalog.refresh().new == 6
    assert [name for name, _ in catalog.broken()] == ["bad.mcap"]
    again = Catalog(logs)
    assert again.refresh().new == 0
    assert again.broken() == catalog.broken()
    assert again.episodes().num_rows == 5


@pytest.mark.parametrize(
    "damage",
    ["cut off", "emptied", "one bit", "of another edition", "path of nulls", "arms of numbers"],
)
def test_a_catalogue_that_cannot_be_used_is_made_anew_and_that_is_said(
    logs: Path, damage: str
) -> None:
    wanted = rows(logs)
    (part,) = (logs / ".catalog").iterdir()
    if damage == "of another edition":
        table = wanted.replace_schema_metadata({"coordlog_catalog": "0"})
        pq.write_table(table, part)
    elif " of " in damage:
        name, values = damage.split(" of ")
        at, odd = wanted.schema.names.index(name), [None if values == "nulls" else 7] * len(wanted)
        pq.write_table(wanted.set_column(at, name, pa.array(odd)), part)
    elif damage == "one bit":
        data = bytearray(part.read_bytes())
        data[data.index(b"table")] ^= 1  # of one file, which DuckDB would read by itself
        part.write_bytes(data)
        assert not isinstance(Catalog(logs).source(), Path)
    else:
        part.write_bytes(part.read_bytes()[: 100 if damage == "cut off" else 0])
    catalog = Catalog(logs)
    change = catalog.refresh()
    assert any("cannot be used and is written anew" in note for note in change.notes)
    assert catalog.rows().equals(wanted)
    assert Catalog(logs).refresh().notes == ()


def test_a_damaged_file_of_a_catalogue_whose_rows_others_have_is_told_of_once(logs: Path) -> None:
    wanted = rows(logs)
    (logs / ".catalog" / "part-000002-00000000.parquet").write_bytes(b"PAR1")
    assert len(Catalog(logs).refresh().notes) == 1
    assert Catalog(logs).refresh().notes == ()
    assert rows(logs).equals(wanted)


def test_compact_keeps_every_row_in_one_file(logs: Path, made: list[Path]) -> None:
    rows(logs)
    shutil.copy(made[1], logs / "0.mcap")
    wanted = rows(logs)
    assert len(Catalog(logs).parts()) == 2
    Catalog(logs).compact()
    assert len(Catalog(logs).parts()) == 1
    assert rows(logs).equals(wanted)


def test_verify_finds_bytes_that_changed_behind_size_and_time(logs: Path) -> None:
    catalog = Catalog(logs)
    catalog.refresh()
    assert catalog.verify() == []
    path = logs / "2.mcap"
    status, data = path.stat(), bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))
    assert Catalog(logs).refresh().changed == 0
    (found,) = Catalog(logs).verify()
    assert found.path == "2.mcap"
    assert found.got == hashlib.sha256(data).hexdigest()


def test_a_pack_has_the_rows_of_its_files(logs: Path, tmp_path: Path) -> None:
    wanted = rows(logs)
    with PackWriter(tmp_path / "PACK") as writer:
        for path in sorted(logs.rglob("*.mcap")):
            writer.append(path.relative_to(logs).as_posix(), path.read_bytes(), mtime=1)
    got = rows(tmp_path / "PACK")
    assert sorted(got.column("digest").to_pylist()) == sorted(wanted.column("digest").to_pylist())
    assert all(path.startswith("shard-000000.tar/") for path in got.column("path").to_pylist())


def test_a_folder_that_cannot_be_written_to_is_described_all_the_same(
    logs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise StorageError("it is read-only")

    catalog = Catalog(logs)
    monkeypatch.setattr(catalog._place, "create", refuse)
    change = catalog.refresh()
    assert change.notes == ("the catalogue is not kept: it is read-only",)
    assert not change.kept
    assert catalog.episodes().num_rows == 5


def test_two_catalogues_that_were_kept_up_at_once_agree(logs: Path, made: list[Path]) -> None:
    first, second = Catalog(logs), Catalog(logs)
    first.rows(), second.rows()
    first.refresh(), second.refresh()
    shutil.copy(made[0], logs / "4.mcap")
    assert rows(logs).num_rows == 5
    fresh = Catalog(logs)
    fresh.rebuild()
    assert fresh.rows().equals(rows(logs))


def test_every_column_that_is_kept_is_offered_or_says_what_is_wrong() -> None:
    assert KEPT.names == [*COLUMNS.names, "error", "gone"]
