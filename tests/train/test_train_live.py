"""Tests for live simulations as a source: they go on from a saved state as if nothing had
happened."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from coordlog.episode import Array
from coordlog.policies.checkpoint import load_arrays, save_arrays
from coordlog.sim.env import BatchEnv
from coordlog.tasks.config import EnvConfig
from coordlog.tasks.scene import find
from coordlog.train.live import Simulations

LANES, LIMIT = 3, 5


def simulations() -> Simulations:
    env = BatchEnv(find("planar"), EnvConfig(max_steps=LIMIT), n=LANES, threads=1)
    return Simulations(env, seed=4, k=env.layout.k, farthest=2.0)


def wavering(state: Array) -> Array:
    return np.sin(9 * state[:, :8]).astype(np.float32)


@pytest.mark.parametrize(
    "steps",
    [0, 2, LIMIT, 2 * LIMIT + 1],
    ids=["at first", "under way", "all just ended", "after some"],
)
def test_a_saved_source_goes_on_with_the_same_bits(steps: int, tmp_path: Path) -> None:
    whole, parts = simulations(), simulations()
    if steps:
        whole.collect(steps, wavering)
    save_arrays(tmp_path / "state", whole.state(), kind="test", meta={})
    parts.load_state(load_arrays(tmp_path / "state", kind="test").arrays)
    for count in (LIMIT - 1, LIMIT):
        wanted, found = whole.collect(count, wavering), parts.collect(count, wavering)
        for name, column in wanted._asdict().items():
            np.testing.assert_array_equal(getattr(found, name), column, err_msg=name)
    assert parts.summary() == whole.summary()
    assert whole.summary()["episodes"] == 0, "told of once"


def test_episodes_are_numbered_as_they_start_and_cut_off_at_the_limit() -> None:
    block = simulations().collect(LIMIT + 1, wavering)
    assert block.episode[:LIMIT].tolist() == [[0, 1, 2]] * LIMIT
    assert block.episode[LIMIT].tolist() == [3, 4, 5]
    assert block.step[:, 0].tolist() == [*range(LIMIT), 0]
    assert not block.terminated.any()
    assert (block.state[1:LIMIT] == block.next_state[: LIMIT - 1]).all()
    assert (block.state[LIMIT] != block.next_state[LIMIT - 1]).any(), "another problem"
