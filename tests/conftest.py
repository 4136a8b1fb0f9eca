import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before NumPy: pytest-xdist has a process per core

import numpy as np
import pytest
from hypothesis import settings

from coordlog.record.writer import write_episode
from tests.synthetic import ATTACHMENTS, TINY, make_episode, make_header

settings.register_profile("coordlog", deadline=None, derandomize=True, max_examples=30)
settings.load_profile("coordlog")


@pytest.fixture(autouse=True, scope="session")
def _one_core():
    """One process of pytest-xdist has one core: what asks how many there are works right here, and
    starts no processes of its own unless a test wants some.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "cpu_count", lambda: 1)
        yield


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


@pytest.fixture
def tiny(rng):
    """30 steps of the smallest robot: two chunks of steps, in a file small enough to be damaged at
    every byte."""
    return make_episode(rng, length=30, layout=TINY, header=make_header(TINY, goals=[[0, 0, 0]]))


@pytest.fixture
def tiny_file(tiny, tmp_path):
    path = tmp_path / "tiny.mcap"
    write_episode(path, tiny, attachments={"model.xml.zst": b"<mujoco/>"}, display=False)
    return path
