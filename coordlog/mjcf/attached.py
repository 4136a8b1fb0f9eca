"""What a log carries of its model, and loading it again.

A log is not trusted: nothing its model says makes MuJoCo open a file.
"""

from __future__ import annotations

import hashlib
import io
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from xml.parsers import expat

import mujoco
import zstandard

from coordlog.episode import MODEL_XML
from coordlog.errors import ConfigError, FormatError
from coordlog.mjcf.printing import Source
from coordlog.modest import is_plain, require_modest

MAX_BYTES = 64 << 20
"""A model's text and its assets may expand to this much together, its MJB too; ours need 30 kB."""
ASSETS = "assets/"
"""Attachments whose names begin so are files that the model's text names: each one zstd frame under
the SHA-256 of what it holds."""
ASSET_NAME = re.compile(r"[0-9a-f]{64}\.[a-z0-9]{1,8}")
FRAME = ".zst"
LEVEL = 6

_ROOT = "mujoco"  # the other root MuJoCo takes is URDF's <robot>, whose meshes are files
_READS_FILES = ("include", "model", "attach", "extension", "plugin")
_FOLDERS = ("meshdir", "texturedir", "assetdir")


def silence() -> None:
    """Keep MuJoCo from writing warnings to the console and to a file in the working directory: what
    diverges is a flag here.
    """
    log = mujoco.MjLogConfig.get()
    log.logto_console = log.logto_file = False
    mujoco.MjLogConfig.set(log)


def pack_source(source: Source) -> dict[str, bytes]:
    """A model as a log's attachments."""
    packer = zstandard.ZstdCompressor(level=LEVEL)
    packed = {MODEL_XML: packer.compress(source.text.encode())}
    for name, data in source.assets.items():
        packed[ASSETS + name + FRAME] = packer.compress(data)
    return packed


def require_size(source: Source, whose: str) -> None:
    """Hold a model to what can be opened again.

    Raises:
        ConfigError: if it is larger; nothing of it has been recorded then.
    """
    size = len(source.text.encode()) + sum(map(len, source.assets.values()))
    if size > MAX_BYTES:
        raise ConfigError(
            f"{whose}: expected a model of at most {MAX_BYTES >> 20} MiB, its text and collision "
            "meshes together, "
            f"got {size / (1 << 20):.0f} MiB: simplify its meshes"
        )


def load_attached(attachments: Mapping[str, bytes]) -> mujoco.MjModel:
    """Compile the model a log carries, from the text and the assets among the file's attachments.

    A compiled model (version 1 attached one too) is never loaded: a damaged one would end the
    process inside MuJoCo.

    Raises:
        FormatError: as `load_model`.
    """
    return load_model(attachments.get(MODEL_XML), None, _assets(attachments))


def files_of_log(attachments: Mapping[str, bytes]) -> dict[str, bytes]:
    """The files that the text of a log's model names, whole, by name.

    Raises:
        FormatError: if one is damaged, or all are too much.
    """
    return _files(_assets(attachments), room=MAX_BYTES)


def _assets(attachments: Mapping[str, bytes]) -> dict[str, bytes]:
    return {
        name[len(ASSETS) :]: data for name, data in attachments.items() if name.startswith(ASSETS)
    }


def load_model(
    xml: bytes | None, mjb: bytes | None, assets: Mapping[str, bytes] | None = None
) -> mujoco.MjModel:
    """Compile the model a log carries, from its attachments as they lie in the file.

    The text can be judged before it is used; a compiled model (MJB), which files of version 1 have,
    cannot, and a damaged one crashes the process: it is never loaded.

    Args:
        xml: MJCF text, one zstd frame.
        mjb: MJB of files of version 1; only mentioned where there is no text.
        assets: Files that the text names, each one zstd frame under its name and ".zst".

    Raises:
        FormatError: if there is no text, if it or a file is damaged, if they are larger than
            MAX_BYTES, if the text asks for other files or for too much, or if MuJoCo refuses it.
    """
    silence()
    if xml is None:
        raise FormatError(
            "no model attached: expected the scene as MJCF text in the file"
            + ("; it has an MJB, which is not loaded: it cannot be judged" if mjb else "")
        )
    try:
        text = expanded(xml, "the attached MJCF text")
        files = _files(assets or {}, room=MAX_BYTES - len(text))
        return mujoco.MjModel.from_xml_string(self_contained(text, files), files)
    except ValueError as error:
        reason = str(error).splitlines()[0]
        raise FormatError(
            f"the attached model does not load in MuJoCo {mujoco.__version__}, which says: {reason}"
        ) from error


def _files(assets: Mapping[str, bytes], *, room: int) -> dict[str, bytes]:
    """The files beside a text, whole."""
    found = {}
    for stored, data in assets.items():
        name = stored.removesuffix(FRAME)
        if not ASSET_NAME.fullmatch(name):
            raise FormatError(
                f"attachment '{ASSETS}{stored}': expected the SHA-256 of its content as its name"
            )
        found[name] = expanded(data, f"attachment '{ASSETS}{stored}'")
        digest = hashlib.sha256(found[name]).hexdigest()
        if name.split(".")[0] != digest:
            raise FormatError(
                f"attachment '{ASSETS}{stored}': expected content of that SHA-256, got {digest}"
            )
        room -= len(found[name])
        if room < 0:
            raise FormatError(
                f"the attached model expands to more than {MAX_BYTES >> 20} MiB: not a model this "
                "release opens"
            )
    return found


def is_plain_model(xml: bytes | None) -> bool:
    """Whether an attached model is small and simple enough to be compiled in this process.

    True of what will be refused anyway.
    """
    if xml is None:
        return True
    try:
        return is_plain(_parse(expanded(xml, "the attached MJCF text")))
    except FormatError:
        return True


def self_contained(text: bytes, files: Mapping[str, bytes] | None = None) -> str:
    """MJCF text that asks for no file but those given, written out again from the tree that was
    judged.

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
    require_modest(root)
    for element in root.iter():
        if element.tag in _READS_FILES:
            raise FormatError(
                f"the attached model has <{element.tag}>: expected a model that needs no other "
                "file or library"
            )
        for name, value in element.items():
            if name == "file" and value in (files or {}):
                continue
            if "file" in name or name in _FOLDERS:
                raise FormatError(
                    f"the attached model has {name}= in <{element.tag}>: expected a model that "
                    "reads no other file"
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


def expanded(data: bytes, what: str) -> bytes:
    """What a zstd frame holds.

    Raises:
        FormatError: if it is none, or holds more than a model may.
    """
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
