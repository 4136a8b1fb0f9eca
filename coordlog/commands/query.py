"""coordlog query: SQL over episodes and their steps."""

from __future__ import annotations

import io
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coordlog.commands import terminal
from coordlog.commands.options import Jobs, flag, json_flag
from coordlog.errors import EXIT_PARTIAL, ConfigError

if TYPE_CHECKING:
    import pyarrow as pa

MANY = 40
"""Longer tables are shortened on a terminal; files have every row."""
FORMATS = (".csv", ".json", ".parquet")


def query(
    sql: Annotated[str, typer.Argument(help="One SELECT over the view episodes.")],
    path: Annotated[
        list[Path] | None,
        typer.Argument(help="Folders, packs, stores, manifests or files; by default logs."),
    ] = None,
    steps: Annotated[
        bool, flag("--steps", "Offer the view steps, too; steps.episode = episodes.row.")
    ] = False,
    where: Annotated[
        str, typer.Option(help="Restrict both views to the episodes that satisfy this SQL.")
    ] = "",
    out: Annotated[
        Path | None,
        typer.Option(
            help="Write every row to FILE.csv, FILE.json or FILE.parquet.", metavar="FILE"
        ),
    ] = None,
    scan: Annotated[
        bool, typer.Option(help="Look at the files first; --no-scan believes the catalogue.")
    ] = True,
    timeout: Annotated[float, typer.Option(min=0, help="Longest time for an answer [s].")] = 600,
    jobs: Jobs = "0",
    as_json: Annotated[bool, json_flag("every row")] = False,
) -> None:
    """Ask the catalogue; read-only, with no access to other files.

    New and changed files are catalogued first. Exit code 3 if files are no sound episodes, or
    episodes of a manifest are gone; each is named.

    Examples:

        coordlog query "select scene, count(*), avg(clean::int) from episodes group by all"

        coordlog query "select path from episodes where not clean order by length" logs/ --json

        coordlog query "select max(abs(qvel[7])) from steps" logs/ --steps --where "scene = 'table'"
    """
    from coordlog.catalog.asking import gathered
    from coordlog.catalog.query import ask

    if out is not None and out.suffix not in FORMATS:
        raise ConfigError(f"--out: expected a name that ends in {', '.join(FORMATS)}, got {out}")
    found = gathered(path or [Path("logs")], scan=scan, jobs=jobs, monitor=terminal.Watcher())
    table = ask(sql, found.sources, where=where, steps=steps, timeout=timeout)
    if out is not None:
        _write(table, out)
        terminal.say(f"{out}: {table.num_rows:,} rows")
    elif as_json:
        terminal.print_json(_rows(table))
    else:
        _show(table)
    if found.skipped:
        raise typer.Exit(EXIT_PARTIAL)


def _write(table: pa.Table, out: Path) -> None:
    """The answer as a file, which must not be there."""
    import json

    from coordlog.record.places import Folder

    if out.suffix == ".json":
        data = json.dumps(_rows(table), indent=2, ensure_ascii=False).encode()
    elif out.suffix == ".csv":
        import pyarrow.csv as arrow_csv

        sink = io.BytesIO()
        arrow_csv.write_csv(_flat(table), sink)
        data = sink.getvalue()
    else:
        import pyarrow.parquet as pq

        sink = io.BytesIO()
        pq.write_table(table, sink)
        data = sink.getvalue()
    Folder(out.parent).create(out.name, data)


def _rows(table: pa.Table) -> list[dict[str, Any]]:
    """The rows as JSON values: sums of whole numbers come as decimals, times as texts."""
    return [{name: _plain(value) for name, value in row.items()} for row in table.to_pylist()]


def _plain(value: Any) -> Any:
    if isinstance(value, Decimal):
        return int(value) if value == value.to_integral_value() else float(value)
    if isinstance(value, list):
        return [_plain(each) for each in value]
    if isinstance(value, dict):
        return {name: _plain(each) for name, each in value.items()}
    return value if isinstance(value, int | float | str | None) else str(value)


def _flat(table: pa.Table) -> pa.Table:
    """A table whose lists are JSON texts: CSV has no lists."""
    import json

    import pyarrow as pa

    for at, field in enumerate(table.schema):
        if pa.types.is_nested(field.type):
            texts = [json.dumps(_plain(value)) for value in table.column(at).to_pylist()]
            table = table.set_column(at, field.name, pa.array(texts))
    return table


def _show(table: pa.Table) -> None:
    rows = table.slice(0, MANY).to_pylist()
    numbers = [
        field.name for field in table.schema if str(field.type).startswith(("int", "double", "dec"))
    ]
    cells = [[_cell(value) for value in row.values()] for row in rows]
    terminal.table(table.column_names, cells, right=numbers)
    if table.num_rows > MANY:
        terminal.note(f"{table.num_rows - MANY:,} more rows; --json or --out has them all")


def _cell(value: object) -> object:
    return f"{value:.6g}" if isinstance(value, float) else "-" if value is None else value
