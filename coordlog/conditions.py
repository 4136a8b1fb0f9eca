"""What somebody types after --where: held to one SQL condition that looks at one row at a time."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from coordlog.errors import ConfigError

if TYPE_CHECKING:
    import pyarrow as pa
    from duckdb import DuckDBPyConnection


CLOSED: dict[str, str | bool | int | float | list[str]] = {
    "enable_external_access": "false",
    "autoinstall_known_extensions": "false",
    "autoload_known_extensions": "false",
    "memory_limit": "1GB",
    "lock_configuration": "true",
}
"""How a database is opened that is asked what somebody typed: it reaches no file."""


def matching(episodes: pa.Table, where: str) -> list[int]:
    """Rows of a table of episodes that satisfy an SQL condition over its columns, in order.

    Raises:
        ConfigError: if it is no condition over these columns, or cannot be answered.
    """
    import duckdb

    with duckdb.connect(config=CLOSED) as connection:
        connection.register("episodes", episodes)
        require_condition(connection, where)
        try:
            answers = connection.execute(f"select ({where}\n) from episodes").fetchall()
        except duckdb.Error as error:
            raise _refused(connection, error) from None
    return [row for row, (holds,) in enumerate(answers) if holds]


def require_condition(connection: DuckDBPyConnection, where: str) -> None:
    """Hold a text to one expression that looks at one row of `episodes` at a time, and is true or
    false of it.

    It is judged by the tree that the database's own parser makes of it, so there is nothing that
    the two could read differently.

    Raises:
        ConfigError: saying what it is instead.
    """
    import duckdb

    try:
        _require_expression(connection, where)
        # a condition may hold no aggregate; what is selected may be of any type
        connection.execute(f"explain select true from episodes where ({where}\n)")
        columns = connection.execute(f"describe select ({where}\n) from episodes").fetchall()
    except (duckdb.Error, ValueError) as error:
        raise _refused(connection, error) from None
    kinds = [str(kind) for _, kind, *_ in columns]
    if kinds != ["BOOLEAN"]:
        reason = f"one that is true or false, got {', '.join(kinds)}"
        raise _refused(connection, ValueError(reason))


def _refused(connection: DuckDBPyConnection, error: Exception) -> ConfigError:
    names = ", ".join(str(row[0]) for row in connection.execute("describe episodes").fetchall())
    reason = (str(error).splitlines() or ["it cannot be parsed"])[0]
    return ConfigError(f"--where: expected an SQL condition over {names}; {reason}")


def _require_expression(connection: DuckDBPyConnection, where: str) -> None:
    statements = connection.extract_statements(f"select 1 from episodes where ({where}\n)")
    if len(statements) != 1:
        raise ValueError(f"one condition, got {len(statements)} statements")
    wanted = _tree(connection, "select 1 from episodes where (true)")
    node = _tree(connection, f"select 1 from episodes where ({where}\n)")
    _tree(connection, f"select [{where}\n]")  # what closes our bracket closes but one of the two
    condition = node.pop("where_clause", None)
    wanted.pop("where_clause")
    if _without_places(node) != _without_places(wanted) or condition is None:
        raise ValueError("one condition, got more than a condition")
    for part in _parts(condition):
        if part.get("class") == "SUBQUERY":
            raise ValueError("a condition on single episodes, got a query within it")
        if part.get("class") == "WINDOW":
            raise ValueError("a condition on single episodes, got a window over several")


def _tree(connection: DuckDBPyConnection, query: str) -> dict[str, Any]:
    """A query as the database's parser sees it.

    Raises:
        ValueError: if it is none.
    """
    row = connection.execute("select json_serialize_sql(?::varchar)", [query]).fetchone()
    parsed: Any = json.loads(row[0]) if row else {"error": True}
    if parsed.get("error"):
        raise ValueError(str(parsed.get("error_message", "it cannot be parsed")))
    (statement,) = parsed["statements"]
    return dict(statement["node"])


def _parts(tree: object) -> Iterator[dict[str, Any]]:
    """All nodes of a parsed expression."""
    if isinstance(tree, dict):
        yield tree
        tree = list(tree.values())
    if isinstance(tree, list):
        for each in tree:
            yield from _parts(each)


def _without_places(tree: object) -> object:
    """A parsed statement without where its parts stood in the text."""
    if isinstance(tree, dict):
        return {
            key: _without_places(value) for key, value in tree.items() if key != "query_location"
        }
    return [_without_places(each) for each in tree] if isinstance(tree, list) else tree
