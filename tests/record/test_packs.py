"""A pack gives back the same bytes, however it is cut off, and any tar program opens it."""

from __future__ import annotations

import hashlib
import subprocess
import tarfile
import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coordlog.errors import FormatError, StorageError
from coordlog.record.pack_writer import PackWriter
from coordlog.record.packs import Member, Pack, decode_index, encode_index, members_of
from coordlog.record.places import Folder

NAMES = st.text(
    st.characters(blacklist_categories=["Cs", "Cc"], blacklist_characters="/"), min_size=1
)
FILES = st.dictionaries(
    st.lists(NAMES, min_size=1, max_size=3).map("/".join).filter(lambda name: ".." not in name),
    st.binary(max_size=2000),
    max_size=6,
)
TIME = 1_700_000_000


def packed(folder: Path, files: dict[str, bytes], *, shard_bytes: int = 4000) -> Pack:
    with PackWriter(folder, shard_bytes=shard_bytes) as writer:
        for name, data in files.items():
            writer.append(name, data, mtime=TIME)
    return Pack(Folder(folder))


def unpacked(pack: Pack) -> dict[str, bytes]:
    return {member.name: pack.read(shard, member.name) for shard, member in members_of(pack)}


@settings(max_examples=25)
@given(FILES)
def test_what_goes_in_comes_out(files: dict[str, bytes]) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        pack = packed(folder, files)
        assert unpacked(pack) == files
        for shard in pack.shards():
            with tarfile.open(folder / shard.name) as archive:
                for info in archive:
                    stream = archive.extractfile(info)
                    assert stream is not None
                    assert stream.read() == files[info.name]


@settings(max_examples=25)
@given(FILES)
def test_a_shard_without_its_index_has_the_same_members(files: dict[str, bytes]) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        wanted = unpacked(packed(folder, files))
        for index in folder.glob("*.index"):
            index.unlink()
        pack = Pack(Folder(folder))
        assert unpacked(pack) == wanted
        assert all(pack.index(shard.name).lost == 0 for shard in pack.shards())


def test_a_shard_cut_off_anywhere_loses_at_most_the_last_member(tmp_path: Path) -> None:
    files = {f"{'long/' * 30}{i}.mcap": bytes([i + 1]) * (700 * i + 1) for i in range(4)}
    pack = packed(tmp_path / "whole", files, shard_bytes=10**9)
    data = (tmp_path / "whole" / "shard-000000.tar").read_bytes()
    ends = [member.start + member.size for _, member in members_of(pack)]
    for cut in range(0, len(data), 97):
        folder = tmp_path / str(cut)
        folder.mkdir()
        (folder / "shard-000000.tar").write_bytes(data[:cut])
        short = Pack(Folder(folder))
        complete = sum(-(-end // 512) * 512 <= cut for end in ends)
        assert unpacked(short) == dict(list(files.items())[:complete])
        begun = -(-ends[complete - 1] // 512) * 512 if complete else 0
        lost = short.index("shard-000000.tar").lost
        assert lost == (cut - begun if any(data[begun:cut]) else 0)


def test_a_writer_goes_on_in_a_shard_of_its_own(tmp_path: Path) -> None:
    stopped = PackWriter(tmp_path)
    stopped.append("a", b"1" * 600, mtime=TIME)  # and never closed
    packed(tmp_path, {"b": b"2"})
    assert unpacked(Pack(Folder(tmp_path))) == {"a": b"1" * 600, "b": b"2"}
    assert [entry.name for entry in Pack(Folder(tmp_path)).shards()] == [
        "shard-000000.tar",
        "shard-000001.tar",
    ]
    stopped.close()


def test_nothing_is_replaced(tmp_path: Path) -> None:
    packed(tmp_path, {"a": b"1"})
    with pytest.raises(StorageError, match="has a member a and replaces none"):
        packed(tmp_path, {"a": b"2"})
    assert unpacked(Pack(Folder(tmp_path))) == {"a": b"1"}


def test_the_same_files_give_the_same_pack(tmp_path: Path) -> None:
    files = {"a": b"1" * 5000, "b": b"2"}
    packed(tmp_path / "one", files)
    packed(tmp_path / "two", files)
    names = sorted(path.name for path in (tmp_path / "one").iterdir())
    assert names == sorted(path.name for path in (tmp_path / "two").iterdir())
    for name in names:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def test_one_read_gets_one_member(tmp_path: Path) -> None:
    reads = []

    class Counting(Folder):
        def read(self, name: str, start: int = 0, size: int | None = None) -> bytes:
            reads.append((name, size))
            return super().read(name, start, size)

    packed(tmp_path, {str(i): bytes(100 + i) for i in range(20)}, shard_bytes=10**9)
    pack = Pack(Counting(tmp_path))
    pack.read("shard-000000.tar", "3")
    pack.read("shard-000000.tar", "17")
    assert [size for name, size in reads if name.endswith(".tar")] == [103, 117]


def test_tar_itself_opens_a_shard(tmp_path: Path) -> None:
    packed(tmp_path / "pack", {"x/ä.mcap": b"12345"})
    done = subprocess.run(
        ["tar", "xf", tmp_path / "pack" / "shard-000000.tar", "-C", tmp_path],
        capture_output=True,
        check=True,
    )
    assert done.stderr == b""
    assert (tmp_path / "x" / "ä.mcap").read_bytes() == b"12345"


def test_a_damaged_index_is_refused_and_can_be_done_without(tmp_path: Path) -> None:
    packed(tmp_path, {"a": b"12345"})
    index = tmp_path / "shard-000000.index"
    whole = index.read_bytes()
    for cut in range(len(whole)):
        index.write_bytes(whole[:cut])
        with pytest.raises(FormatError, match="the index is damaged; delete it"):
            decode_index(whole[:cut], "it")
    with pytest.raises(FormatError, match=r"shard-000000\.index: the index is damaged"):
        unpacked(Pack(Folder(tmp_path)))
    index.unlink()
    assert unpacked(Pack(Folder(tmp_path))) == {"a": b"12345"}


def test_what_is_no_tar_archive_is_refused(tmp_path: Path) -> None:
    (tmp_path / "shard-000000.tar").write_bytes(b"not tar " * 100)
    with pytest.raises(FormatError, match="expected a tar archive"):
        Pack(Folder(tmp_path)).index("shard-000000.tar")


def test_an_index_is_read_as_written() -> None:
    members = [Member(512, 3, "ab" * 32, TIME, "a b\u2028c"), Member(2048, 0, "cd" * 32, 0, "d")]
    assert decode_index(encode_index(members), "").members == tuple(members)


def test_names_that_no_index_could_hold_are_refused(tmp_path: Path) -> None:
    with PackWriter(tmp_path) as writer:
        for name in ("a\nb", "/a"):
            with pytest.raises(StorageError, match="relative and of one line"):
                writer.append(name, b"", mtime=0)


@pytest.mark.parametrize(
    "line",
    [b"a b c d e\n", b"1 2\n", b"-5 9 x 0 a\n", b"inf nan x y a\n", b"9" * 5000 + b" 5 x 0 a\n"],
)
def test_an_index_that_says_nonsense_under_a_right_seal_is_refused(line: bytes) -> None:
    seal = f"sha256 {hashlib.sha256(line).hexdigest()}\n".encode()
    with pytest.raises(FormatError, match="it: expected lines of start, size"):
        decode_index(line + seal, "it")


def test_an_index_of_more_than_its_shard_holds_is_refused(tmp_path: Path) -> None:
    with PackWriter(tmp_path) as writer:
        writer.append("a", b"12345", mtime=0)
    member = Member(512, 1 << 40, "ab" * 32, TIME, "a")
    (tmp_path / "shard-000000.index").write_bytes(encode_index([member]))
    with pytest.raises(FormatError, match="beyond the shard's end"):
        Pack(Folder(tmp_path)).index("shard-000000.tar")
