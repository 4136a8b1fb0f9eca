"""Tests for `coordlog export`, as a person runs it."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from coordlog.cli import app
from coordlog.errors import CoordlogError

DATA = Path(__file__).parents[1] / "data" / "v1"


def export(*args, wanted=0):
    done = CliRunner().invoke(app, ["export", *map(str, args)])
    assert done.exit_code == wanted, done.output
    return done


def refused(*args):
    """The sentence of a refusal."""
    done = CliRunner().invoke(app, ["export", *map(str, args)])
    assert isinstance(done.exception, CoordlogError), done.output
    return str(done.exception)


def test_where_chooses_episodes_and_json_says_what_was_done(tmp_path):
    args = (DATA / "table", "--to", "csv", "--out", tmp_path / "set", "--json")
    done = json.loads(export(*args, "--where", "seed > 11 and success").stdout)
    assert (done["episodes"], done["unchanged"], done["skipped"]) == (1, False, [])
    lines = (tmp_path / "set" / "episodes.csv").read_text().splitlines()
    assert len(lines) == 2
    assert "table-train-s12" in lines[1]


def test_a_damaged_file_stops_the_export_or_is_named(tmp_path):
    logs = tmp_path / "logs"
    logs.mkdir()
    whole = next((DATA / "planar").glob("*.mcap"))
    (logs / "a.mcap").write_bytes(whole.read_bytes())
    (logs / "b.mcap").write_bytes(whole.read_bytes()[:-9])
    args = (logs, "--to", "parquet", "--out", tmp_path / "set")
    assert "b.mcap" in refused(*args)
    assert not (tmp_path / "set").exists()
    done = export(*args, "--skip-broken", wanted=3)
    assert "skipped" in done.stderr
    assert (tmp_path / "set" / "steps" / "00000.parquet").exists()


@pytest.mark.parametrize(
    ("extra", "said"),
    [
        (["--to", "rlds"], "unknown format 'rlds'; choose one of"),
        (["--to", "csv", "--where", "sed = 1"], "expected an SQL condition over path, size"),
        (["--to", "csv", "--where", "seed = 1"], "no episode of 3 satisfies"),
        (["--to", "lerobot", "--camera", "x", "--size", "3"], "two even numbers of pixels"),
        (["--to", "csv", "--camera", "front"], "holds no images"),
        (["--to", "rosbag2", "--storage", "floppy"], "choose one of: mcap, sqlite3"),
    ],
)
def test_a_wrong_wish_is_one_sentence_and_writes_nothing(tmp_path, extra, said):
    assert said in refused(DATA / "table", "--out", tmp_path / "set", *extra)
    assert not list(tmp_path.iterdir())
