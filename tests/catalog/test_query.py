"""A query sees the catalogue and the steps, and nothing else; it changes nothing."""

from __future__ import annotations

import shutil
from pathlib import Path

import pyarrow as pa
import pytest

from coordlog.catalog import query
from coordlog.catalog.gather import gather
from coordlog.catalog.index import Catalog
from coordlog.catalog.query import StepStream, ask
from coordlog.errors import ConfigError, FormatError, SpecError
from coordlog.record.dataset import open as open_logs
from coordlog.record.files import find_files
from tests.catalog.logs import write

DATA = Path(__file__).parents[1] / "data" / "v1"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    for number in range(40):
        write(folder / f"{number:02}.mcap", number)
    return folder


@pytest.fixture
def logs(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "logs"))


@pytest.mark.parametrize("compact", [False, True])
def test_answers_are_those_of_a_loop_over_the_files(logs: Path, compact: bool) -> None:
    catalog = Catalog(logs)
    catalog.refresh()
    if compact:
        catalog.compact()
    sources = gather([logs], scan=False).sources
    episodes = list(open_logs(logs))
    (row,) = ask(
        "select count(*) n, sum(length) s, sum(clean::int) c from episodes", sources
    ).to_pylist()
    assert row == {
        "n": 40,
        "s": sum(map(len, episodes)),
        "c": sum(episode.result.clean for episode in episodes),
    }
    paths = ask("select path from episodes where fell order by path", sources).column(0).to_pylist()
    assert paths == [
        str(path)
        for path, episode in zip(find_files(logs).paths, episodes, strict=True)
        if episode.instability.any()
    ]


def test_steps_are_those_of_the_files_however_often_they_are_mentioned(logs: Path) -> None:
    sources = gather([logs]).sources
    sql = (
        "select seed, count(*), sum(action[1]) from steps join episodes on episode = row group by 1"
    )
    got = {
        next(iter(row.values())): tuple(row.values())[1:]
        for row in ask(sql, sources, steps=True).to_pylist()
    }
    for episode in open_logs(logs):
        count, total = got[episode.header.episode["seed"]]
        assert count == len(episode)
        assert total == pytest.approx(episode.action[:, 0].sum(dtype=float))
    twice = "select (select count(*) from steps) - count(*) from steps a join steps b using (episode, step)"
    assert ask(twice, sources, steps=True).column(0).to_pylist() == [0]


def test_a_condition_restricts_both_views(logs: Path) -> None:
    sources = gather([logs]).sources
    sql = "select count(distinct episode), (select count(*) from episodes) from steps"
    (row,) = ask(sql, sources, where="seed < 5", steps=True).to_pylist()
    assert list(row.values()) == [5, 5]


def test_episodes_of_several_robots_make_no_one_table_of_steps(tmp_path: Path) -> None:
    sources = gather([shutil.copytree(DATA, tmp_path / "logs")]).sources
    with pytest.raises(SpecError, match="as separate sets"):
        ask("select count(*) from steps", sources, steps=True)
    assert ask("select count(*) from steps", sources, where="scene='table'", steps=True)


def test_a_file_that_breaks_meanwhile_is_named(logs: Path) -> None:
    sources = gather([logs]).sources
    (logs / "39.mcap").write_bytes(b"broken")
    with pytest.raises(FormatError, match=r"39\.mcap"):
        ask("select count(*) from steps", sources, steps=True)


@pytest.mark.parametrize(
    "sql",
    [
        "create table x as select 1",
        "insert into episodes select * from episodes",
        "update episodes set length = 0",
        "drop view episodes",
        "copy (select 1) to '{folder}/x.csv'",
        "attach '{folder}/x.db'",
        "export database '{folder}/x'",
        "install httpfs",
        "load httpfs",
        "set enable_external_access = true",
        "pragma database_list",
        "call pragma_version()",
        "select 1; select 2",
        "",
        "explain analyze select 1",
        "select * from read_csv('{folder}/secret.csv')",
        "select * from read_text('{folder}/*')",
        "select * from '{folder}/secret.csv'",
        "select * from parquet_scan('{folder}/x.parquet')",
        "select * from glob('{folder}/*')",
        "select * from secret",
        "select * from query('copy (select 1) to ''{folder}/x.csv''')",
        "select nothing from episodes",
        "selec",
    ],
)
def test_sql_that_does_anything_else_is_refused(sql: str, tmp_path: Path) -> None:
    (tmp_path / "secret.csv").write_text("a\n1\n")
    write(tmp_path / "logs" / "a.mcap", 0)
    secret = pa.table({"a": [1]})
    sources = gather([tmp_path / "logs"]).sources
    with pytest.raises(ConfigError, match=r"^SQL: [^\n]+$"):
        ask(sql.format(folder=tmp_path), sources)
    with pytest.raises(ConfigError, match=r"^(SQL|--where): [^\n]+$"):
        ask("select 1", sources, where=f"1 = 1); {sql.format(folder=tmp_path)}; select (1")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["logs", "secret.csv"]
    assert secret.num_rows == 1


@pytest.mark.parametrize(
    ("sql", "reason"),
    [
        ("select * from range(1000000000)", "answer is of"),
        ("with recursive t(n) as (select 1 union all select n + 1 from t) select max(n) from t",
         "no answer after 0.5 s"),
        ("select max(a.n) from range(10000000000) as a(n)", "no answer after 0.5 s"),
        ("select list(n) from range(1000000000) as t(n)", "Out of Memory"),
        ("select random() r from range(100000000) order by r", "Out of Memory"),
    ],
)  # fmt: skip
def test_a_query_takes_no_more_than_it_may(
    sql: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("coordlog.catalog.query.MOST", 10_000_000)
    monkeypatch.setitem(query._CONFIG, "memory_limit", "30MB")
    write(tmp_path / "logs" / "a.mcap", 0)
    sources = gather(["logs"]).sources
    with pytest.raises(ConfigError, match=f"^SQL: .*{reason}") as caught:
        ask(sql, sources, timeout=0.5 if "0.5 s" in reason else 60)
    assert "\n" not in str(caught.value)
    assert [path.name for path in tmp_path.iterdir()] == ["logs"]


def test_no_episode_has_no_steps() -> None:
    with pytest.raises(ConfigError, match="no episode to take steps of"):
        StepStream([])


def test_the_catalogue_itself_can_be_read_and_never_written(logs: Path) -> None:
    catalog = Catalog(logs)
    catalog.refresh()
    (part,) = (logs / ".catalog").iterdir()
    before = part.read_bytes()
    sources = gather([logs], scan=False).sources
    assert ask(f"select count(*) from read_parquet('{part}')", sources).num_rows == 1
    with pytest.raises(ConfigError):
        ask(f"copy (select 1) to '{part}'", sources)
    with pytest.raises(ConfigError, match="file system operations are disabled"):
        ask(f"select * from read_parquet('{logs}/.catalog/../.catalog/*')", sources)
    assert part.read_bytes() == before
