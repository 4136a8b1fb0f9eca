"""Which kind of file a source is, and its joint motion."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from coordlog.errors import ConfigError, FormatError, StorageError
from coordlog.exchange.motion import Motion

PACKED = (".zstd", ".zst", ".gz", ".xz", ".bz2", ".zip", ".tar", ".tgz", ".7z")


@dataclass(frozen=True)
class Reading:
    """How to read a source: what its files do not say of themselves.

    Example:
        `Reading(topic="/arm/joint_states", stamps="log")`
    """

    topic: str = ""
    stamps: str = ""
    state: str = ""
    action: str = ""
    columns: tuple[str, ...] = ()
    clock: str = ""
    names: tuple[str, ...] = ()
    names_field: str = ""
    position_field: str = ""
    rate: float = 0.0
    degrees: bool = False


def motions(path: Path, reading: Reading) -> Iterator[Motion]:
    """The joint motion in a file or folder, an episode of the source at a time.

    Raises:
        StorageError: if the path does not exist.
        FormatError: if it is no source that can be read.
        ConfigError: if something must be said that is not.
    """
    kind = kind_of(path)
    try:
        yield from _read(path, kind, reading)
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"{path}: needs {error.name}: pip install 'coordlog[exchange]'"
        ) from error


def kind_of(path: Path) -> str:
    """What kind of source lies there.

    Raises:
        StorageError: if the path does not exist.
        FormatError: if it is none of them.
    """
    if not path.exists():
        raise StorageError(f"{path}: no such file or folder")
    if path.is_dir():
        for marker, kind in (
            ("metadata.yaml", "rosbag2"),
            ("meta/info.json", "lerobot"),
            ("data/metadata.json", "minari"),
        ):
            if (path / marker).is_file():
                return kind
        inside = {file.suffix for file in path.iterdir()}
        if inside & {".mcap", ".db3"}:
            raise FormatError(
                f"{path}: a bag without its metadata.yaml: give its .mcap or .db3 file itself, or "
                "`ros2 bag reindex` the folder"
            )
        if ".bag" in inside:
            raise FormatError(f"{path}: ROS 1 bags: `rosbags-convert` makes ROS 2 bags of them")
        if inside & {".parquet", ".csv", ".tsv"}:
            raise FormatError(f"{path}: a folder of tables: give its files themselves")
        raise FormatError(
            f"{path}: expected a folder with metadata.yaml (ROS 2 bag), meta/info.json (LeRobot) "
            "or data/metadata.json (Minari), got none of them"
        )
    if not path.is_file():
        raise FormatError(f"{path}: expected a file or a folder, got a pipe, a socket or a device")
    suffixes = {
        ".db3": "rosbag2",
        ".hdf5": "robomimic",
        ".h5": "robomimic",
        ".parquet": "parquet",
        ".csv": "csv",
        ".tsv": "csv",
    }
    suffix = path.suffix.lower()
    if suffix == ".mcap":
        from coordlog.exchange.mcap_source import is_ros2

        return "rosbag2" if is_ros2(path) else "mcap"
    if suffix == ".bag":
        raise FormatError(f"{path}: a ROS 1 bag: `rosbags-convert` makes a ROS 2 bag of it")
    if suffix in PACKED:
        raise FormatError(
            f"{path}: a compressed file or an archive: unpack it first; of a bag, give the folder, "
            "whose metadata.yaml says how"
        )
    if suffix not in suffixes:
        raise FormatError(
            f"{path}: expected .mcap, .db3, .hdf5, .parquet, .csv or the folder of a bag or data "
            f"set, got '{path.suffix}'"
        )
    return suffixes[suffix]


def digest_of(path: Path) -> str:
    """sha256 of a file; of a folder, over the names and digests of its files, videos included."""
    if path.is_file():
        return _file_digest(path)
    whole = hashlib.sha256()
    for file in sorted(each for each in path.rglob("*") if each.is_file()):
        whole.update(f"{file.relative_to(path).as_posix()}\0{_file_digest(file)}\n".encode())
    return whole.hexdigest()


def _file_digest(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _read(path: Path, kind: str, reading: Reading) -> Iterator[Motion]:
    if kind == "rosbag2":
        from coordlog.exchange import rosbag2_source

        return rosbag2_source.motions(path, topic=reading.topic, stamps=reading.stamps)
    if kind == "mcap":
        from coordlog.exchange import mcap_source

        return mcap_source.motions(
            path,
            topic=reading.topic,
            names=reading.names_field,
            position=reading.position_field,
            fixed=reading.names,
        )
    if kind == "lerobot":
        from coordlog.exchange import lerobot_source

        return lerobot_source.motions(path, state=reading.state, action=reading.action)
    if kind in ("robomimic", "minari"):
        from coordlog.exchange import hdf5_source

        return hdf5_source.motions(
            path, state=reading.state, rate=reading.rate, names=reading.names
        )
    from coordlog.exchange import table_source

    return table_source.motions(
        path,
        columns=reading.columns,
        clock=reading.clock,
        rate=reading.rate,
        degrees=reading.degrees,
    )
