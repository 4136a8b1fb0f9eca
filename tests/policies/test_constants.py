"""Constants of scripted policies: settable by name, logged with every episode, refused by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import coordlog
from coordlog.config import plain
from coordlog.errors import ConfigError
from coordlog.policies.avoidance import DamperConfig
from coordlog.policies.expert import ExpertConfig
from coordlog.policies.noise import RandomConfig
from coordlog.policies.registry import make_policy
from coordlog.policies.scripted import Constants
from coordlog.sim.env import BatchEnv
from coordlog.tasks.scene import SCENES


def recorded(out: Path, who: str, **tables: dict[str, object]) -> coordlog.Episode:
    given = {"env": {"max_steps": 4}, **tables}
    (file,) = coordlog.record("planar", who, episodes=1, out=out, tables=given)
    return coordlog.open(file)[0]


def test_constants_are_settable_and_logged(tmp_path: Path) -> None:
    plainly = recorded(tmp_path / "a", "expert")
    slower = recorded(tmp_path / "b", "expert", policy={"gain_steps": 400.0})
    assert plainly.header.policy["constants"] == plain(ExpertConfig())
    assert slower.header.policy["constants"] == plain(ExpertConfig(gain_steps=400.0))
    assert np.abs(slower.action).max() < np.abs(plainly.action).max()
    wild = recorded(tmp_path / "c", "random", policy={"sigma": 0.1})
    assert wild.header.policy["constants"] == plain(RandomConfig(sigma=0.1))
    assert np.abs(wild.action).max() < 0.6
    assert "constants" not in recorded(tmp_path / "d", "still").header.policy


def test_the_damper_is_logged_where_one_acts() -> None:
    env = BatchEnv(SCENES["spheres"], n=1, threads=1)
    given = Constants.of({"damper": {"safe": 0.05}})
    for name, shield in (("expert", False), ("random", True)):
        _, said = make_policy(name, env, shield=shield, constants=given)
        assert said["damper"] == plain(DamperConfig(safe=0.05))
    _, said = make_policy("random", env, shield=False, constants=given)
    assert "damper" not in said


@pytest.mark.parametrize(
    ("policy", "tables", "said"),
    [
        ("expert", {"policy": {"gain": 2.0}}, "policy.gain_steps"),
        ("expert", {"policy": {"arrived": 0.0}}, "arrived: expected a number above 0"),
        ("expert", {"policy": {"clearances": []}}, "expected at least one"),
        ("expert", {"policy": {"own": []}}, "own: expected at least one"),
        ("expert", {"policy": {"patience": 2.5}}, "policy.patience: expected a whole number"),
        ("expert", {"damper": {"closing": 2.0}}, "expected a share up to 1"),
        ("random", {"policy": {"correlation": 1.0}}, "a correlation in"),
        ("still", {"policy": {"sigma": 1.0}}, "the policy 'still' has no constants, got sigma"),
    ],
)
def test_what_is_no_constant_is_refused_by_name(
    policy: str, tables: dict[str, object], said: str, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=said):
        coordlog.record("planar", policy, episodes=1, out=tmp_path, tables=tables)
