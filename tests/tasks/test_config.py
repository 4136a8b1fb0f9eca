"""Constants that cannot work are refused by name, and constants survive the way into a log and
back."""

import json
import math

import pytest

from coordlog.config import build, plain
from coordlog.errors import ConfigError
from coordlog.tasks.config import EnvConfig, RewardConfig


@pytest.mark.parametrize(
    "name", ["control_period", "speed", "shared_speed", "goal_radius", "boundary_radius", "tilt"]
)
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan])
def test_what_must_be_positive_is(name, value):
    with pytest.raises(ConfigError, match=f"{name}: expected a positive number, got {value}"):
        EnvConfig(**{name: value})


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"smoothing": 1.0}, "smoothing: expected a number from 0 to below 1, got 1.0"),
        ({"smoothing": -0.1}, "smoothing: expected"),
        ({"max_steps": 0}, "max_steps: expected at least 1, got 0"),
        ({"balance": "zmp"}, r"unknown balance criterion 'zmp'; choose one of: com, com\+zmp"),
        (
            {"state_extras": ("torque",)},
            "unknown state extra 'torque'; choose one of: com, difference, nearness, velocity",
        ),
    ],
)
def test_other_values_out_of_range_are_refused(values, message):
    with pytest.raises(ConfigError, match=message):
        EnvConfig(**values)


def test_the_control_period_is_a_whole_number_of_timesteps():
    assert EnvConfig(control_period=0.04).substeps(0.004) == 10
    assert EnvConfig(control_period=0.02).substeps(0.002) == 10
    with pytest.raises(
        ConfigError, match=r"expected a multiple of the model's timestep 0.004 s, got 0.03 s"
    ):
        EnvConfig(control_period=0.03).substeps(0.004)
    with pytest.raises(ConfigError, match="expected a multiple"):
        EnvConfig(control_period=0.001).substeps(0.004)


@pytest.mark.parametrize(
    "config", [EnvConfig(), EnvConfig(state_extras=("velocity",), speed=0.5), RewardConfig(kappa=7)]
)
def test_a_config_survives_json(config):
    assert build(type(config), json.loads(json.dumps(plain(config)))) == config


def test_an_unknown_key_lists_the_choices():
    with pytest.raises(
        ConfigError, match=r"unknown EnvConfig key 'sped'; choose one of: balance, .*speed"
    ):
        build(EnvConfig, {"sped": 1.0})
    with pytest.raises(
        ConfigError,
        match="unknown RewardConfig key 'beta'; choose one of: alpha, kappa, m1, m2, n1, n2",
    ):
        build(RewardConfig, {"beta": 1.0})


def test_a_wrong_value_in_a_mapping_is_refused_as_anywhere():
    with pytest.raises(ConfigError, match="speed: expected a positive number"):
        build(EnvConfig, {"speed": -1})


def test_max_step_is_the_papers():
    assert EnvConfig().max_steps == 150
