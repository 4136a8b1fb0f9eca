"""Small episodes on the disk, for tests of catalogues."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from coordlog.record.writer import write_episode
from tests.synthetic import TINY, make_episode, make_header


def write(path: Path, number: int, **header: object) -> Path:
    """An episode that depends on its number alone."""
    rng = np.random.default_rng(number)
    about = make_header(TINY, seed=number, goals=[[number % 3, 0, 0]], **header)
    ending = "fall" if number % 2 else "goal"
    episode = make_episode(
        rng, length=3 + number % 4, layout=TINY, header=about, ending=ending, collisions=0
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    write_episode(path, episode, attachments={}, display=False)
    return path
