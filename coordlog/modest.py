"""What a model that came with a file may ask for, judged from its text before it is compiled.

A few bytes of MJCF can ask for a million geoms, a day of physics or all of the memory. Every number
here is our choice, far above what robots need and far below what hurts.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from math import prod

from coordlog.errors import FormatError

MOST_ELEMENTS = 20_000
"""Elements of a model, those that <replicate> and the like make included."""
MOST_DEPTH = 200
"""Elements within one another."""
MOST_ATTRIBUTES = 200
"""Attributes of one element; MuJoCo's parser compares each with all before it."""
MOST_CELLS = 1 << 24
"""Cells of a height field, pixels of a texture."""
MOST_COUNT = 1_000_000
"""Whatever else is counted: iterations, contacts, user data."""
MOST_MEMORY = 1 << 30
"""Bytes of MuJoCo's arena."""
LEAST_TIMESTEP = 1e-5
"""Seconds of a physics step."""
PLAIN_ELEMENTS = 1_000
PLAIN_GEOMS = 250
PLAIN_COUNT = 10_000
"""Up to these sizes, and of simple shapes alone, a model needs no trial in a process of its own."""

_MULTIPLIES = {"replicate": "count", "composite": "count", "flexcomp": "count"}
_COUNTS = (
    *("njmax", "nconmax", "nstack", "nuserdata", "nkey", "dim", "actdim", "nsample", "resolution"),
    *("iterations", "ls_iterations", "noslip_iterations", "ccd_iterations", "sdf_iterations"),
    *("sdf_initpoints", "maxhullvert", "octree_depth"),
)
_NOT_PLAIN = {"replicate", "composite", "flexcomp", "flex", "hfield", "mesh", "skin", "texture"}
_UNITS = {"K": 1 << 10, "M": 1 << 20, "G": 1 << 30, "T": 1 << 40}


def require_modest(root: ET.Element) -> None:
    """Refuse a model that asks for more than any robot needs.

    Raises:
        FormatError: naming what it asks for.

    Example:
        >>> require_modest(ET.fromstring('<mujoco><option timestep="0.002"/></mujoco>'))
    """
    total, waiting = 0, [(root, 1, 1)]
    while waiting:
        element, times, depth = waiting.pop()
        _judge(element)
        total += times
        if depth > MOST_DEPTH:
            raise _too_much("a depth", f"{depth} elements within one another", MOST_DEPTH)
        times *= _copies(element)
        if total > MOST_ELEMENTS or times > MOST_ELEMENTS:
            raise _too_much("a size", f"{max(total, times):,} elements or more", MOST_ELEMENTS)
        waiting += [(child, times, depth + 1) for child in element]


def is_plain(root: ET.Element) -> bool:
    """Whether a modest model is small and of simple shapes, so that compiling it is harmless."""
    tags = [element.tag for element in root.iter()]
    small = len(tags) <= PLAIN_ELEMENTS and tags.count("geom") <= PLAIN_GEOMS
    few = all(
        abs(value) <= PLAIN_COUNT
        for element in root.iter()
        for name, text in element.items()
        if _is_count(element, name)
        for value in _numbers(text)
    )
    return small and few and not _NOT_PLAIN.intersection(tags)


def _judge(element: ET.Element) -> None:
    """Look at the attributes of one element and the numbers in them."""
    if len(element.attrib) > MOST_ATTRIBUTES:
        got = f"{len(element.attrib):,} attributes"
        raise _too_much(f"<{element.tag}>", got, MOST_ATTRIBUTES)
    cells = {"hfield": ("nrow", "ncol"), "texture": ("width", "height")}.get(element.tag)
    if cells is not None:
        size = prod(max(1.0, *_numbers(element.get(name, "1")), 1.0) for name in cells)
        if size > MOST_CELLS:
            raise _too_much(f"<{element.tag}>", f"{size:,.0f} cells", MOST_CELLS)
    if element.tag == "option":
        for step in _numbers(element.get("timestep", "")):
            if not step >= LEAST_TIMESTEP:
                raise FormatError(
                    f"the attached model: expected a timestep of at least {LEAST_TIMESTEP} s,"
                    f" got {step} s"
                )
    if element.tag == "size" and _bytes(element.get("memory", "0")) > MOST_MEMORY:
        raise _too_much("<size> memory", element.get("memory", ""), MOST_MEMORY)
    for name, text in element.items():
        most = MOST_ELEMENTS if name == "nkey" else MOST_COUNT
        counted = _is_count(element, name)
        if counted and any(not abs(value) <= most for value in _numbers(text)):
            raise _too_much(f"<{element.tag}> {name}", text[:20], most)


def _is_count(element: ET.Element, name: str) -> bool:
    """Whether an attribute says how many there are of something."""
    numeric = element.tag == "numeric" and name == "size"
    return numeric or name in _COUNTS or name.startswith("nuser")


def _copies(element: ET.Element) -> int:
    """How often an element repeats its children."""
    name = _MULTIPLIES.get(element.tag)
    if name is None:
        return 1
    counts = [max(1.0, abs(value)) for value in _numbers(element.get(name, "1"))]
    return int(min(prod(counts), 10.0 * MOST_ELEMENTS))


def _numbers(text: str) -> list[float]:
    """The numbers of an attribute; what is none is MuJoCo's to refuse."""
    found = []
    for word in text.split():
        try:
            found.append(float(word))
        except ValueError:
            return []
    return found


def _bytes(text: str) -> float:
    unit = _UNITS.get(text[-1:].upper(), 1)
    return sum(_numbers(text[:-1] if unit > 1 else text)) * unit


def _too_much(what: str, got: str, most: int) -> FormatError:
    return FormatError(f"the attached model: {what}: expected at most {most:,}, got {got}")
