"""A spec as text that compiles to the same model, to the bit."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache, lru_cache
from pathlib import Path
from typing import NamedTuple

import mujoco

from coordlog.errors import SimulationError

DIGITS = 17
"""Decimal digits that give every double back; MuJoCo prints six unless told otherwise."""
LONG = re.compile(r"\d+\.\d{9,}(?:e[+-]?\d+)?")


class Source(NamedTuple):
    """What a model is compiled from, and all that a log needs of it."""

    text: str
    """MJCF, whole: it names no file but those in `assets`."""
    assets: Mapping[str, bytes] = {}
    """Files that the text names: collision shapes, each under the SHA-256 of its bytes."""


def printed(spec: mujoco.MjSpec) -> str:
    """The spec as MJCF text; every number in the fewest digits that give it back.

    Raises:
        SimulationError: if MuJoCo refuses to compile the spec, with MuJoCo's reason.
    """
    try:
        with full_precision():
            text: str = spec.to_xml()
    except ValueError as error:
        raise SimulationError(refusal(error)) from error
    return LONG.sub(lambda found: _shortest(found[0]), text)


@contextmanager
def full_precision() -> Iterator[None]:
    """Let MuJoCo print numbers with all their digits."""
    precision = _switch()
    before = precision.get()
    precision.set(DIGITS)
    try:
        yield
    finally:
        precision.set(before)


def compile_model(source: Source | str) -> mujoco.MjModel:
    """Compile what `compose` made, or plain MJCF text.

    Raises:
        SimulationError: if MuJoCo refuses the text, with MuJoCo's reason.
    """
    text, assets = source if isinstance(source, Source) else (source, {})
    try:
        return mujoco.MjModel.from_xml_string(text, dict(assets))
    except ValueError as error:
        raise SimulationError(refusal(error)) from error


def refusal(error: ValueError) -> str:
    """What MuJoCo says to a model it does not compile, as a sentence."""
    return f"model: expected MJCF that compiles; MuJoCo says: {str(error).splitlines()[0]}"


@lru_cache(maxsize=1 << 16)
def _shortest(number: str) -> str:
    return repr(float(number))


class _Switch:
    """How many digits MuJoCo prints. Its Python bindings have no name for it, its library has;
    where one day it has not, six digits are printed, and the model is compiled from those.
    """

    def __init__(self) -> None:
        folder = Path(mujoco.__file__).parent
        library = next(iter(sorted(folder.glob("libmujoco*"))), None)
        handle = ctypes.CDLL(str(library)) if library else None
        self._get = getattr(handle, "_mjPRIVATE__get_xml_precision", None)
        self._set = getattr(handle, "_mjPRIVATE__set_xml_precision", None)

    def get(self) -> int:
        return int(self._get()) if self._get and self._set else 0

    def set(self, digits: int) -> None:
        if self._get and self._set:
            self._set(digits)


@cache
def _switch() -> _Switch:
    return _Switch()
