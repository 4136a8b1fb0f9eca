"""The policies that come without training, by name, and a shield and noise around any policy."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from coordlog.config import build, plain
from coordlog.contracts import Policy
from coordlog.episode import Json
from coordlog.errors import ConfigError, unknown
from coordlog.policies.avoidance import DamperConfig
from coordlog.policies.damper import Shielded
from coordlog.policies.expert import Expert, ExpertConfig
from coordlog.policies.noise import Noisy, Random, RandomConfig, Still
from coordlog.sim.env import BatchEnv

CONSTANTS: dict[str, type[ExpertConfig] | type[RandomConfig] | None] = {
    "expert": ExpertConfig,
    "random": RandomConfig,
    "still": None,
}
"""The scripted policies by name, and what their constants are, if they have any."""
SCRIPTED = tuple(CONSTANTS)
SHIELD = "velocity damper"
"""What the `coordlog.policy` record calls the shield."""
TABLES = ("policy", "damper")
"""Tables of a configuration file that policies take their constants from."""


class Constants(NamedTuple):
    """What scripts are given besides the scene."""

    policy: Mapping[str, Any] = MappingProxyType({})
    """Constants of the policy by name, in place of its own."""
    damper: DamperConfig = DamperConfig()

    @classmethod
    def of(cls, tables: Mapping[str, Any]) -> Constants:
        """From the tables of a configuration file; others than TABLES are not looked at.

        Raises:
            ConfigError: for an unknown constant of the damper, or a value out of range.
        """
        damper = build(DamperConfig, tables.get("damper", {}), prefix="damper.")
        return cls(tables.get("policy", {}), damper)


def scripted(name: str, env: BatchEnv, constants: Constants | None = None) -> Policy:
    """A policy for every simulation of `env`.

    Raises:
        ConfigError: for an unknown name or constant; the message lists the choices.
    """
    given = constants or Constants()
    config = configured(name, given)
    if isinstance(config, ExpertConfig):
        return Expert(env.task, env.draw.reach, env.n, config=config, damper=given.damper)
    if isinstance(config, RandomConfig):
        return Random(env.n, env.layout.n_u, config)
    return Still(env.layout.n_u)


def configured(name: str, constants: Constants) -> ExpertConfig | RandomConfig | None:
    """The constants of a scripted policy; None for one that has none.

    Raises:
        ConfigError: for an unknown name or constant, or a value out of range.
    """
    if name not in CONSTANTS:
        raise unknown("policy", name, SCRIPTED)
    kind = CONSTANTS[name]
    if kind is None:
        require_none(constants, name)
        return None
    return build(kind, constants.policy, prefix="policy.")


def described(name: str, env: BatchEnv, constants: Constants) -> Json:
    """What the log states of a scripted policy's constants."""
    config = configured(name, constants)
    said: Json = {} if config is None else {"constants": plain(config)}
    if isinstance(config, ExpertConfig) and env.task.n_spheres:
        said["damper"] = plain(constants.damper)
    return said


def require_none(constants: Constants, name: str) -> None:
    """Refuse constants for a policy that has none.

    Raises:
        ConfigError: if there are some.
    """
    if constants.policy:
        got = ", ".join(constants.policy)
        raise ConfigError(f"[policy]: the policy '{name}' has no constants, got {got}")


def with_noise(
    policy: Policy, env: BatchEnv, *, sigma: float, correlation: float
) -> tuple[Policy, Json]:
    """The policy with action noise, and the noise as the log will state it ({} for none).

    Raises:
        ConfigError: if sigma is negative or the correlation not in [0, 1).
    """
    if sigma < 0 or not 0 <= correlation < 1:
        raise ConfigError(
            "noise: expected a standard deviation ≥ 0 and a correlation in [0, 1), "
            f"got {sigma} and {correlation}"
        )
    if sigma == 0:
        return policy, {}
    noisy = Noisy(policy, env.n, env.layout.n_u, sigma=sigma, correlation=correlation)
    return noisy, {"kind": "gaussian", "sigma": sigma, "correlation": correlation}


def with_shield(policy: Policy, env: BatchEnv, config: DamperConfig | None = None) -> Policy:
    """The policy, kept from running its forearms into spheres.

    Raises:
        ConfigError: if there is no sphere to be shielded from.
    """
    if env.task.n_spheres == 0:
        raise ConfigError(
            f"--shield: expected a scene with spheres, got '{env.scene.name}', which has none; "
            "leave it out"
        )
    return Shielded(policy, env.task, env.draw.reach, config or DamperConfig())


def shield_said(config: DamperConfig) -> Json:
    """What the log states of a shield."""
    return {"shield": SHIELD, "damper": plain(config)}
