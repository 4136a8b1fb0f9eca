import os

os.environ["RERUN_STRICT"] = (
    "1"  # the SDK turns bad data into a warning otherwise; read when rerun is imported
)

import numpy as np
import pytest

from tests.view.recordings import rolled_out, with_contacts, with_path


@pytest.fixture(scope="session")
def shows():
    """One short episode of every scene, by name."""
    return {name: rolled_out(name) for name in ("free", "spheres", "table", "shelf", "planar")}


@pytest.fixture(scope="session")
def smoothed(shows):
    """The table episode with contacts, and with a path that its knots scatter around."""
    return with_path(with_contacts(shows["table"]), np.random.default_rng(7))
