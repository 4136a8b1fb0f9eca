"""An episode file as an exporter sees it: read once, named, hashed, and its origin as plain
values.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path

import zstandard

from coordlog.episode import MODEL_XML, Episode, Header, Json, Result
from coordlog.errors import FormatError, StorageError
from coordlog.record.files import Files, Skipped, find_files, nothing_found, reason_of, refused
from coordlog.record.reader import read_summary
from coordlog.record.recording import Recording

JITTER = 0.03
"""How far from a whole rate the median period of an observed episode may be, relatively."""
_FILTERED = ("sha256", "scene", "clean", "success")


@dataclass(frozen=True)
class Entry:
    """One episode of an export, known from the ends of its file.

    Example:
        `Entry.of(Path("logs/a.mcap")).row["clean"]`
    """

    path: Path
    header: Header
    result: Result

    @classmethod
    def of(cls, path: Path) -> Entry:
        """Read both ends of an episode file.

        Raises:
            FormatError: if it is not a finished episode.
        """
        header, result, _ = read_summary(path)
        shared = {name: _shared(json.dumps(getattr(header, name))) for name in ("env", "policy")}
        return cls(path, replace(header, **shared), result)

    @cached_property
    def row(self) -> Json:
        """What `--where` may ask about, and what says where an exported episode comes from; all
        but the file's own sha256.
        """
        episode, env, policy = self.header.episode, self.header.env, self.header.policy
        lineage = self.header.lineage
        return {
            "file": self.path.name,
            "kind": kind_of(self.header),
            "robot": str(episode.get("robot", "")),
            "scene": str(episode.get("scene", "")),
            "split": str(episode.get("split", "")),
            "seed": _integer(episode.get("seed")),
            "index": _integer(episode.get("index")),
            "policy": str(policy.get("name") or policy.get("kind", "")),
            "length": self.result.length,
            "control_period": float(episode.get("control_period", 0.0)),
            "start_time": int(episode["start_time"]),
            "return_sum": float(sum(self.result.returns)),
            "success": self.result.success,
            "clean": self.result.clean,
            "terminated": self.result.terminated,
            "truncated": self.result.truncated,
            "aborted": self.result.aborted,
            "transform": str(lineage.get("transform", "")),
            "parents": ",".join(lineage.get("parents", ())),
            "digest": self.result.digest,
            "coordlog_version": str(env.get("coordlog_version", "")),
            "mujoco_version": str(env.get("mujoco_version", "")),
            "schema_version": int(episode["schema_version"]),
        }


@lru_cache(maxsize=64)
def _shared(text: str) -> Json:
    """A record that most episodes of a run have in common, once: it is most of a header."""
    record: Json = json.loads(text)
    return record


class Loaded:
    """An episode in memory, with the bytes it was read from already hashed."""

    def __init__(self, path: Path) -> None:
        """Read the file.

        Raises:
            FormatError: if it is not a finished, undamaged episode.
        """
        self.path = path
        self._recording = Recording(path)
        self.episode: Episode = self._recording.episode
        self.sha256 = self._recording.digest

    @property
    def data(self) -> bytes:
        """All bytes of the file."""
        return self._recording.data

    @cached_property
    def provenance(self) -> Json:
        """Where the episode comes from: flat, of strings, numbers and truth values."""
        entry = Entry(self.path, self.episode.header, self.episode.result)
        return {"sha256": self.sha256, **entry.row}

    def named(self, separator: str = ".") -> Json:
        """The origin for a place where every entry costs time: what people filter by, each under
        its own name, and all of it as JSON text.
        """
        chosen = {f"coordlog{separator}{key}": self.provenance[key] for key in _FILTERED}
        text = json.dumps(self.provenance, ensure_ascii=False)
        return chosen | {f"coordlog{separator}origin": text}

    @property
    def attachments(self) -> dict[str, bytes]:
        """Model and first state, by name."""
        return self._recording.attachments

    @property
    def model_text(self) -> str:
        """MJCF of robot and scene, or "" if the log has none."""
        frame = self.attachments.get(MODEL_XML, b"")
        try:
            return zstandard.ZstdDecompressor().decompressobj().decompress(frame).decode()
        except (zstandard.ZstdError, UnicodeDecodeError):
            return ""


def entries(
    paths: Sequence[Path] | Files, *, skip_broken: bool = False
) -> tuple[list[Entry], list[str]]:
    """The episodes under some paths in the order of their names, and what was skipped and why.

    Args:
        paths: What to search, or what a search has found.
        skip_broken: Leave out what is broken.

    Raises:
        SpecError: if there are none.
        FormatError: if one is broken and they are not to be skipped.
    """
    found = paths if isinstance(paths, Files) else find_files(paths)
    left: list[Skipped] = []
    if found.skipped and not skip_broken:
        raise refused(found.skipped, "--skip-broken exports the others")
    known: list[Entry] = []
    for path in found.paths:
        try:
            known.append(Entry.of(path))
        except (FormatError, StorageError) as error:
            if not skip_broken:
                raise type(error)(f"{error}; --skip-broken exports the others") from None
            left.append(Skipped(path, reason_of(path, error)))
    if not known:
        given = () if isinstance(paths, Files) else paths
        raise nothing_found(given, found, skipped=left)
    return known, found._replace(skipped=(*found.skipped, *left)).left_out()


def kind_of(header: Header) -> str:
    """Kind of an episode: "simulated" (replays bit for bit) or "observed" (came from outside)."""
    return str(getattr(header, "kind", header.episode.get("kind", "simulated")))


def fps_of(header: Header) -> int | float:
    """Control steps a second; whole where they are but for rounding, or, of an observed episode,
    but for its jitter. The real times are a column of their own.
    """
    fps = 1.0 / float(header.episode["control_period"])
    slack = JITTER if kind_of(header) == "observed" else 1e-6
    return round(fps) if abs(fps - round(fps)) < slack * fps else fps


def task_text(header: Header) -> str:
    """One sentence that says what the robot was to do: LeRobot's `task`."""
    said = header.episode.get("task")
    if said:
        return str(said)
    scene = str(header.episode.get("scene", ""))
    return f"reach the goals ({scene})" if scene else "unnamed task"


def _integer(value: object) -> int:
    """-1 where nothing is known: columns of files have one type."""
    return value if isinstance(value, int) and not isinstance(value, bool) else -1
