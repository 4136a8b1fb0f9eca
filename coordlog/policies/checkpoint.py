"""Arrays and JSON in one safetensors file, written so that a crash leaves the old file or the new
one, and no pickle.

Also the state of a NumPy generator as JSON: its integers are wider than any array type.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from coordlog.episode import Array, Json
from coordlog.errors import FormatError, StorageError
from coordlog.strangers import HEAD, recognise

_T = TypeVar("_T")

MOST = 4 << 30
"""Largest file of arrays that is read [bytes]; a checkpoint of 10⁶ weights takes 20 MB."""
TYPES = ("F64", "F32", "I64", "I32", "U64", "U32", "U8", "BOOL")
"""Types of arrays, as safetensors calls them."""


class Saved(NamedTuple):
    """Content of a file: arrays by name, and what was said about them."""

    arrays: dict[str, Array]
    meta: Json


def save_arrays(path: Path, arrays: Mapping[str, Array], *, kind: str, meta: Json) -> None:
    """Write arrays and JSON-able words about them, replacing the file at once or not at all.

    Args:
        path: The file; its folder is made if need be.
        arrays: Arrays by name.
        kind: What the file is, checked when it is loaded.
        meta: JSON-able dictionary.

    Raises:
        StorageError: if the file system refuses.
    """
    part = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        whole = {
            name: np.ascontiguousarray(array).reshape(array.shape) for name, array in arrays.items()
        }
        save_file(whole, part, metadata={"kind": kind, "meta": json.dumps(meta)})
        _put_in_order(part)
        _sync(part)
        os.replace(part, path)
        _sync(path.parent)
    except (OSError, SafetensorError) as error:
        part.unlink(missing_ok=True)
        raise StorageError(f"{path} cannot be written: {error}") from error


def _put_in_order(path: Path) -> None:
    """Sort the words in a file's header: the library writes them in an order of chance, and the
    same policy shall have the same bytes.
    """
    with path.open("r+b") as stream:
        size = int.from_bytes(stream.read(8), "little")
        head = json.loads(stream.read(size))
        words = dict(sorted(head.pop("__metadata__").items()))
        whole = {"__metadata__": words, **head}
        text = json.dumps(whole, separators=(",", ":"), ensure_ascii=False).encode()
        assert len(text) <= size, "the library writes JSON as we do"
        stream.seek(8)
        stream.write(text.ljust(size))


def load_arrays(path: Path, *, kind: str, most: int = MOST) -> Saved:
    """Read a file of `save_arrays`.

    The file may be anybody's: its header is judged, and its size, before an array is read.

    Args:
        path: The file.
        kind: What it must be.
        most: Largest file that is read [bytes].

    Raises:
        StorageError: if there is no such file or it cannot be read.
        FormatError: if it is damaged, too large, or not of this kind.
    """
    try:
        with path.open("rb") as stream:
            size, head = os.fstat(stream.fileno()).st_size, stream.read(HEAD)
    except OSError as error:
        raise StorageError(f"{path} cannot be read: {error.strerror}") from error
    if size > most:
        raise FormatError(f"{path}: expected a {kind} of at most {most:,} bytes, got {size:,}")
    if head[8:9] != b"{":
        what = recognise(head) or "something else"
        raise FormatError(f"{path}: expected a {kind} (safetensors), got {what}")
    try:
        with safe_open(path, framework="numpy") as file:
            said = file.metadata() or {}
            if said.get("kind") != kind:
                raise FormatError(
                    f"{path}: expected a {kind} file, got "
                    f"{said.get('kind', 'a file of another program')}"
                )
            names = file.keys()  # not a mapping: it cannot be iterated
            for name in names:
                stored = file.get_slice(name).get_dtype()
                if stored not in TYPES:
                    raise FormatError(
                        f"{path}: '{name}': expected numbers of {', '.join(TYPES)}, got {stored}"
                    )
            return Saved({name: file.get_tensor(name) for name in names}, _meta(path, said))
    except OSError as error:
        raise StorageError(f"{path} cannot be read: {error}") from error
    except SafetensorError as error:
        raise FormatError(f"{path} is damaged or not a safetensors file: {error}") from error


def _meta(path: Path, said: Mapping[str, str]) -> Json:
    """What a file says about its arrays."""
    try:
        meta = json.loads(said.get("meta", ""))
    except (ValueError, RecursionError) as error:
        reason = "too deep" if isinstance(error, RecursionError) else str(error)
        raise FormatError(f"{path}: expected metadata as JSON: {reason}") from None
    if not isinstance(meta, dict):
        raise FormatError(f"{path}: expected metadata as a JSON object, got {str(meta)[:40]}")
    return meta


def under(prefix: str, values: Mapping[str, _T]) -> dict[str, _T]:
    """What is named with the prefix, without it."""
    return {
        key.removeprefix(prefix): value for key, value in values.items() if key.startswith(prefix)
    }


def generator_to_json(rng: np.random.Generator) -> Json:
    """The state of a PCG64 generator."""
    state: dict[str, Any] = dict(rng.bit_generator.state)
    return state


def generator_from_json(state: Json) -> np.random.Generator:
    """A generator that continues from a saved state."""
    rng = np.random.default_rng()
    rng.bit_generator.state = state
    return rng


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
