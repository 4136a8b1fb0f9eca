import pytest

from coordlog.record.writer import write_episode
from tests.synthetic import ATTACHMENTS, TINY, make_episode, make_header


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Seven short episodes of one robot, the last a smoothed one."""
    import numpy as np

    rng = np.random.default_rng(16)
    folder = tmp_path_factory.mktemp("logs")
    for i in range(7):
        header = make_header(TINY, seed=i, index=i, scene="table" if i % 2 else "shelf")
        episode = make_episode(rng, length=5 + i, layout=TINY, header=header, path=i == 6)
        write_episode(folder / f"{i}.mcap", episode, attachments=ATTACHMENTS, display=i == 0)
    return folder
