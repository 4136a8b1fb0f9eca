import errno
import os

import pytest

from coordlog.errors import StorageError
from coordlog.record.storage import PartFile, move_new


def test_a_file_appears_under_its_name_only_when_published(tmp_path):
    file = PartFile(tmp_path / "a.mcap")
    file.append(b"one ")
    assert os.listdir(tmp_path) == ["a.mcap.part"]
    file.append(b"two")
    file.publish()
    assert os.listdir(tmp_path) == ["a.mcap"]
    assert (tmp_path / "a.mcap").read_bytes() == b"one two"
    file.close()


@pytest.mark.parametrize("code", [errno.EPERM, errno.ENOTSUP])
def test_without_hard_links_a_name_is_reserved_first(tmp_path, monkeypatch, code):
    def refuse(*_):
        raise OSError(code, "no hard links here")

    monkeypatch.setattr(os, "link", refuse)
    (tmp_path / "a").write_bytes(b"content")
    move_new(tmp_path / "a", tmp_path / "b")
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"b": b"content"}
    (tmp_path / "a").write_bytes(b"more")
    with pytest.raises(FileExistsError):
        move_new(tmp_path / "a", tmp_path / "b")
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {
        "a": b"more",
        "b": b"content",
    }


def test_short_writes_are_continued(tmp_path, monkeypatch):
    true = os.write
    monkeypatch.setattr(os, "write", lambda fd, data: true(fd, data[:3]))
    file = PartFile(tmp_path / "a")
    file.append(b"abcdefgh")
    file.publish()
    assert (tmp_path / "a").read_bytes() == b"abcdefgh"


def test_a_refused_write_closes_the_file_and_names_the_part(tmp_path, monkeypatch):
    file = PartFile(tmp_path / "a.mcap")
    file.append(b"kept")
    descriptors = len(os.listdir("/proc/self/fd"))

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "write", full)
    wanted = r"a\.mcap: cannot write: No space left on device; what was recorded stays in .*a\.mcap\.part: `coordlog recover` reads it"
    with pytest.raises(StorageError, match=wanted):
        file.append(b"lost")
    assert len(os.listdir("/proc/self/fd")) == descriptors - 1
    assert (tmp_path / "a.mcap.part").read_bytes() == b"kept"
    assert os.listdir(tmp_path) == ["a.mcap.part"]


def test_a_folder_that_is_missing_is_said(tmp_path):
    with pytest.raises(
        StorageError,
        match="cannot create the file: No such file or directory; does the folder exist",
    ):
        PartFile(tmp_path / "nowhere" / "a.mcap")
