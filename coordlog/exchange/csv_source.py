"""CSV as an Arrow table, whatever its delimiter and line ends."""

from __future__ import annotations

import io
import re
from pathlib import Path

import pyarrow as pa
import pyarrow.csv as pc

from coordlog.errors import FormatError

_COMMA = rb"-?[\d.]*\d,\d+(?:[eE][-+]?\d+)?"
_DECIMAL_COMMA = re.compile(rb'(^|[;\t|"]) *' + _COMMA + rb' *($|[;\t|"\r])', re.MULTILINE)
_RAGGED = re.compile(r"Row #(\d+): Expected (\d+) columns, got (\d+)")
_QUOTED_COMMA = re.compile(rb'"' + _COMMA + rb'"')
_NUMBER = re.compile(r"\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\s*")


def read_csv(path: Path) -> tuple[pa.Table, tuple[str, ...]]:
    """The table, and what a person should know about it.

    Raises:
        FormatError: naming the line that is wrong.
    """
    data = _utf8(path)
    head = re.split(rb"[\r\n]", data, maxsplit=1)[0]
    if not head:
        raise FormatError(f"{path}: expected a header of column names in line 1, got none")
    delimiter = max((",", ";", "\t", "|"), key=lambda each: head.count(each.encode()))
    _require_header(path, head.decode(), delimiter)
    _require_points(path, data, delimiter)
    try:
        table = pc.read_csv(
            io.BytesIO(data),
            read_options=pc.ReadOptions(use_threads=False),
            parse_options=pc.ParseOptions(delimiter=delimiter),
            convert_options=pc.ConvertOptions(null_values=[""]),
        )
    except (pa.ArrowInvalid, pa.ArrowKeyError) as error:
        said = str(error).splitlines()[0].removeprefix("CSV parse error: ")
        raise FormatError(f"{path}: {_ragged(said, delimiter)}") from error
    names = [name.strip() for name in table.column_names]
    twice = next((name for i, name in enumerate(names) if name in names[:i]), None)
    if twice is not None:
        raise FormatError(
            f"{path}: line 1: column '{twice}' stands twice; give each a name of its own"
        )
    notes = ("the last line has no end: where the file was cut off, its last number is wrong",)
    return table.rename_columns(names), () if data[-1:] in b"\r\n" else notes


def number_text(path: Path, table: pa.Table, name: str) -> None:
    """Say why a column that should be numbers is text.

    Raises:
        FormatError: always, naming the first row that is none.
    """
    texts = table.column(name).to_pylist()
    bad = [i for i, text in enumerate(texts) if not _NUMBER.fullmatch(text or "")]
    if len(bad) == len(texts) or not bad:
        raise FormatError(
            f"{path}: column '{name}': expected numbers, got text such as '{texts[0]!s:.40}'; "
            "choose columns with --columns"
        )
    raise FormatError(
        f"{path}: column '{name}', row {bad[0]}: expected a number, got '{texts[bad[0]]!s:.40}'"
    )


def _ragged(said: str, delimiter: str) -> str:
    """What Arrow says of a row of too many or too few cells, by its line."""
    found = _RAGGED.match(said)
    if found is None:
        return said
    line, wanted, got = found.groups()
    commas = delimiter == "," and int(got) > int(wanted)
    hint = "; if these are decimal commas, save it with points" if commas else ""
    return f"line {line}: expected {wanted} columns, got {got}{said[found.end() :]}{hint}"


def _utf8(path: Path) -> bytes:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise FormatError(f"{path}: cannot be read: {error.strerror}") from error
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise FormatError(f"{path}: expected UTF-8, got UTF-16; save it as UTF-8")
    data = data.removeprefix(b"\xef\xbb\xbf")
    try:
        data.decode()
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise FormatError(
            f"{path}: line {line}: expected UTF-8, got the byte {data[error.start]:#04x}: another "
            "encoding, or no text; save it as UTF-8"
        ) from error
    return data


def _require_header(path: Path, head: str, delimiter: str) -> None:
    cells = [cell.strip().strip('"') for cell in head.split(delimiter)]
    if head.startswith("#"):
        raise FormatError(
            f"{path}: line 1: expected a header of column names, got a comment; take the # away, "
            "or the line"
        )
    if len(cells) == 1 and " " in cells[0]:
        raise FormatError(
            f"{path}: line 1: expected columns parted by a comma, semicolon, tab or |, got spaces: "
            f"'{head:.40}'"
        )
    if all(_NUMBER.fullmatch(cell) for cell in cells):
        raise FormatError(
            f"{path}: line 1: expected a header of column names, got numbers; put names above them"
        )


def _require_points(path: Path, data: bytes, delimiter: str) -> None:
    pattern = _QUOTED_COMMA if delimiter == "," else _DECIMAL_COMMA
    found = pattern.search(data)
    if found:
        line = data.count(b"\n", 0, found.start(0) + 1) + 1
        text = found.group(0).strip(b';\t|" \r\n').decode()
        raise FormatError(
            f"{path}: line {line}: expected numbers with a decimal point, got '{text}'; save it "
            "with points"
        )
