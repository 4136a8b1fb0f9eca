"""The commands of many episodes: exit codes, one sentence for what is wrong, the same answers whoever
worked them out."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner, Result

from coordlog.api.logs import load_logs
from coordlog.cli import app
from coordlog.commands import terminal
from coordlog.errors import ConfigError, CoordlogError, SpecError, WorkerError
from coordlog.parallel import mapped, shard, workers
from coordlog.smooth.batch import plan

DATA = Path(__file__).parents[1] / "data" / "v1"
run = CliRunner()


@pytest.fixture
def logs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(DATA / "table", "logs/table")
    shutil.copytree(DATA / "planar", "logs/planar")
    return Path("logs")


def answer(*arguments: object, code: int = 0) -> Result:
    result = run.invoke(app, [str(each) for each in arguments])
    assert result.exit_code == code, result.output
    return result


def refusal(*arguments: object) -> str:
    result = run.invoke(app, [str(each) for each in arguments])
    assert isinstance(result.exception, CoordlogError), result.output
    assert "\n" not in str(result.exception)
    return str(result.exception)


def rows(*arguments: object, code: int = 0) -> list[dict[str, object]]:
    found: list[dict[str, object]] = json.loads(answer(*arguments, "--json", code=code).stdout)
    return found


def test_index_then_query(logs: Path) -> None:
    (report,) = rows("index", logs)
    assert (report["episodes"], report["new"]) == (4, 4)
    assert rows("index", logs, "--compact")[0]["new"] == 0
    sql = "select scene, count(*) as n from episodes group by all order by scene"
    assert rows("query", sql) == [{"scene": "planar", "n": 1}, {"scene": "table", "n": 3}]
    assert "planar" in answer("query", sql, logs, "--no-scan").stdout
    assert (
        rows("query", "select count(*) n from steps", logs, "--steps", "--where", "scene='table'")[
            0
        ]["n"]
        == 198
    )


def test_every_kind_of_value_can_be_printed(logs: Path) -> None:
    sql = (
        "select sum(length) a, max(returns) b, now() c, struct_pack(x := 1.5::decimal(4, 2)) d,"
        " 'a'::blob e, null f, length from episodes group by length order by length"
    )
    found = rows("query", sql, logs)
    assert found[0]["a"] == found[0]["length"]
    assert found[0]["d"] == {"x": 1.5}
    assert len(found[0]) == 7
    assert "two columns are called length" in refusal(
        "query", "select length, length from episodes"
    )
    answer("query", sql, logs)
    answer("query", sql, "--out", "x.csv")


@pytest.mark.parametrize(
    "line",
    [
        "pack logs",
        "unpack logs",
        "smooth logs",
        "export logs --to csv",
        "train --from logs",
        "import logs/a.csv",
        "migrate logs",
    ],
)
def test_only_record_writes_into_an_object_store(line: str, logs: Path) -> None:
    assert "only `coordlog record` writes" in refusal(*line.split(), "--out", "s3://robots/x")
    assert not Path("s3:").exists()


def test_what_is_broken_is_named_and_the_rest_is_answered(logs: Path) -> None:
    (logs / "bad.mcap").write_bytes(b"")
    result = answer("index", logs, code=3)
    assert "bad.mcap: the file is empty" in result.stderr
    result = answer("query", "select count(*) n from episodes", logs, "--json", code=3)
    assert json.loads(result.stdout) == [{"n": 4}]
    assert "bad.mcap" in result.stderr


def test_verify_finds_other_bytes(logs: Path) -> None:
    import os

    answer("index", logs)
    path = min(logs.glob("table/*.mcap"))
    status, data = path.stat(), bytearray(path.read_bytes())
    data[-100] ^= 1
    path.write_bytes(data)
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))
    result = answer("index", logs, "--verify", code=1)
    assert "its bytes were changed" in result.stdout


@pytest.mark.parametrize("suffix", ["csv", "json", "parquet"])
def test_every_row_goes_into_a_file_that_was_not_there(logs: Path, suffix: str) -> None:
    sql = "select path, length, returns from episodes order by path"
    wanted = rows("query", sql)
    out = Path(f"rows.{suffix}")
    answer("query", sql, "--out", out)
    if suffix == "parquet":
        assert pq.read_table(out).to_pylist() == wanted
    elif suffix == "json":
        assert json.loads(out.read_text()) == wanted
    else:
        with out.open() as stream:
            got = list(csv.DictReader(stream))
        assert [row["path"] for row in got] == [row["path"] for row in wanted]
        assert [json.loads(row["returns"]) for row in got] == [row["returns"] for row in wanted]
    assert "not overwritten" in refusal("query", sql, "--out", out)
    assert ".csv, .json, .parquet" in refusal("query", sql, "--out", "rows.xlsx")


def test_select_and_its_manifest_wherever_a_folder_goes(logs: Path) -> None:
    made = rows("select", logs, "--where", "scene = 'table'", "--split", "0.5,0.5", "--by", "digest",
                "--out", "table.manifest")  # fmt: skip
    assert made["episodes"] == 3  # type: ignore[call-overload]
    assert len(rows("info", "table.manifest")["episodes"]) == 3  # type: ignore[call-overload]
    again = rows(
        "select", "table.manifest", logs, "--where", "scene = 'table'", "--out", "b.manifest"
    )
    assert answer("diff", "table.manifest", "b.manifest").stdout.startswith("3 episodes in both")
    assert again["hash"] == made["hash"]  # type: ignore[call-overload]
    answer("diff", logs, "table.manifest", code=1)
    assert "--force" in refusal("select", logs, "--out", "table.manifest")
    answer("select", logs, "--out", "table.manifest", "--force")
    assert len(list(Path().glob("table@*.manifest"))) == 1
    assert "ends in .manifest" in refusal("select", logs, "--out", "table")
    assert "no episode satisfies" in refusal(
        "select", logs, "--where", "false", "--out", "c.manifest"
    )


def test_a_manifest_whose_episodes_are_gone_lists_them(logs: Path) -> None:
    answer("select", logs, "--out", "all.manifest")
    path = min(logs.glob("table/*.mcap"))
    path.unlink()
    result = answer("query", "select count(*) n from episodes", "all.manifest", code=3)
    assert f"{path.name}: gone" in result.stderr
    shutil.rmtree(logs / "planar")
    assert "; and 1 more; --skip-broken" in refusal(
        "export", "all.manifest", "--to", "csv", "--out", "csv"
    )
    shutil.rmtree(logs / "table")
    result = answer("query", "select count(*) n from episodes", "all.manifest", code=3)
    assert result.stderr.count(": gone") == 4


def test_what_is_made_of_episodes_has_their_names_whatever_was_named(logs: Path) -> None:
    answer("select", logs, "--out", logs / "all.manifest")
    answer("pack", logs, "--out", "PACK", "--no-index")
    wanted = {path.relative_to(logs).as_posix() for path in logs.rglob("*.mcap")}
    for named in (logs, logs / "all.manifest", Path("PACK")):
        batch = plan([named], Path("out"), {})
        assert {job.target.relative_to("out").as_posix() for job in batch.jobs} == wanted


def test_an_overview_of_what_satisfies_a_condition(logs: Path) -> None:
    answer("pack", logs, "--out", "PACK", "--no-index")
    answer("view", "PACK", "--where", "scene = 'table' and clean", "--save", "some.rrd")
    assert "no episode of 4 satisfies" in refusal("view", logs, "--where", "false", "--no-open")


def test_logs_of_several_scenes_are_refused_before_they_are_decoded(
    logs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def decode(*_: object, **__: object) -> None:
        raise AssertionError

    monkeypatch.setattr("coordlog.record.cache.load", decode)
    answer("index", logs)
    with pytest.raises(SpecError, match="logs of several scenes"):
        load_logs([logs])


def test_pack_and_back(logs: Path) -> None:
    answer("pack", logs, "--out", "PACK")
    assert "4 were there" in answer("pack", logs, "--out", "PACK").stdout
    answer("diff", logs, "PACK")
    assert "all sound" in answer("check", "PACK", "--level", "content", "--jobs", "1").stdout
    answer("unpack", "PACK", "--out", "back")
    for path in logs.rglob("*.mcap"):
        assert (Path("back") / path.relative_to(logs)).read_bytes() == path.read_bytes()


def test_shares_of_the_work_make_the_whole(logs: Path) -> None:
    for i in (1, 2, 3):
        answer("pack", logs, "--out", "PACK", "--shard", f"{i}/3")
    assert answer("diff", logs, "PACK").exit_code == 0
    for text in ("0/3", "4/3", "3", "a/b", "1/0"):
        assert refusal("pack", logs, "--out", "PACK", "--shard", text).startswith(
            "--shard: expected"
        )


def test_a_share_without_an_episode_proves_nothing(logs: Path) -> None:
    assert "none of 4 episodes is in it" in refusal("check", logs, "--shard", "5/5")


def test_recording_a_share_into_a_pack_gives_those_files_of_a_folder(tmp_path: Path) -> None:
    same = ("--scene", "free", "--policy", "random", "--episodes", 2, "--epoch", 1, "--envs", 1)
    answer("record", *same, "--out", tmp_path / "logs")
    answer("record", *same, "--shard", "2/2", "--pack", "--out", tmp_path / "PACK")
    answer("unpack", tmp_path / "PACK", "--out", tmp_path / "back")
    (path,) = (tmp_path / "back").iterdir()
    assert "-000001-" in path.name
    assert path.read_bytes() == (tmp_path / "logs" / path.name).read_bytes()


def test_what_is_not_there_is_said(logs: Path) -> None:
    assert "no such file or folder" in refusal("query", "select 1", "nothing")
    assert "has no catalogue yet" in refusal("query", "select 1", logs, "--no-scan")
    assert "--jobs: expected a number" in refusal("index", logs, "--jobs", "many")


@pytest.mark.parametrize(
    ("jobs", "head", "reason"),
    [
        ("ray://127.0.0.1:1", "", "no head of a cluster at ray://127.0.0.1:1: Connection refused"),
        ("ray", "127.0.0.1:1", "no head of a cluster at 127.0.0.1:1: Connection refused"),
        ("ray://127.0.0.1:999999", "", "no head of a cluster"),
        ("ray://host:abc", "", "expected ray://HOST:PORT"),
    ],
)
def test_a_cluster_that_is_not_there_is_said_at_once(
    jobs: str, head: str, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("ray")
    monkeypatch.setenv("RAY_ADDRESS", head)
    with pytest.raises(ConfigError, match=reason):
        list(mapped(abs, [1], jobs=jobs))


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_answers_come_in_the_order_of_the_items(jobs: str) -> None:
    assert list(mapped(abs, range(-5, 5), jobs=jobs)) == [abs(i) for i in range(-5, 5)]


def test_shards_are_disjoint_and_make_the_whole() -> None:
    for n in range(1, 9):
        parts = [list(shard(range(20), f"{i}/{n}")) for i in range(1, n + 1)]
        assert sorted(each for part in parts for each in part) == list(range(20))
    assert shard(range(3), "") == range(3)
    assert [workers(text) for text in (0, "3", "ray", "ray://host:1")] == [
        0,
        3,
        "ray",
        "ray://host:1",
    ]


def killed(signal_number: int) -> None:
    """End as a process does that the system kills for its memory."""
    os.kill(os.getpid(), signal_number)


def test_a_killed_worker_is_one_sentence() -> None:
    with pytest.raises(WorkerError, match="what it had finished is kept"):
        list(mapped(killed, [signal.SIGKILL] * 2, jobs=2))


def stopped_with_its_workers() -> None:
    """What a signal to a whole group of processes is."""
    with terminal.interruptible():
        os.kill(os.getpid(), signal.SIGTERM)
        raise WorkerError("killed")


def test_workers_that_end_with_a_stopped_command_are_no_error_of_theirs() -> None:
    with pytest.raises(KeyboardInterrupt):
        stopped_with_its_workers()
