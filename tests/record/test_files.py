"""Tests for files.py: every real file once, and nothing passed over in silence."""

from __future__ import annotations

import os
import shutil
import socket
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from coordlog.errors import FormatError, StorageError
from coordlog.record.files import Files, find_files, nothing_found, recovered_before
from coordlog.verify.repair import recover


def names(files: Files) -> list[str]:
    return [path.name for path in files.paths]


def reasons(files: Files) -> dict[str, str]:
    return {path.name: reason for path, reason in files.skipped}


@pytest.fixture
def shared() -> Iterator[Path]:
    """A folder that every user may look into, as those of `tmp_path` may not."""
    folder = Path(tempfile.mkdtemp())
    folder.chmod(0o755)
    yield folder
    shutil.rmtree(folder)


@contextmanager
def unprivileged() -> Iterator[None]:
    """Act as somebody who may not read everything."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


def test_links_are_followed_and_each_file_comes_once_by_its_own_name(tmp_path: Path) -> None:
    logs, apart = tmp_path / "logs", tmp_path / "apart"
    for folder in (logs / "z", apart):
        folder.mkdir(parents=True)
    (logs / "z" / "own.mcap").write_bytes(b"1")
    (apart / "linked.mcap").write_bytes(b"2")
    (logs / "a-link.mcap").symlink_to(logs / "z" / "own.mcap")
    (logs / "b-link").symlink_to(apart)
    (logs / "c-link").symlink_to(logs)  # a circle
    os.link(logs / "z" / "own.mcap", logs / "zz-hard.mcap")
    found = find_files(logs)
    assert len(found.paths) == 2
    assert found.skipped == ()
    assert {path.resolve().parent.name for path in found.paths} <= {"z", "logs", "apart"}
    assert not found.paths[-1].is_symlink()
    twice = find_files([logs, logs / "z" / "own.mcap", str(logs), apart])
    assert twice.paths == found.paths


def test_what_is_named_is_taken_whatever_it_is_called(tmp_path: Path) -> None:
    (tmp_path / "episode.bin").write_bytes(b"1")
    assert names(find_files(tmp_path / "episode.bin")) == ["episode.bin"]
    assert find_files(tmp_path).paths == ()


def test_hidden_files_are_files_and_those_of_macos_are_none(tmp_path: Path) -> None:
    (tmp_path / ".hidden").mkdir()
    (tmp_path / ".hidden" / ".a.mcap").write_bytes(b"1")
    (tmp_path / "._b.mcap").write_bytes(b"\x00\x05\x16\x07" + bytes(4092))
    (tmp_path / "._c.mcap").write_bytes(b"\x89MCAP0\r\n")  # only called like one
    (tmp_path / ".catalog").mkdir()
    (tmp_path / ".catalog" / "part-000001-00000000.parquet").write_bytes(b"PAR1")
    found = find_files(tmp_path)
    assert found.others == ()  # our own catalogue is nothing to import
    assert names(found) == ["._c.mcap", ".a.mcap"]
    assert "AppleDouble" in reasons(found)["._b.mcap"]


def test_pipes_sockets_and_devices_are_named_and_never_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.mcap")
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "socket.mcap"))
    (tmp_path / "device.mcap").symlink_to("/dev/null")
    (tmp_path / "folder.mcap").mkdir()
    (tmp_path / "folder.mcap" / "a.mcap").write_bytes(b"1")
    found = find_files(tmp_path)
    assert names(found) == ["a.mcap"]
    assert reasons(found) == {
        "pipe.mcap": "expected a file, got a pipe (FIFO)",
        "socket.mcap": "expected a file, got a socket",
        "device.mcap": "expected a file, got a device",
    }
    for name, kind in (("pipe.mcap", "a pipe"), ("device.mcap", "a device")):
        with pytest.raises(FormatError, match=f"expected a file or a folder, got {kind}"):
            find_files(tmp_path / name)


def test_a_link_to_nothing_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"1")
    for name in ("gone.mcap", "gone-folder", "gone.txt"):
        (tmp_path / name).symlink_to(tmp_path / "nowhere")
    (tmp_path / "self.mcap").symlink_to(tmp_path / "self.mcap")
    found = find_files(tmp_path)
    assert names(found) == ["a.mcap"]
    assert set(reasons(found)) == {"gone.mcap", "gone-folder", "self.mcap"}
    with pytest.raises(StorageError, match=r"gone\.mcap: cannot read: a link to nothing"):
        find_files(tmp_path / "gone.mcap")
    several = find_files([tmp_path / "gone.mcap", tmp_path / "a.mcap"])
    assert (names(several), set(reasons(several))) == (["a.mcap"], {"gone.mcap"})


def test_what_may_not_be_read_is_named(shared: Path) -> None:
    (shared / "private").mkdir(mode=0o700)
    for name in ("a.mcap", "private/b.mcap", "secret.mcap"):
        (shared / name).write_bytes(b"1")
    (shared / "secret.mcap").chmod(0o600)
    if os.geteuid() != 0:
        (shared / "secret.mcap").chmod(0)
        (shared / "private").chmod(0)
    with unprivileged():
        found = find_files(shared)
        for path in (shared / "private", shared / "private" / "b.mcap"):
            with pytest.raises(StorageError, match="cannot read: Permission denied"):
                find_files(path)
    (shared / "private").chmod(0o700)
    assert names(found) == ["a.mcap"]
    assert reasons(found) == dict.fromkeys(
        ("private", "secret.mcap"), "cannot read: Permission denied"
    )


@pytest.mark.parametrize("name", ["nowhere", "a\0b", "x" * 5000])
def test_a_path_that_cannot_be_is_one_sentence(tmp_path: Path, name: str) -> None:
    with pytest.raises(StorageError):
        find_files(tmp_path / name)
    (tmp_path / "a.mcap").write_bytes(b"1")
    if name == "nowhere":
        with pytest.raises(StorageError):
            find_files([tmp_path / "a.mcap", tmp_path / name])


def test_nothing_found_says_what_is_there_instead(tmp_path: Path) -> None:
    for name in ("a.db3", "b.bag", "c.BAG", "d.mcap.part", "e.txt"):
        (tmp_path / name).write_bytes(b"1")
    (tmp_path / "f.mcap").symlink_to("/nowhere")
    said = str(nothing_found([tmp_path], find_files(tmp_path)))
    assert said.startswith(f"no episodes (.mcap) under {tmp_path}; 1 unfinished ones are there")
    assert "1 rosbag2 databases are there: `coordlog import`" in said
    assert "2 ROS 1 bags" in said
    assert "f.mcap: cannot read: a link to nothing" in said


def test_a_recovered_part_is_not_unfinished_for_ever(file: Path, tmp_path: Path) -> None:
    part = tmp_path / "b.mcap.part"
    part.write_bytes(file.read_bytes()[:-100])
    assert find_files(tmp_path).parts == (part,)
    made = recover(part)
    assert recovered_before(part) == made.path
    assert find_files(tmp_path).parts == ()
    made.path.write_bytes(b"another file")
    assert find_files(tmp_path).parts == (part,)
