"""Files beside logs: the meshes that robots wear, once per folder, each under its own SHA-256.

No log needs them to be simulated again; where they are missing, pictures show what collides.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from functools import cached_property
from pathlib import PurePath

from coordlog.errors import StorageError
from coordlog.record.addresses import place_at
from coordlog.record.packs import is_shard
from coordlog.record.places import is_url, split_url

FOLDER = "assets"
ABOVE = 4
"""How many folders up from a log its files are looked for: those of a run lie above its episodes,
those of a pack above its shards."""

NAME = re.compile(r"[0-9a-f]{64}\.\w+\.zst")
"""What is kept here is called after its content; whatever else lies there is not ours."""
File = str | os.PathLike[str]


class Beside:
    """The files beside a log, wherever it lies.

    Example:
        >>> find = Beside("logs/a.mcap")                          # doctest: +SKIP
        >>> mesh = find("2f1c….msh.zst")                          # doctest: +SKIP
    """

    def __init__(self, log: File) -> None:
        """Of a log by its address; nothing is looked for yet."""
        above = list(PurePath(log).parents)
        shards = [at for at, each in enumerate(above) if is_shard(each.name)]
        above = above[max(shards, default=-1) + 1 :][:ABOVE]
        self._places = [_address(each) for each in above if len(each.parts) > 1 or not is_url(log)]

    def __call__(self, name: str) -> bytes | None:
        """The bytes of one of them; None if there is none."""
        place = self._found.get(name)
        return None if place is None else place_at(place).read(f"{FOLDER}/{name}")

    def __contains__(self, name: str) -> bool:
        return name in self._found

    def names(self) -> list[str]:
        """The files there are."""
        return sorted(self._found)

    @cached_property
    def _found(self) -> dict[str, str]:
        """In which place each file is, looked for once, the nearest first."""
        found: dict[str, str] = {}
        for place in self._places:
            with suppress(StorageError):  # what cannot be listed is somebody else's, or not there
                for each in place_at(place).entries(FOLDER):
                    name = PurePath(each.name).name
                    if NAME.fullmatch(name):
                        found.setdefault(name, place)
        return found


def keep(where: File, files: Mapping[str, bytes]) -> None:
    """Put files beside the logs of a folder, a pack or a prefix of an object store, unless they
    are there or above it.

    Args:
        where: The address.
        files: Content by name, the name being of the content.

    Raises:
        StorageError: if it refuses.
    """
    log = PurePath(where) / "log"
    there = Beside(log)
    for name, data in files.items():
        if name in there:
            continue
        try:
            place_at(_address(PurePath(where))).create(f"{FOLDER}/{name}", data)
        except StorageError:
            if name not in Beside(log):  # nobody else has put it there meanwhile
                raise


def copy_beside(log: File, where: File, names: Iterable[str]) -> None:
    """Put files that lie beside a log beside others, as far as they are there; errors as `keep`."""
    source, there = Beside(log), Beside(PurePath(where) / "log")
    wanted = [name for name in names if name not in there]
    keep(where, {name: data for name in wanted if (data := source(name)) is not None})


def _address(where: PurePath) -> str:
    """An address as places take it: pathlib takes a slash from a URL."""
    if not is_url(where):
        return str(where)
    scheme, rest = split_url(where)
    return f"{scheme}://{rest}".rstrip("/")
