"""Tests that every command takes, or refuses in one sentence, episodes that no task of ours made."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.spoken import said

ARM = """
<mujoco><option timestep="0.01"/><worldbody><body>
  <joint name="a" axis="0 0 1"/><geom size=".05" pos=".3 0 0"/>
</body></worldbody><actuator><motor joint="a"/></actuator></mujoco>"""


@pytest.fixture(scope="module", params=["observed", "environment"])
def others(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with an imported recording, or with a simulation of somebody else's."""
    import mujoco

    from coordlog.record.foreign import recording

    folder = tmp_path_factory.mktemp(request.param)
    if request.param == "observed":
        (folder / "arm.xml").write_text(ARM)
        rows = [f"{0.01 * i:.2f},{np.sin(0.05 * i):.6f}" for i in range(60)]
        (folder / "a.csv").write_text("\n".join(["time,a", *rows]))
        words = ("--out", folder / "logs", "--robot", folder / "arm.xml")
        assert said("import", folder / "a.csv", *words).exit_code == 0
        return folder / "logs"
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    with recording(model, data, folder / "logs", name="arm", source=ARM) as log:
        for i in range(20):
            data.ctrl[0] = 0.1
            mujoco.mj_step(model, data)
            log.step(data.ctrl, reward=[0.0], truncated=i == 19)
    return folder / "logs"


def test_learning_refuses_them_in_one_sentence(others: Path, tmp_path: Path) -> None:
    trained = said("train", "--from", others, "--updates", 1, "--out", tmp_path / "run")
    branched = said("record", "--scene", "planar", "--branch", others, "--out", tmp_path / "b")
    assert trained.exit_code == branched.exit_code == 2
    goals = "expected an episode with distances to goals"
    rewards = "expected rewards to learn from, got 0 at every step"
    assert (goals if "observed" in str(others) else rewards) in trained.stderr
    assert goals in branched.stderr
    assert not list(tmp_path.iterdir())


def test_smooth_takes_what_was_observed_and_names_what_it_does_not(
    others: Path, tmp_path: Path
) -> None:
    done = said("smooth", others, "--out", tmp_path / "out", "--jobs", 1)
    observed = others.parent.name.startswith("observed")
    assert done.exit_code == (0 if observed else 2)
    assert observed or "another program's environment" in done.stderr


def test_an_overview_needs_no_goals(others: Path, tmp_path: Path) -> None:
    done = said("view", others, "--save", tmp_path / "all.rrd")
    assert done.exit_code == 0, done.stderr
    assert (tmp_path / "all.rrd").stat().st_size


@pytest.mark.parametrize("name", ["export", "select", "query"])
@pytest.mark.parametrize(
    "where",
    ["true union all select 0", "true) or (true", "exists(select 1)", "length", "row >= 0", "1/0"],
)
def test_a_condition_is_one_condition_everywhere(name: str, where: str, tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    shutil.copytree(Path(__file__).parents[1] / "data" / "v2" / "planar", logs)
    words = {
        "export": ("export", logs, "--to", "csv", "--out", tmp_path / "set"),
        "select": ("select", logs, "--out", tmp_path / "a.manifest"),
        "query": ("query", "select count(*) from episodes", logs),
    }
    done = said(*words[name], "--where", where)
    assert done.exit_code == 2
    assert "error: --where: expected an SQL condition over " in done.stderr
    assert list(tmp_path.iterdir()) == [logs]
