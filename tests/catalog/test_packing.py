"""Packing and unpacking gives the same bytes for any set of files."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coordlog.catalog.packing import pack_files, unpack_files
from coordlog.errors import StorageError
from coordlog.record.addresses import name_within
from coordlog.record.files import find_files

NAMES = st.from_regex(r"[a-c]{1,2}(/[a-c]{1,2}){0,2}\.mcap", fullmatch=True)


def named(folder: Path) -> list[tuple[Path, str]]:
    return [(path, name_within(path, folder, several=False)) for path in find_files(folder).paths]


def write(folder: Path, files: dict[str, bytes]) -> None:
    folder.mkdir(exist_ok=True)
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)


@settings(max_examples=10)
@given(st.dictionaries(NAMES, st.binary(max_size=3000), min_size=1, max_size=8))
def test_unpack_after_pack_is_the_identity(files: dict[str, bytes]) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write(folder / "logs", files)
        done = pack_files(named(folder / "logs"), folder / "PACK", shard_bytes=2000)
        assert (done.files, done.size) == (len(files), sum(map(len, files.values())))
        again = pack_files(named(folder / "logs"), folder / "PACK", shard_bytes=2000)
        assert (again.files, again.there) == (0, len(files))
        unpack_files(named(folder / "PACK"), folder / "back")
        found = {
            path.relative_to(folder / "back").as_posix(): path.read_bytes()
            for path in (folder / "back").rglob("*.mcap")
        }
        assert found == files


def test_what_was_stopped_goes_on(tmp_path: Path) -> None:
    files = {f"{i}.mcap": bytes([i]) * 100 for i in range(6)}
    write(tmp_path / "logs", files)
    asked = iter([False, False, True])
    first = pack_files(named(tmp_path / "logs"), tmp_path / "PACK", stop=lambda: next(asked))
    assert first.files == 2
    rest = pack_files(named(tmp_path / "logs"), tmp_path / "PACK")
    assert (rest.files, rest.there) == (4, 2)
    assert {path.name for path in find_files(tmp_path / "PACK").paths} == set(files)


def test_other_bytes_under_a_name_are_refused_both_ways(tmp_path: Path) -> None:
    write(tmp_path / "logs", {"a.mcap": b"1"})
    pack_files(named(tmp_path / "logs"), tmp_path / "PACK")
    (tmp_path / "logs" / "a.mcap").write_bytes(b"2")
    with pytest.raises(StorageError, match="replaces none"):
        pack_files(named(tmp_path / "logs"), tmp_path / "PACK")
    with pytest.raises(StorageError, match="not overwritten"):
        unpack_files(named(tmp_path / "PACK"), tmp_path / "logs")
    assert (tmp_path / "logs" / "a.mcap").read_bytes() == b"2"


@pytest.mark.parametrize("name", ["../a.mcap", "/a.mcap", "x/../../a.mcap"])
def test_a_name_that_leads_out_is_refused(name: str, tmp_path: Path) -> None:
    write(tmp_path / "logs", {"a.mcap": b"1"})
    with pytest.raises(StorageError, match="leads out of the folder"):
        unpack_files([(tmp_path / "logs" / "a.mcap", name)], tmp_path / "back")


def test_two_files_of_one_name_are_refused(tmp_path: Path) -> None:
    write(tmp_path, {"x/a.mcap": b"1", "y/a.mcap": b"2"})
    files = [(path, "a.mcap") for path in find_files(tmp_path).paths]
    with pytest.raises(StorageError, match=r"would both become a\.mcap"):
        pack_files(files, tmp_path / "PACK")


def test_a_name_that_no_pack_holds_is_left_out_and_named(tmp_path: Path) -> None:
    write(tmp_path / "logs", {"a.mcap": b"1", "b\n.mcap": b"2"})
    done = pack_files(named(tmp_path / "logs"), tmp_path / "PACK")
    assert (done.files, len(done.left_out)) == (1, 1)
    assert "one line" in done.left_out[0]
    assert [path.name for path in find_files(tmp_path / "PACK").paths] == ["a.mcap"]
    (tmp_path / "logs" / "a.mcap").unlink()
    with pytest.raises(StorageError, match="nothing to pack"):
        pack_files(named(tmp_path / "logs"), tmp_path / "NONE")
    assert not (tmp_path / "NONE").exists()
