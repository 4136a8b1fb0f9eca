"""A MuJoCo simulation that somebody else steps, seen while it runs.

While one is watched, `mujoco.mj_step` and `mujoco.mj_step2` are wrapped: the full state is read
before each call that is made on it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

import mujoco
import numpy as np

from coordlog.episode import Array

STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
STEPPERS = ("mj_step", "mj_step2")
"""Functions of MuJoCo's that move a simulation on; whoever imported one by its own name before is
not seen, and followed by its states alone."""

_watched: dict[int, Watch] = {}
_own = {name: getattr(mujoco, name) for name in STEPPERS}
STEP = _own["mj_step"]
"""MuJoCo's own, which nobody watches."""


def _watching(stepper: Callable[..., None]) -> Callable[..., None]:
    @wraps(stepper)
    def step(m: mujoco.MjModel, d: mujoco.MjData, *args: Any, **options: Any) -> None:
        watch = _watched.get(getattr(d, "_address", 0))
        if watch is not None:
            watch.mark()
        stepper(m, d, *args, **options)

    return step


class Watch:
    """Keeps the full state of one simulation before every call that moves it on.

    Example:
        >>> watch = Watch(model, data)                          # doctest: +SKIP
        >>> mujoco.mj_step(model, data, 5)                      # doctest: +SKIP
        >>> len(watch.taken())                                  # doctest: +SKIP
        1
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._model, self._data, self._rows = model, data, list[Array]()
        self._size = mujoco.mj_stateSize(model, STATE)
        if not _watched:
            for name, stepper in _own.items():
                setattr(mujoco, name, _watching(stepper))
        _watched[data._address] = self

    def mark(self) -> None:
        """Keep the state as it is now."""
        row = np.empty(self._size)
        mujoco.mj_getState(self._model, self._data, row, STATE)
        self._rows.append(row)

    def taken(self) -> list[Array]:
        """The states since the last call."""
        rows, self._rows = self._rows, []
        return rows

    def close(self) -> None:
        """Look no longer."""
        if _watched.pop(self._data._address, None) and not _watched:
            for name, stepper in _own.items():
                setattr(mujoco, name, stepper)


def state_of(model: mujoco.MjModel, data: mujoco.MjData) -> Array:
    """The full mjSTATE_INTEGRATION vector, (n_state,)."""
    row = np.empty(mujoco.mj_stateSize(model, STATE))
    mujoco.mj_getState(model, data, row, STATE)
    return row
