"""What files of every schema version say, array by array, frozen: no later reader may read them
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
PATHS = sorted(DATA.glob("v*/*/*.mcap"))


def digests(episode):
    """One digest for each column, of its type, shape and bytes."""
    found = {}
    for name in (*episode.columns, "contacts"):
        array = getattr(episode, name)
        text = f"{array.dtype.descr} {array.shape} ".encode()
        found[name] = hashlib.sha256(text + np.ascontiguousarray(array).tobytes()).hexdigest()[:16]
    return found


def test_every_fixture_is_frozen():
    assert sorted(FROZEN) == sorted(path.name for path in PATHS)


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)
def test_a_fixture_says_what_it_said(path):
    episode = read_episode(path)
    assert digests(episode) == FROZEN[path.name]
    assert episode.header.version == int(path.parts[-3].removeprefix("v"))
    assert episode.has("torque") == (episode.header.version > 1)
    assert episode.path is None


if __name__ == "__main__":
    frozen = {path.name: digests(read_episode(path)) for path in PATHS}
    (Path(__file__).parent / "frozen.json").write_text(json.dumps(frozen, indent=1) + "\n")
