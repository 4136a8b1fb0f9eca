"""All sections of a run as one `Settings`: from a preset, then the tables of a TOML file, then
`section.key=value` overrides.

An unknown preset, section or key is an error that lists the known ones.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from coordlog.config import change, parse_assignment, plain
from coordlog.errors import ConfigError, StorageError, unknown
from coordlog.train.config import (
    BehaviourConfig,
    LearnerConfig,
    LoopConfig,
    NetworkConfig,
    NoiseConfig,
    PracticeConfig,
    ReplayConfig,
)

BUDGET = (("loop", "updates"), ("loop", "steps"))
"""Settings that a resumed run may change."""


@dataclass(frozen=True)
class Settings:
    """All sections of one run; `asdict` makes it JSON."""

    network: NetworkConfig = field(default_factory=NetworkConfig)
    learner: LearnerConfig = field(default_factory=LearnerConfig)
    behaviour: BehaviourConfig = field(default_factory=BehaviourConfig)
    noise: NoiseConfig = field(default_factory=NoiseConfig)
    replay: ReplayConfig = field(default_factory=ReplayConfig)
    loop: LoopConfig = field(default_factory=LoopConfig)
    train: PracticeConfig = field(default_factory=PracticeConfig)

    def asdict(self) -> dict[str, dict[str, Any]]:
        """The settings as nested JSON-able dictionaries."""
        return {item.name: plain(getattr(self, item.name)) for item in fields(self)}


PRESETS: dict[str, Settings] = {
    "default": Settings(),
    # From logs alone, in about a minute: ten steps of imitation for one of a critic, and rates that
    # fall to a twentieth, since what is imitated is noisy.
    "quick": Settings(
        learner=LearnerConfig(actor_rate=2e-3),
        behaviour=BehaviourConfig(final=20.0, extra=9),
        loop=LoopConfig(updates=500, final_rate=0.05, evaluate_every=250),
    ),
    # Live, from scratch, in any scene: actions that last long enough for a critic to see what they
    # are worth, imitation that leaves room for what is learnt from values, and starts all over the
    # place, so that the way around something is found from its end.
    "live": Settings(
        network=NetworkConfig(ascent="mean"),
        behaviour=BehaviourConfig(weight=5.0, final=0.5, schedule="geometric", effort=0.01),
        noise=NoiseConfig(start=0.5, final=0.07, decay=0.5, correlation=0.7),
        replay=ReplayConfig(
            batch=128, warmup=3_000, hindsight=0.7, horizon=8, far=0.3, n_step=3, cut=True
        ),
        loop=LoopConfig(
            updates=0,
            steps=130_000,
            updates_per_step=0.3,
            final_rate=0.3,
            evaluate_every=3_000,
            checkpoint_every=3_000,
        ),
        train=PracticeConfig(start_line=0.2, start_random=0.3, start_solved=0.25, inflate=0.005),
    ),
    # From logs of an environment that is not ours: pulled as strongly as TD3+BC (Fujimoto and Gu
    # 2021), so that what was done can be bettered.
    "environment": Settings(
        learner=LearnerConfig(actor_rate=3e-4, critic_rate=3e-4, actor_delay=2, gamma=0.99),
        behaviour=BehaviourConfig(weight=1.0, final=1.0, effort=0.0),
        replay=ReplayConfig(n_step=1),
        loop=LoopConfig(updates=5_000),
    ),
    # As printed in §V-B; what the paper leaves open follows DDPG (γ, τ, batch, where the action
    # enters) or is our choice (noise).
    "paper": Settings(
        network=NetworkConfig(
            hidden=(700, 400),
            activation="crelu",
            actor_norm="batch",
            critic_norm="batch",
            dropout=0.2,
            critics=1,
            action_layer=2,
        ),
        learner=LearnerConfig(
            gamma=0.99,
            tau=0.001,
            actor_rate=1e-4,
            critic_rate=1e-4,
            weight_decay=0.01,
            actor_delay=1,
            target_noise=0.0,
            clip_targets=False,
            reward_scale=1.0,
            normalise=False,
        ),
        behaviour=BehaviourConfig(weight=0.0, final=0.0, effort=0.0),
        noise=NoiseConfig(start=0.3, final=0.02, decay=0.6, correlation=0.0),
        replay=ReplayConfig(
            batch=64,
            capacity=45_000,
            warmup=64,
            hindsight=0.0,
            imitation=0.0,
            n_step=1,
            reorder=False,
        ),
        loop=LoopConfig(updates=0, steps=600_000, updates_per_step=1.0, block=1, average=0.0),
    ),
}

# As `live`, for obstacles that stand elsewhere in every episode: no way around is learnt once and
# for all, so decisions are half as long, most starts are the test's own, and the margin is larger.
PRESETS["agile"] = replace(
    PRESETS["live"],
    replay=replace(PRESETS["live"].replay, horizon=14),
    loop=replace(PRESETS["live"].loop, steps=300_000, updates_per_step=0.3, final_rate=0.05),
    train=replace(PRESETS["live"].train, start_solved=0.0, inflate=0.01),
)

AROUND: dict[str, dict[str, dict[str, Any]]] = {
    # 8 decisions a second, the command filter and the length of an episode the same in seconds as
    # at 25.
    "live": {
        "env": {"control_period": 0.12, "max_steps": 50, "smoothing": 0.35},
        "reward": {"n1": 5.0, "n2": 20.0},
    },
    # 17 decisions a second; a touch costs more than the longest way round: at 2.5 a decision it
    # cost about as much, and was learnt.
    "agile": {
        "env": {"control_period": 0.06, "max_steps": 100, "smoothing": 0.585},
        "reward": {"n1": 8.0, "n2": 25.0},
    },
}
"""What a preset asks of the environment and its reward, where no logs say otherwise."""
UNSAID: dict[tuple[str, str], object] = {
    (section, key): getattr(getattr(PRESETS["default"], section), key)
    for section, keys in {
        "network": ("ascent",),
        "loop": ("final_rate",),
        "behaviour": ("schedule", "extra"),
        "replay": ("far", "cut"),
        "train": ("start_line", "start_random", "start_solved", "inflate"),
    }.items()
    for key in keys
}
"""What a run did that was saved before these settings were."""


def surroundings(preset: str) -> dict[str, dict[str, Any]]:
    """What a preset asks of the environment, as the entries "config" and "reward" of a
    `coordlog.env` record.
    """
    around = AROUND.get(preset, {})
    return {"config": dict(around.get("env", {})), "reward": dict(around.get("reward", {}))}


def override(settings: Settings, tables: Mapping[str, Mapping[str, object]]) -> Settings:
    """Settings with the values of `tables` ({section: {key: value}}) in place of theirs.

    Raises:
        ConfigError: for a section or key that does not exist (the message lists those that do), a
            wrong type or range.
    """
    sections = {item.name: getattr(settings, item.name) for item in fields(settings)}
    for name, table in tables.items():
        if name not in sections:
            raise unknown("section", name, sections)
        sections[name] = change(sections[name], table, prefix=f"{name}.", what="setting")
    return Settings(**sections)


def refuse_changes(settings: Settings, saved: Mapping[str, Mapping[str, object]]) -> None:
    """Raise ConfigError unless a resumed run's settings are those it was saved with.

    Its budget may be another.
    """
    for section, values in settings.asdict().items():
        for key, value in values.items():
            before = saved.get(section, {}).get(key, UNSAID.get((section, key)))
            if before is None:
                raise ConfigError(
                    f"resume: expected a run with {section}.{key}, got one of before there was "
                    "that; begin another"
                )
            if before != value and (section, key) not in BUDGET:
                raise ConfigError(
                    f"resume: {section}.{key} was {before!r} and is now {value!r}; resume with the "
                    "run's own settings"
                )


def load_settings(
    path: Path | None = None,
    *,
    preset: str = "default",
    tables: Mapping[str, Mapping[str, object]] | None = None,
    assignments: Sequence[str] = (),
) -> Settings:
    """Settings of a preset, overridden by a TOML file, overridden by tables, overridden by
    assignments.

    Args:
        path: TOML file with one table per section, or None.
        preset: Name of the preset to start from.
        tables: {section: {key: value}} that were read elsewhere.
        assignments: "section.key=value" each, the last one wins.

    Raises:
        ConfigError: for anything unknown or out of range, or a file that is not TOML.
        StorageError: if the file cannot be read.
    """
    if preset not in PRESETS:
        raise unknown("preset", preset, PRESETS)
    settings = PRESETS[preset]
    if path is not None:
        try:
            settings = override(settings, tomllib.loads(path.read_text(encoding="utf-8")))
        except tomllib.TOMLDecodeError as error:
            raise ConfigError(f"{path} is not a TOML file: {error}") from error
        except OSError as error:
            raise StorageError(f"{path} cannot be read: {error.strerror}") from error
    settings = override(settings, tables or {})
    assigned: dict[str, dict[str, object]] = {}
    for section, key, value in map(parse_assignment, assignments):
        assigned.setdefault(section, {})[key] = value
    return override(settings, assigned)
