"""coordlog: robot episodes that are never lost, never silently wrong, and always replayable.

Verbs do what the commands of the same name do; nouns are what they take and return.

Example:
    >>> import coordlog
    >>> coordlog.record("table", episodes=64, out="logs")  # doctest: +SKIP
    >>> for episode in coordlog.open("logs"):  # doctest: +SKIP
    ...     print(episode.header.episode["scene"], len(episode), episode.result.clean)
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from coordlog.version import __version__

_HOMES = {
    "BatchEnv": "coordlog.sim.env",
    "CoordlogError": "coordlog.errors",
    "Dataset": "coordlog.record.dataset",
    "Episode": "coordlog.episode",
    "GymEnv": "coordlog.sim.gym",
    "Monitor": "coordlog.monitor",
    "Path": "coordlog.path",
    "Policy": "coordlog.contracts",
    "Problem": "coordlog.contracts",
    "Recorder": "coordlog.record.foreign",
    "Recording": "coordlog.record.recording",
    "Robot": "coordlog.robots.robot",
    "Scene": "coordlog.tasks.scene",
    "SceneChecker": "coordlog.kinematics.clearance",
    "Task": "coordlog.contracts",
    "check": "coordlog.api",
    "errors": "",
    "evaluate": "coordlog.sim.scoring",
    "export": "coordlog.api",
    "figures": "coordlog.sim.scoring",
    "make_env": "coordlog.sim.making",
    "make_policy": "coordlog.policies.registry",
    "open": "coordlog.api",
    "record": "",
    "recording": "coordlog.record.foreign",
    "rollout": "coordlog.sim.rollout",
    "smooth": "",
    "to_rerun": "coordlog.view.recording",
    "train": "",
    "view": "",
}
"""Where each public name lives; "" for a module or callable package of its own."""

__all__ = [*_HOMES, "__version__"]


def __getattr__(name: str) -> Any:
    """Load a public name when it is first asked for, so that `import coordlog` stays light."""
    if name not in _HOMES:
        raise AttributeError(f"module 'coordlog' has no attribute '{name}'")
    home = _HOMES[name]
    return getattr(import_module(home), name) if home else import_module(f"coordlog.{name}")


def __dir__() -> list[str]:
    return sorted(__all__)
