from __future__ import annotations

import json
from dataclasses import fields, is_dataclass
from pathlib import Path

import pytest

from coordlog.config import build
from coordlog.errors import ConfigError, StorageError
from coordlog.tasks.config import TRAINING_ONLY, EnvConfig, RewardConfig
from coordlog.train import config
from coordlog.train.config import BehaviourConfig, NoiseConfig, PracticeConfig
from coordlog.train.settings import (
    AROUND,
    PRESETS,
    UNSAID,
    Settings,
    load_settings,
    override,
    refuse_changes,
    surroundings,
)


def test_the_paper_preset_is_what_the_paper_prints() -> None:
    paper = PRESETS["paper"]
    assert (paper.network.hidden, paper.network.activation, paper.network.dropout) == (
        (700, 400),
        "crelu",
        pytest.approx(1 - 0.8),
    )
    assert (paper.network.actor_norm, paper.network.critic_norm, paper.network.critics) == (
        "batch",
        "batch",
        1,
    )
    assert (paper.learner.actor_rate, paper.learner.critic_rate, paper.learner.weight_decay) == (
        1e-4,
        1e-4,
        0.01,
    )
    assert (paper.replay.capacity, paper.loop.updates_per_step, paper.loop.steps) == (
        45_000,
        1.0,
        600_000,
    )
    assert (paper.learner.gradient, paper.learner.actor_delay, paper.learner.target_noise) == (
        "mask",
        1,
        0.0,
    )


def test_a_file_overrides_the_preset_and_an_assignment_overrides_the_file(tmp_path: Path) -> None:
    path = tmp_path / "run.toml"
    path.write_text(
        '[learner]\ngamma = 0.5\ntau = 1\n[network]\nhidden = [8, 4]\nactivation = "relu"\n'
    )
    settings = load_settings(
        path, preset="paper", assignments=["learner.gamma = 0.25", "network.critic_norm=layer"]
    )
    assert (settings.learner.gamma, settings.learner.tau, settings.network.hidden) == (
        0.25,
        1.0,
        (8, 4),
    )
    assert (settings.network.critic_norm, settings.network.dropout) == ("layer", 0.2)
    assert isinstance(settings.learner.tau, float)


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        (
            "learner.gama=0.9",
            r"unknown setting 'learner\.gama'; choose one of: learner\.actor_delay, .*learner\.gamma",
        ),
        (
            "learning.gamma=0.9",
            "unknown section 'learning'; choose one of: behaviour, learner, loop, network, noise, "
            "replay",
        ),
        ("gamma=0.9", "--set: expected section.key=value, got 'gamma=0.9'"),
        ("learner.gamma", "--set: expected section.key=value"),
        ("learner.gamma=1.0", r"learner\.gamma: expected a discount in \[0, 1\), got 1.0"),
        ("learner.gamma=nan", r"learner\.gamma: expected a discount"),
        ("learner.gamma=high", r"learner\.gamma: expected a number, got 'high'"),
        ("network.hidden=[]", r"network\.hidden: expected positive layer widths"),
        ("network.hidden=[2.5]", r"network\.hidden: expected a list of whole numbers"),
        (
            "network.activation=tanh",
            r"network\.activation: expected one of relu, crelu, got 'tanh'",
        ),
        ("network.action_layer=3", r"network\.action_layer: expected 1, or 2"),
        (
            "replay.warmup=10",
            r"replay\.warmup: expected between replay\.batch and replay\.capacity, got 10",
        ),
        ("noise.final=0.9", r"noise\.final: expected a number between 0 and noise\.start"),
        ("loop.overlap=1", r"loop\.overlap: expected true or false, got 1"),
        ("loop.block=0", r"loop\.block: expected at least 1, got 0"),
        ("behaviour.weight=-1", r"behaviour\.weight: expected a number ≥ 0"),
    ],
)
def test_a_bad_assignment_is_one_clear_sentence(assignment: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_settings(assignments=[assignment])


def test_a_bad_file_or_preset_is_named(tmp_path: Path) -> None:
    path = tmp_path / "run.toml"
    path.write_text("learner = ")
    with pytest.raises(ConfigError, match="not a TOML file"):
        load_settings(path)
    path.write_text("learner = 3")
    with pytest.raises(ConfigError, match="learner: expected a table of keys, got 3"):
        load_settings(path)
    with pytest.raises(StorageError, match="cannot be read"):
        load_settings(tmp_path / "none.toml")
    with pytest.raises(
        ConfigError,
        match="unknown preset 'best'; choose one of: agile, default, environment, live, paper, "
        "quick",
    ):
        load_settings(preset="best")


@pytest.mark.parametrize("preset", PRESETS)
def test_settings_survive_json(preset: str) -> None:
    tables = json.loads(json.dumps(PRESETS[preset].asdict()))
    assert override(Settings(), tables) == PRESETS[preset]


def test_a_resumed_run_may_get_a_larger_budget_and_nothing_else() -> None:
    saved = json.loads(json.dumps(Settings().asdict()))
    refuse_changes(load_settings(assignments=["loop.updates=20000", "loop.steps=5"]), saved)
    with pytest.raises(ConfigError, match=r"resume: learner\.gamma was 0\.98 and is now 0\.9"):
        refuse_changes(load_settings(assignments=["learner.gamma=0.9"]), saved)


@pytest.mark.parametrize("preset", ["default", "paper"])
def test_a_run_of_before_there_were_some_settings_may_be_resumed(preset: str) -> None:
    saved = json.loads(json.dumps(PRESETS[preset].asdict()))
    for section, key in UNSAID:
        del saved[section][key]
    del saved["train"]
    refuse_changes(PRESETS[preset], saved)
    with pytest.raises(ConfigError, match=r"resume: replay\.cut was False and is now True"):
        refuse_changes(override(PRESETS[preset], {"replay": {"cut": True}}), saved)


def test_what_makes_training_easier_is_named_alike_in_both_places() -> None:
    names = tuple(item.name for item in fields(PracticeConfig))
    assert names == TRAINING_ONLY
    assert all(getattr(EnvConfig(), name) == getattr(PracticeConfig(), name) == 0 for name in names)


def test_a_run_of_before_the_average_cannot_be_resumed() -> None:
    saved = json.loads(json.dumps(PRESETS["default"].asdict()))
    del saved["loop"]["average"]
    with pytest.raises(ConfigError, match=r"expected a run with loop\.average, got one of before"):
        refuse_changes(PRESETS["default"], saved)


@pytest.mark.parametrize("preset", AROUND)
def test_a_presets_surroundings_are_constants_that_there_are(preset: str) -> None:
    around = surroundings(preset)
    config, reward = (
        build(EnvConfig, around["config"]),
        build(RewardConfig, around["reward"]),
    )
    gamma = PRESETS[preset].learner.gamma
    assert reward.doubts(gamma=gamma, steps=config.max_steps, farthest=0.5) == []
    assert config.max_steps * config.control_period == pytest.approx(
        EnvConfig().max_steps * EnvConfig().control_period
    )
    assert config.smoothing == pytest.approx(
        EnvConfig().smoothing ** (config.control_period / EnvConfig().control_period), abs=0.01
    )


def test_every_field_is_flat_and_few_and_documented() -> None:
    source = Path(config.__file__).read_text(encoding="utf-8").split("\n")
    for section in fields(Settings):
        names = fields(section.default_factory)  # type: ignore[arg-type]
        assert len(names) <= 12
        for item in names:
            line = next(
                number
                for number, text in enumerate(source)
                if text.startswith(f"    {item.name}: ")
            )
            assert source[line + 1].startswith('    """'), item.name
            assert not is_dataclass(item.type)


def test_schedules_start_and_end_where_they_say() -> None:
    noise = NoiseConfig(start=0.5, final=0.1, decay=0.5)
    assert [noise.at(progress) for progress in (0, 0.25, 0.5, 1)] == pytest.approx(
        [0.5, 0.3, 0.1, 0.1]
    )
    behaviour = BehaviourConfig(weight=2, final=1)
    assert [behaviour.at(progress) for progress in (0, 0.5, 1)] == [2, 1.5, 1]
    fading = BehaviourConfig(weight=8, final=0.5, schedule="geometric")
    assert [fading.at(progress) for progress in (0, 0.25, 0.5, 0.75, 1)] == pytest.approx(
        [8, 4, 2, 1, 0.5]
    )
    with pytest.raises(
        ConfigError, match=r"behaviour\.schedule: expected linear where weight or final is 0"
    ):
        BehaviourConfig(weight=1, final=0, schedule="geometric")
