"""`check` says of an observed episode what it looked at, and never that it is sound."""

import numpy as np
import pytest
from typer.testing import CliRunner

from coordlog.cli import app
from coordlog.exchange.importing import Plan, import_source
from coordlog.exchange.robot_model import read_model
from coordlog.record.recording import Recording
from coordlog.verify.observed import judged
from tests.exchange.test_import import ARM


@pytest.fixture
def imported(tmp_path):
    """An episode of an arm that reaches into the floor, and beyond the range of its elbow."""
    (tmp_path / "arm.xml").write_text(ARM)
    angles = np.linspace(0, 1.3, 14)
    rows = [f"{i / 10},{angle},{2 * angle + 0.1},0" for i, angle in enumerate(angles)]
    text = "time,shoulder,elbow,wrist\n" + "\n".join(rows) + "\n"
    (tmp_path / "x.csv").write_text(text)

    def get(robot=True):
        model = read_model(str(tmp_path / "arm.xml")) if robot else None
        return import_source(tmp_path / "x.csv", tmp_path / "logs", Plan(), model).paths[0]

    return get


def test_limits_speeds_and_contact_are_told(imported):
    said = judged(Recording(imported()))
    assert "fastest elbow, 2/s at sample" in said
    assert "elbow outside its range at 1 samples, by 0.082" in said
    assert " of 14 samples, deepest" in said
    assert said.endswith("physics, torques and balance cannot be proven")


def test_without_a_model_there_is_less_to_tell(imported):
    assert "without a model: no limits, no contact" in judged(Recording(imported(robot=False)))


def test_a_simulated_episode_is_none_of_its_business(file):
    assert judged(Recording(file)) == ""


def test_check_does_not_call_it_sound(imported):
    done = CliRunner().invoke(app, ["check", str(imported())])
    assert done.exit_code == 0, done.output
    assert "all sound" not in done.output
    assert "1 observed, whose physics nobody can prove" in done.stdout
