"""What is measured about a policy: distances to obstacles, figures of scores, a whole row."""

from __future__ import annotations

import json
import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

from coordlog.sim.env import BatchEnv
from coordlog.sim.scoring import Score
from coordlog.tasks.scene import find
from experiments import evaluate
from experiments.measure import Run, figures
from experiments.nearest import FAR, Nearest


def started(scene: str, n: int = 2) -> BatchEnv:
    env = BatchEnv(find(scene), n=n, threads=1)
    env.reset(np.arange(n), [env.problem(seed=3, split="test", index=index) for index in range(n)])
    return env


@pytest.mark.parametrize("scene", ["spheres", "table", "shelf"])
def test_the_nearest_pair_is_the_nearest_of_all_pairs(scene: str) -> None:
    env = started(scene)
    nearest = Nearest(env)
    for sim in range(env.n):
        model, data = env.physics.model_of(sim), mujoco.MjData(env.task.model)
        data.qpos[:], data.mocap_pos[:] = env.physics.qpos[sim], env.physics.mocap_pos[sim]
        mujoco.mj_kinematics(model, data)
        names = [model.geom(i).name for i in range(model.ngeom)]
        solid = [
            i for i, name in enumerate(names) if name.startswith(("sphere_", "table", "shelf"))
        ]
        robot = [
            i
            for i, name in enumerate(names)
            if (name[-2:] in ("_0", "_1") and not name.startswith("sphere_"))
            or name.endswith("_sole")
        ]
        least = min(
            mujoco.mj_geomDistance(model, data, i, j, FAR, None) for i in robot for j in solid
        )
        assert nearest.of(sim) == pytest.approx(least, abs=1e-12)
        assert 0.0 < least < 0.5


def test_a_sphere_inside_the_robot_is_at_a_negative_distance() -> None:
    env = started("spheres", n=1)
    nearest = Nearest(env)
    head = env.task.model.body("head").id
    data = mujoco.MjData(env.task.model)
    data.qpos[:] = env.physics.qpos[0]
    mujoco.mj_kinematics(env.task.model, data)
    env.physics.mocap_pos[0, env.task.sphere_mocaps[0]] = data.xipos[head]
    assert nearest.of(0) < -0.02


def test_nothing_is_near_where_nothing_stands() -> None:
    assert not Nearest(BatchEnv(find("free"), n=1, threads=1)).known


def score(
    *,
    success: bool = True,
    collided: bool = False,
    fell: bool = False,
    diverged: bool = False,
    late: int = 4,
) -> Score:
    clean = success and not collided and not fell
    return Score(
        100 + late, success, clean, collided, fell, (0.01, 0.02), (100, 100 + late), diverged
    )


def test_figures_count_every_episode_and_leave_divergence_out_of_no_rate() -> None:
    scores = [
        score(),
        score(collided=True, late=8),
        score(success=False, fell=True),
        score(success=False, diverged=True),
    ]
    found = figures(Run(scores, [0.01, -0.002, 0.03, math.inf]))
    assert [found[name]["count"] for name in ("success", "clean", "collisions", "falls")] == [
        2,
        1,
        1,
        1,
    ]
    assert found["success"]["of"] == 4
    assert found["diverged"] == 1
    assert found["error"] == {"median": pytest.approx(0.03), "p95": pytest.approx(0.03)}
    assert found["score"]["mean"] == pytest.approx(-math.log(0.03))
    assert found["clearance"]["least"] == -0.002
    assert found["apart"]["median"] == 6.0
    assert found["steps"]["median"] == 106.0


def test_a_row_is_measured_and_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    evaluate.main(["shipped", "table", "pretrained", "--episodes", "3", "--out", str(tmp_path)])
    table = json.loads((tmp_path / "table-shipped.json").read_text(encoding="utf-8"))
    assert table["3 cm"]["success"]["count"] == 3
    assert table["3 cm"]["error"]["p95"] < 0.06
    assert table["2 cm"]["error"]["p95"] < 0.04
    assert table["2 cm"]["steps"]["median"] > table["3 cm"]["steps"]["median"]
    assert 0.0 < table["3 cm"]["clearance"]["least"] < 0.2
    assert table["decision"]["act"]["median"] > 0.0
    assert table["policy"]["kind"] == "digrad"
    assert "table-shipped.json" in capsys.readouterr().out


def test_bad_input_is_one_sentence() -> None:
    with pytest.raises(SystemExit, match="expected a policy file or a run folder"):
        evaluate.main(["shipped", "table", "runs/none", "--episodes", "1"])
