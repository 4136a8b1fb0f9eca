"""The policies that ship: found, small, without code in them, in the wheel, and acting in the
environment they were trained in."""

from __future__ import annotations

import hashlib
import json
import zipfile
from pathlib import Path

import pytest
from hatchling.builders.wheel import WheelBuilder
from safetensors import safe_open

from coordlog.errors import ConfigError, SpecError
from coordlog.policies.damper import Shielded
from coordlog.policies.learned import Policy
from coordlog.policies.registry import SHIPPED, make_policy, policy_file, pretrained
from coordlog.sim.making import make_env
from coordlog.sim.scoring import evaluate
from coordlog.tasks.config import TRAINING_ONLY

FILES = sorted(SHIPPED.glob("*.safetensors"))


def test_there_are_some() -> None:
    assert {"table", "shelf"} <= {path.stem for path in FILES}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_shipped_policy_is_small_and_has_a_card_that_is_its_own(path: Path) -> None:
    card = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
    assert path.stat().st_size == card["bytes"] <= 1_000_000
    assert hashlib.sha256(path.read_bytes()).hexdigest() == card["sha256"]
    with safe_open(path, framework="numpy") as file:
        assert file.metadata()["kind"] == "coordlog policy"
    said = Policy.load(path).about
    training = card["training"]
    kind = card.get("kind", "")
    assert said["scene"] == card["scene"]
    assert path.stem == card["scene"] + (f"-{kind}" if kind else "")
    assert kind != "live" or said["mode"] == "live"
    assert card["shield"] == (path.stem == "spheres")
    assert training["command"].startswith("coordlog train ")
    assert training["logs_sha256"] == said["data"]
    assert (training["seed"], training["cost"]["updates"]) == (said["seed"], said["updates"])
    assert training["cost"]["seconds"] > 0
    assert training["versions"]["torch"]


def test_the_wheel_carries_them(tmp_path: Path) -> None:
    (wheel,) = WheelBuilder(str(Path(__file__).parents[2])).build(
        directory=str(tmp_path), versions=["standard"]
    )
    names = zipfile.ZipFile(wheel).namelist()
    for path in FILES:
        assert {f"coordlog/policies/{path.name}", f"coordlog/policies/{path.stem}.json"} <= set(
            names
        )
    assert not [
        name
        for name in names
        if name.endswith((".pt", ".pth", ".pkl", ".zip")) or name.startswith(("results", "tests"))
    ]


def test_pretrained_means_the_scenes_own_and_says_so_in_the_log() -> None:
    env = make_env("shelf", {}, start="stand", envs=2, threads=1)
    policy, said = make_policy("pretrained", env)
    assert said == {
        "kind": "digrad",
        "name": "pretrained/shelf",
        "checkpoint_sha256": hashlib.sha256(pretrained("shelf").read_bytes()).hexdigest(),
    }
    assert all(score.clean for score in evaluate(env, policy, episodes=2, k=2, seed=1))


@pytest.mark.parametrize(
    ("shield", "wanted"), [(None, "velocity damper"), (True, "velocity damper"), (False, None)]
)
def test_a_policy_that_ships_with_a_shield_acts_behind_it_unless_told_otherwise(
    shield: bool | None, wanted: str | None
) -> None:
    env = make_env("spheres", {}, start="stand", envs=1, threads=1)
    policy, said = make_policy("pretrained", env, shield=shield)
    assert said.get("shield") == wanted
    assert isinstance(policy, Shielded) == (wanted is not None)
    own, said = make_policy(str(pretrained("spheres")), env)
    assert isinstance(own, Policy), "a card belongs to the name, not to the file"
    assert "shield" not in said


def test_a_shield_needs_something_to_be_shielded_from() -> None:
    env = make_env("free", {}, start="stand", envs=1, threads=1)
    with pytest.raises(ConfigError, match="expected a scene with spheres, got 'free'"):
        make_policy("pretrained", env, shield=True)


def test_where_none_ships_the_choices_are_listed() -> None:
    with pytest.raises(
        ConfigError, match=r"no policy ships for scene 'planar'; one does for: .*shelf, .*table"
    ):
        policy_file("pretrained", "planar")


def test_a_policy_of_another_layout_is_refused() -> None:
    env = make_env("table", {"env": {"state_extras": []}}, start="stand", envs=1, threads=1)
    with pytest.raises(SpecError, match="its state is not that of scene 'table'"):
        make_policy("pretrained", env)


def test_what_learnt_live_is_asked_for_by_its_kind() -> None:
    with pytest.raises(ConfigError, match="no live policy ships for scene 'planar'; one does for"):
        policy_file("pretrained:live", "planar")
    with pytest.raises(
        ConfigError, match="unknown policy 'pretrained:alive'; choose one of: pretrained, pretr"
    ):
        policy_file("pretrained:alive", "table")
    assert policy_file("pretrained:live", "free") == pretrained("free"), "it learnt live anyway"
    live = [path for path in FILES if path.stem.endswith("-live")]
    assert live
    for path in live:
        scene = path.stem.removesuffix("-live")
        assert policy_file("pretrained:live", scene) == path
        assert policy_file("pretrained", scene) != path
        config = Policy.load(path).about["env"]["config"]
        assert {config.get(name, 0.0) for name in TRAINING_ONLY} == {0.0}, "of the true scene alone"
        env = make_env(scene, {"env": config}, start="stand", envs=2, threads=1)
        policy, said = make_policy("pretrained:live", env)
        assert said["name"] == f"pretrained/{path.stem}"
        scores = evaluate(env, policy, episodes=4, k=2, seed=1)
        assert sum(score.success for score in scores) >= 3
