"""What a file is that is not ours, told from its first bytes, and which tool takes it.

Sources: the magic numbers that each format's own specification gives; Git LFS pointer files,
git-lfs/docs/spec.md.
"""

from __future__ import annotations

import codecs
import os
import stat

HEAD = 4096
"""Bytes that are enough to know a stranger by."""
PARQUET = b"PAR1"
"""What a Parquet file begins with."""
POINTER = b"version https://git-lfs.github.com/"
"""What a pointer of Git LFS begins with."""

_IMPORT = "`coordlog import` takes it"
_ARRAYS = "read it in Python and give the arrays to coordlog.smooth.smooth"
_MAGIC: tuple[tuple[bytes, str], ...] = (
    (b"\x00\x05\x16\x07", "an AppleDouble file, what macOS keeps beside a file: not data"),
    (
        b"#ROSBAG V",
        "a ROS 1 bag, not an episode: `rosbags-convert` makes a ROS 2 bag of it, which `coordlog "
        "import` takes",
    ),
    (b"SQLite format 3\0", f"an SQLite database, as rosbag2 writes (.db3): {_IMPORT}"),
    (b"\x89HDF\r\n\x1a\n", f"an HDF5 file, not an episode: {_IMPORT}"),
    (PARQUET, f"a Parquet file, not an episode: {_IMPORT}"),
    (b"ARROW1", f"an Arrow file, not an episode: {_ARRAYS}"),
    (b"\x93NUMPY", f"a NumPy array (.npy), not an episode: {_ARRAYS}"),
    (b"\x1f\x8b", "compressed with gzip: unpack it first (gunzip)"),
    (b"\x28\xb5\x2f\xfd", "compressed with zstd: unpack it first (zstd -d)"),
    (b"\xfd7zXZ\0", "compressed with xz: unpack it first (unxz)"),
    (b"BZh", "compressed with bzip2: unpack it first (bunzip2)"),
    (b"\x04\x22\x4d\x18", "compressed with lz4: unpack it first (lz4 -d)"),
    (b"7z\xbc\xaf\x27\x1c", "a 7-Zip archive: unpack it first"),
    (POINTER, "a Git LFS pointer, not the file: run `git lfs pull`"),
    (b"RRF", "a rerun recording (.rrd), not an episode: open it with `rerun`"),
    (b"\x89PNG", "a PNG picture, not an episode"),
    (b"%PDF", "a PDF document, not an episode"),
)
_MCAP = b"\x89MCAP"
_TAR = (257, b"ustar")
_MP4 = (4, b"ftyp")
SUFFIXES = {
    ".bag": "ROS 1 bags",
    ".db3": "rosbag2 databases",
    ".h5": "HDF5 files",
    ".hdf5": "HDF5 files",
    ".parquet": "Parquet files",
    ".csv": "CSV tables",
}
"""Logs of other programs that `coordlog import` takes, by the ends of their names."""


def recognise(head: bytes | memoryview, *, texts: bool = True) -> str:
    """What these first bytes of a file are the start of, and what to do; "" if unknown.

    Args:
        head: The first HEAD bytes, or all of a smaller file.
        texts: Whether a text without a mark of its own (JSON, CSV, plain) is named too.

    Example:
        >>> recognise(b"PAR1")
        'a Parquet file, not an episode: `coordlog import` takes it'
    """
    head = bytes(head[:HEAD])
    for magic, sentence in _MAGIC:
        if head.startswith(magic):
            return sentence
    if head.startswith(_MCAP):
        ours = b"coordlog" in head
        return "a recorded episode (MCAP): `coordlog info` describes it" if ours else "an MCAP file"
    if head.startswith(b"PK\x03\x04"):
        return _archive(head)
    if head[_TAR[0] :].startswith(_TAR[1]):
        return "a tar archive: unpack it first (tar -xf)"
    if head[_MP4[0] :].startswith(_MP4[1]):
        return "a video (MP4), not an episode"
    if head[8:9] == b"{" and int.from_bytes(head[:8], "little") < 1 << 27:
        return "a safetensors file, as policies are: `coordlog record --policy` takes those"
    if head and not head.strip(b"\0"):
        return "nothing but zeros at its start: a download or a copy that did not finish?"
    return _text(head, plain=texts)


def what_is(path: str | os.PathLike[str], *, texts: bool = True) -> str:
    """What a file of this machine is, as `recognise` says; "" if it is unknown, or cannot be read.

    Args:
        path: Any path; of a pipe or a device nothing is read.
        texts: As `recognise` takes it.
    """
    try:
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    except (OSError, ValueError):
        return ""
    try:
        mode = os.fstat(fd).st_mode
        if stat.S_ISDIR(mode):
            return "a folder"
        if not stat.S_ISREG(mode):
            return "a pipe, a socket or a device"
        head = os.read(fd, HEAD)
    except OSError:
        return ""
    finally:
        os.close(fd)
    return recognise(head, texts=texts) if head else "an empty file (0 bytes)"


def _archive(head: bytes) -> str:
    """A zip archive, known by the name of its first member."""
    size = int.from_bytes(head[26:28], "little")
    name = head[30 : 30 + size].decode("utf-8", "replace")
    if name == "data":
        return "a model of stable-baselines3 (zip), not a file of coordlog; load it there"
    if name.endswith(".npy"):
        return f"a NumPy archive (.npz), not an episode: {_ARRAYS}"
    if name.endswith("data.pkl"):
        return "a PyTorch file (pickle), which is never opened: what somebody sent could run code"
    return "a zip archive: unpack it first (unzip)"


def _text(head: bytes, *, plain: bool) -> str:
    """A text of a known kind; `plain`, of one without a mark of its own too."""
    try:
        text = codecs.getincrementaldecoder("utf-8-sig")().decode(head)  # a cut letter is none
    except UnicodeDecodeError:
        return ""
    start = text.lstrip()[:200].lower()
    if start.startswith(("<!doctype html", "<html")):
        return "a web page (HTML), not the file: the download was answered with a page"
    if start.startswith(("<mujoco", "<?xml", "<robot")):
        return "an XML document, not an episode: robots and scenes go to `coordlog robot`"
    if not plain:
        return ""
    if start.startswith(("{", "[")):
        return "a JSON text, not an episode"
    lines = text.splitlines()[:3]
    commas = {line.count(",") for line in lines}
    if len(lines) > 1 and len(commas) == 1 and commas.pop() > 0:
        return f"a CSV table, not an episode: {_IMPORT}"
    return "a text, not an episode" if text.isprintable() or "\n" in text else ""
