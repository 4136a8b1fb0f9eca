"""SQL over catalogues, and over the steps of episodes: read-only, and blind to everything else.

DuckDB sees two views, `episodes` and, where asked for, `steps`; its configuration is locked with no
access to files, extensions or Python's variables, and a bound on memory. Steps are decoded as they
are asked for, a few files at a time, so that memory stays flat.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa

from coordlog.catalog.rows import COLUMNS, KEPT
from coordlog.conditions import require_condition
from coordlog.errors import ConfigError, CoordlogError
from coordlog.parallel import batches
from coordlog.record.dataset import open as open_logs

EXTRA = ("part", "label")
"""Columns that manifests add."""
WORKED_OUT = {"file": "parse_filename(path)", "return_sum": "list_sum(returns)"}
"""Columns that are made of others, in SQL."""
PATHS = "select path from episodes"
"""The question of who looks for files."""
GROUP = 32
"""Files that are decoded together for `steps`."""
MOST = 2_000_000_000
"""Bytes that a query may take, and that its answer may have."""
ROWS = 100_000
"""Rows of an answer that are taken at a time."""
TIMEOUT = 600.0
"""Time that a query may take [s]: recursion need not end."""

_CONFIG: dict[str, Any] = {
    "autoload_known_extensions": "false",
    "autoinstall_known_extensions": "false",
    "python_enable_replacements": "false",
    "memory_limit": f"{MOST}B",
    "temp_directory": "",  # a large sort would be written into the folder that we run in
}


OFFERED = (*COLUMNS.names, *WORKED_OUT, *EXTRA)
"""Every column of the view `episodes`."""


class Source(NamedTuple):
    """Rows of one catalogue, and what stands before their paths."""

    rows: pa.Table | Path
    """a table, or a Parquet file of such rows"""
    prefix: str
    """"" where paths are whole already"""


def ask(
    sql: str,
    sources: Sequence[Source],
    *,
    where: str = "",
    steps: bool = False,
    timeout: float = TIMEOUT,
) -> pa.Table:
    """The answer to one SELECT over `episodes` and, if asked for, `steps`.

    Args:
        sql: The statement. `steps.episode` is `episodes.row`.
        sources: Where episodes are described.
        where: An SQL condition that restricts both views.
        steps: Offer the view `steps`; all its episodes must be of one layout.
        timeout: Time that it may take [s].

    Raises:
        ConfigError: if it is not one SELECT over these views, or takes more than it may.
        CoordlogError: if steps cannot be read.
    """
    import duckdb

    files = [_quoted(str(each.rows)) for each in sources if isinstance(each.rows, Path)]
    with duckdb.connect(config=_CONFIG) as connection:
        # Only the catalogue's own files can be read, and nothing can be written, from here on.
        connection.execute(f"set allowed_paths = [{', '.join(files)}]")
        connection.execute("set enable_external_access = false")
        # DuckDB works in a thread of its own, since it hears of Ctrl-C now and then only.
        with ThreadPoolExecutor(1) as thread:
            work = thread.submit(_answered, connection, sql, sources, where, steps=steps)
            try:
                done, _ = wait([work], timeout)
                if done:
                    return work.result()
                raise ConfigError(
                    f"{_what(sql)}: no answer after {timeout:g} s; ask for less, or wait longer"
                    " with --timeout"
                )
            finally:
                while not work.done():  # it may be between two statements
                    connection.interrupt()
                    wait([work], 0.1)


def _answered(
    connection: Any, sql: str, sources: Sequence[Source], where: str, *, steps: bool
) -> pa.Table:
    """As `ask`, on a connection that can do no harm."""
    import duckdb

    stream: StepStream | None = None
    try:
        _require_select(connection, sql)
        _describe(connection, sources, where)
        if steps:
            connection.execute("create table numbered as select * from episodes")
            connection.execute("create or replace view episodes as select * from numbered")
            paths = connection.execute("select path from numbered order by row").fetchall()
            stream = StepStream([Path(path) for (path,) in paths])
            connection.register("steps", stream)
        connection.execute("set lock_configuration = true")
        return _require_names(_read(connection.sql(sql).to_arrow_reader(ROWS)))
    except (duckdb.Error, OSError) as error:
        if stream is not None and stream.error is not None:
            raise stream.error from None
        text = f"{_what(sql)}: {_said(error)}"
        if isinstance(error, duckdb.ProgrammingError):  # no SQL, or of other names
            text += f"; the view episodes has the columns {', '.join(OFFERED)}"
            text += "" if steps else "; --steps offers the view steps"
        raise ConfigError(text) from None


def _what(sql: str) -> str:
    """What of a command line a question came from."""
    return "--where" if sql == PATHS else "SQL"


def _read(reader: pa.RecordBatchReader) -> pa.Table:
    """The rows of an answer, if they are not too many.

    Raises:
        ConfigError: if they are.
    """
    batches, size = [], 0
    for batch in reader:
        batches.append(batch)
        size += batch.nbytes
        if size > MOST:
            raise ConfigError(
                f"SQL: the answer is of more than {MOST / 1e9:g} GB; ask for fewer rows or columns"
            )
    return pa.Table.from_batches(batches, reader.schema)


def _require_select(connection: Any, sql: str) -> None:
    """Let nothing pass that could do anything but answer."""
    kinds = [
        str(each.type).removeprefix("StatementType.") for each in connection.extract_statements(sql)
    ]
    if kinds != ["SELECT"]:
        got = ", ".join(kinds) or "nothing"
        raise ConfigError(
            f"SQL: expected one SELECT, got {got}; a query reads the catalogue and changes nothing"
        )


def _require_names(table: pa.Table) -> pa.Table:
    """Refuse columns of one name: as rows, all but one of them would be lost."""
    names = table.column_names
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ConfigError(
            f"SQL: two columns are called {twice[0]}; give one another name, {twice[0]} as …"
        )
    return table


def _describe(connection: Any, sources: Sequence[Source], where: str) -> None:
    """Make the view `episodes`."""
    selects = []
    for number, source in enumerate(sources):
        if isinstance(source.rows, Path):
            text, names = f"read_parquet({_quoted(str(source.rows))})", set(KEPT.names)
        else:
            connection.register(f"source{number}", source.rows)
            text, names = f"source{number}", set(source.rows.schema.names)
        prefix = source.prefix.rstrip("/") + "/" if source.prefix else ""
        columns = [f"{_quoted(prefix)} || path as path" if prefix else "path"]
        columns += [f'"{name}"' for name in COLUMNS.names if name != "path"]
        columns += [name if name in names else f"null::varchar as {name}" for name in EXTRA]
        sound = "where error is null and gone is null" if "error" in names else ""
        selects.append(f"select {', '.join(columns)} from {text} {sound}")
    whole = " union all ".join(selects)
    more = ", ".join(f"{how} as {name}" for name, how in WORKED_OUT.items())
    whole = f"select *, {more} from ({whole})"
    connection.execute(f"create view episodes as {whole}")
    if where:
        require_condition(connection, where)
        whole = f"select * from ({whole}) where ({where}\n)"
    connection.execute(
        "create or replace view episodes as select row_number() over () - 1 as row, * from "
        f"({whole})"
    )


def _quoted(text: str) -> str:
    """A text as SQL."""
    return "'" + text.replace("'", "''") + "'"


def _said(error: Exception) -> str:
    """The first line of what DuckDB said."""
    return (str(error).splitlines() or ["it cannot be parsed"])[0]


class StepStream:
    """The steps of episodes as an Arrow stream that can be begun more than once.

    Example:
        >>> import pyarrow
        >>> stream = StepStream([Path("a.mcap")])
        >>> pyarrow.RecordBatchReader.from_stream(stream)  # doctest: +SKIP
    """

    def __init__(self, paths: Sequence[Path]) -> None:
        """Read the first episode, for the columns.

        Raises:
            ConfigError: if there is no episode.
            CoordlogError: if it cannot be read.
        """
        if not paths:
            raise ConfigError("--steps: no episode to take steps of")
        self._paths = paths
        self._schema = open_logs(paths[:1]).to_table().schema
        self.error: CoordlogError | None = None
        """What went wrong while steps were read."""

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        """Begin anew: DuckDB does for every mention of the view."""
        reader = pa.RecordBatchReader.from_batches(self._schema, self._batches())
        return reader.__arrow_c_stream__(requested_schema)

    def _batches(self) -> Iterator[pa.RecordBatch]:
        begun = 0
        for group in batches(self._paths, GROUP):
            try:
                table = open_logs(group).to_table()
                if not table.schema.equals(self._schema):
                    raise ConfigError(
                        f"--steps: {group[0]} has other columns than {self._paths[0]}; choose"
                        " episodes of one robot and task with --where"
                    )
            except CoordlogError as error:
                self.error = error
                raise
            at = table.schema.get_field_index("episode")
            shifted = pa.array(
                table.column("episode").to_numpy() + begun, self._schema.field(at).type
            )
            yield from table.set_column(at, self._schema.field(at), shifted).to_batches()
            begun += len(group)
