"""The policies that come without training, by name, and a shield and noise around any policy."""

from __future__ import annotations

from coordlog.contracts import Policy
from coordlog.episode import Json
from coordlog.errors import ConfigError, unknown
from coordlog.policies.damper import Shielded
from coordlog.policies.expert import Expert
from coordlog.policies.noise import Noisy, Random, Still
from coordlog.sim.env import BatchEnv

SCRIPTED = ("expert", "random", "still")


def scripted(name: str, env: BatchEnv) -> Policy:
    """A policy for every simulation of `env`.

    Raises:
        ConfigError: for an unknown name; the message lists the choices.
    """
    n_u = env.layout.n_u
    if name == "expert":
        return Expert(env.task, env.draw.reach, env.n)
    if name == "random":
        return Random(env.n, n_u)
    if name == "still":
        return Still(n_u)
    raise unknown("policy", name, SCRIPTED)


def with_noise(
    policy: Policy, env: BatchEnv, *, sigma: float, correlation: float
) -> tuple[Policy, Json]:
    """The policy with action noise, and the noise as the log will state it ({} for none).

    Raises:
        ConfigError: if sigma is negative or the correlation not in [0, 1).
    """
    if sigma < 0 or not 0 <= correlation < 1:
        raise ConfigError(
            f"noise: expected a standard deviation ≥ 0 and a correlation in [0, 1), got {sigma} and {correlation}"
        )
    if sigma == 0:
        return policy, {}
    noisy = Noisy(policy, env.n, env.layout.n_u, sigma=sigma, correlation=correlation)
    return noisy, {"kind": "gaussian", "sigma": sigma, "correlation": correlation}


def with_shield(policy: Policy, env: BatchEnv) -> Policy:
    """The policy, kept from running its forearms into spheres.

    Raises:
        ConfigError: if there is no sphere to be shielded from.
    """
    if env.task.n_spheres == 0:
        raise ConfigError(
            f"--shield: expected a scene with spheres, got '{env.scene.name}', which has none; leave it out"
        )
    return Shielded(policy, env.task, env.draw.reach)
