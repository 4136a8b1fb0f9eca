"""coordlog: robot episodes that are never lost, never silently wrong, and always replayable.

>>> import coordlog
>>> for episode in coordlog.open("logs/"):  # doctest: +SKIP
...     print(episode.header.episode["scene"], len(episode), episode.result.clean)
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from coordlog.version import __version__

_HOMES = {
    "Dataset": "coordlog.record.dataset",
    "Episode": "coordlog.episode",
    "GymEnv": "coordlog.sim.gym",
    "open": "coordlog.record.dataset",
    "smooth": "coordlog.smooth",
    "to_rerun": "coordlog.view",
}

__all__ = ["Dataset", "Episode", "GymEnv", "__version__", "open", "smooth", "to_rerun"]


def __getattr__(name: str) -> Any:
    """Load a public name when it is first asked for, so that `import coordlog` stays light."""
    if name not in _HOMES:
        raise AttributeError(f"module 'coordlog' has no attribute '{name}'")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return __all__
