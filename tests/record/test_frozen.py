"""What files of schema version 1 say, array by array, frozen: no later reader may read them
otherwise.
"""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from coordlog.record.reader import read_episode

DATA = Path(__file__).parents[1] / "data"
FROZEN = json.loads((Path(__file__).parent / "frozen.json").read_text(encoding="utf-8"))
NAMES = ("time", "qpos", "qvel", "state", "action", "reward", "distance", "boundary", "goal")
NAMES += ("collision", "instability", "terminated", "truncated", "contacts")


def digests(episode):
    """One digest for each column, of its type, shape and bytes."""
    found = {}
    for name in NAMES:
        array = getattr(episode, name)
        text = f"{array.dtype.descr} {array.shape} ".encode()
        found[name] = hashlib.sha256(text + np.ascontiguousarray(array).tobytes()).hexdigest()[:16]
    return found


def test_every_fixture_of_version_1_is_frozen():
    assert sorted(FROZEN) == sorted(path.name for path in DATA.glob("v1/*/*.mcap"))


@pytest.mark.parametrize("path", sorted(DATA.glob("v1/*/*.mcap")), ids=lambda path: path.stem)
def test_version_1_says_what_it_said(path):
    episode = read_episode(path)
    assert digests(episode) == FROZEN[path.name]
    assert episode.path is None


if __name__ == "__main__":
    frozen = {p.name: digests(read_episode(p)) for p in sorted(DATA.glob("v1/*/*.mcap"))}
    (Path(__file__).parent / "frozen.json").write_text(json.dumps(frozen, indent=1) + "\n")
