"""Tests for conditions.py: what --where takes is one condition on single episodes."""

from __future__ import annotations

from pathlib import Path

import pytest

from coordlog.catalog.asking import chosen
from coordlog.errors import ConfigError

FILES = sorted((Path(__file__).parent / "data" / "v1" / "table").glob("*.mcap"))


@pytest.mark.parametrize(
    ("where", "rows"),
    [
        ("true", [0, 1, 2]),
        ("clean", [0, 1]),
        ("not clean", [2]),
        ("clean and scene = 'table'", [0, 1]),
        ("file like '%s12%'", [1]),
        ("length > 20 -- longer ones", [0, 1]),
        ("case when clean then false else true end", [2]),
        ("seed in (11, 13)", [0, 2]),
        ("returns[1] > -1e9", [0, 1, 2]),
        ("nullif(clean, false)", [0, 1]),
        ("returns[1] / 0 is not null or clean", [0, 1, 2]),
    ],
)
def test_a_condition_chooses_episodes(where: str, rows: list[int]) -> None:
    assert chosen(FILES, where).paths == tuple(FILES[row] for row in rows)


@pytest.mark.parametrize(
    "where",
    [
        "1=1 union all select row from episodes",
        "true) union all select row from episodes where (true",
        "true) or (true",
        "1=1; drop table episodes",
        "clean;",
        "1=1 order by row desc",
        "true limit 1",
        "1=1) qualify (true",
        "true) window w as (order by row",
        "1=1 group by row",
        "row in (select row from episodes)",
        "exists(select 1)",
        "length > (select avg(length) from episodes)",
        "row_number() over () = 1",
        "count(*) > 1",
        "nonsense",
        " ",
        "$1",
        "read_csv('/etc/passwd') is null",
        "getenv('HOME') is not null",
        "exists(from '/etc/passwd')",
        "1=1; attach '/tmp/x.db'; select row from episodes where true",
        "1=1; install httpfs; load httpfs",
        "1/0",
        "length",
        "null",
        "'true'",
        "row >= 0",
        "columns(*)",
        "sum(length) over () > 1",
        "unnest([true, false])",
        "*",
        "clean, success",
        "clean as b",
        "\0",
    ],
)
def test_whatever_is_more_than_a_condition_is_refused(where: str) -> None:
    with pytest.raises(ConfigError, match="--where: expected an SQL condition over path"):
        chosen(FILES, where)
