"""The model attached to a log, loaded without trusting the log: nothing it says makes MuJoCo open
another file.
"""

from __future__ import annotations

import io
import xml.etree.ElementTree as ET
from xml.parsers import expat

import mujoco
import zstandard

from coordlog.errors import FormatError
from coordlog.sim.physics import silence

MAX_BYTES = 64 << 20
"""A model's text or MJB may expand to this much; ours need 30 kB."""

_ROOT = "mujoco"  # the other root MuJoCo takes is URDF's <robot>, whose meshes are files
_READS_FILES = ("include", "model", "attach", "extension", "plugin")
_FOLDERS = ("meshdir", "texturedir", "assetdir")


def load_model(xml: bytes | None, mjb: bytes | None) -> mujoco.MjModel:
    """Compile the model a log carries, from its attachments as they lie in the file.

    The text is preferred: it compiles to the same model, is not bound to one MuJoCo version, and
    can be judged before it is used.

    Args:
        xml: MJCF text, one zstd frame.
        mjb: MJB, one zstd frame; used when there is no text.

    Raises:
        FormatError: if there is neither, if one is damaged or larger than MAX_BYTES, if the text
            asks for other files, or if MuJoCo refuses it.
    """
    silence()
    if xml is None and mjb is None:
        raise FormatError(
            "no model attached: expected the scene as MJCF text or MJB in the file; record it again"
        )
    try:
        if xml is not None:
            return mujoco.MjModel.from_xml_string(
                self_contained(_expand(xml, "the attached MJCF text"))
            )
        return mujoco.MjModel.from_binary_path(
            "model.mjb", {"model.mjb": _expand(mjb or b"", "the attached MJB")}
        )
    except ValueError as error:
        reason = str(error).splitlines()[0]
        raise FormatError(
            f"the attached model does not load in MuJoCo {mujoco.__version__}, which says: {reason}"
        ) from error


def self_contained(text: bytes) -> str:
    """MJCF text that asks for no other file, written out again from the tree that was judged.

    Writing it out again leaves no room for bytes that two XML parsers read differently.

    Raises:
        FormatError: if it is no MJCF document, declares entities, or names a file, a folder or a
            plugin.
    """
    root = _parse(text)
    if root.tag != _ROOT:
        raise FormatError(
            f"the attached model: expected an MJCF document <{_ROOT}>, got <{root.tag}>"
        )
    for element in root.iter():
        if element.tag in _READS_FILES:
            raise FormatError(
                f"the attached model has <{element.tag}>: expected a model that needs no other file or library"
            )
        for name in element.keys():  # noqa: SIM118 - an Element iterates over its children
            if "file" in name or name in _FOLDERS:
                raise FormatError(
                    f"the attached model has {name}= in <{element.tag}>: expected a model that reads no other file"
                )
    return ET.tostring(root, encoding="unicode")


def _parse(text: bytes) -> ET.Element:
    builder = ET.TreeBuilder()
    parser = expat.ParserCreate()
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.StartDoctypeDeclHandler = _refuse_doctype
    try:
        parser.Parse(text, True)
        return builder.close()
    except (expat.ExpatError, AssertionError) as error:
        raise FormatError(f"the attached model: expected XML, got: {error}") from error


def _refuse_doctype(*_: object) -> None:
    raise FormatError(
        "the attached model declares a document type: expected plain MJCF without entities"
    )


def _expand(data: bytes, what: str) -> bytes:
    try:
        with zstandard.ZstdDecompressor().stream_reader(io.BytesIO(data)) as stream:
            content = stream.read(MAX_BYTES + 1)
    except zstandard.ZstdError as error:
        raise FormatError(f"{what} is damaged: {error}") from error
    if len(content) > MAX_BYTES:
        raise FormatError(
            f"{what} expands to more than {MAX_BYTES >> 20} MiB: not a model this release opens"
        )
    return bytes(content)
