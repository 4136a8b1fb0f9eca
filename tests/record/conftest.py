import numpy as np
import pytest
from synthetic import ATTACHMENTS, make_episode

from coordlog.record.writer import write_episode


@pytest.fixture
def rng():
    return np.random.default_rng(20240607)


@pytest.fixture
def episode(rng):
    """60 steps of a two-armed robot, with contacts, ending at the goal."""
    return make_episode(rng)


@pytest.fixture
def file(episode, tmp_path):
    """That episode as a file without display topics."""
    path = tmp_path / "episode.mcap"
    write_episode(path, episode, attachments=ATTACHMENTS, display=False)
    return path
