"""Robots and environments of others on the command line."""

import json

import pytest
from typer.testing import CliRunner

from coordlog.cli import app
from coordlog.errors import ConfigError, StorageError
from tests.robots.outside import text

RUN = CliRunner()


def test_a_model_becomes_a_card_that_records(tmp_path):
    (tmp_path / "arm.xml").write_text(text())
    card, model = tmp_path / "arm.toml", str(tmp_path / "arm.xml")
    done = RUN.invoke(app, ["robot", model, "--palm", "tip", "--out", str(card)])
    assert done.exit_code == 0, done.output
    assert 'palm = "tip"' in card.read_text()
    done = RUN.invoke(app, ["robot", str(card), "--draws", "2", "--json"])
    assert json.loads(done.stdout)["faults"] == []
    again = RUN.invoke(app, ["robot", model, "--palm", "tip", "--out", str(card)])
    assert isinstance(again.exception, StorageError)
    misplaced = RUN.invoke(app, ["robot", str(card), "--palm", "tip"])
    assert isinstance(misplaced.exception, ConfigError)


def test_a_report_that_finds_faults_says_them_and_fails(tmp_path):
    (tmp_path / "arm.xml").write_text(text(kp="4"))
    card = tmp_path / "arm.toml"
    RUN.invoke(app, ["robot", str(tmp_path / "arm.xml"), "--palm", "tip", "--out", str(card)])
    card.write_text(card.read_text().replace("\na = 0.0", "\na = 1.2"))
    done = RUN.invoke(app, ["robot", str(card), "--json"])
    assert done.exit_code == 1
    assert "joint 'a' was asked to be at 1.200 rad" in " ".join(json.loads(done.stdout)["faults"])


@pytest.mark.parametrize("policy", ["expert", "still", "pretrained"])
def test_coordlogs_own_policies_act_in_no_other_environment(policy, tmp_path):
    done = RUN.invoke(
        app, ["record", "--env", "Reacher-v5", "--policy", policy, "--out", str(tmp_path / "l")]
    )
    assert isinstance(done.exception, ConfigError)
    assert f"--policy {policy}: acts in coordlog's scenes alone" in str(done.exception)


def test_an_environment_that_is_not_there_is_named(tmp_path):
    pytest.importorskip("gymnasium")
    done = RUN.invoke(app, ["record", "--env", "Nowhere-v0", "--out", str(tmp_path / "l")])
    assert "Gymnasium cannot make it" in str(done.exception)
