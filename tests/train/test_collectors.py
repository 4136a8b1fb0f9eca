"""Tests for several collectors: they are one source, wherever they run and whatever is lost."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
from contextlib import nullcontext
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from coordlog.crew import Crew
from coordlog.episode import Array
from coordlog.policies.checkpoint import load_arrays, save_arrays
from coordlog.sim.env import BatchEnv
from coordlog.tasks.config import EnvConfig
from coordlog.tasks.scene import find
from coordlog.train.collectors import Collector, Collectors, shares
from coordlog.train.columns import Block
from coordlog.train.exploration import Exploring, Noise
from coordlog.train.live import Simulations

LIMIT, EACH = 5, [2, 1]


def collector(at: int, *, marker: Path | None = None) -> Collector:
    """One of two collectors in the planar scene; with a marker it dies once, in its second block."""
    env = BatchEnv(find("planar"), EnvConfig(max_steps=LIMIT), n=EACH[at], threads=1)
    simulations = Simulations(env, seed=4, k=env.layout.k, farthest=2.0, first=at, stride=len(EACH))
    made = Collector(simulations, nullcontext())
    if marker is not None and at == 1 and not marker.exists():
        collect, blocks = made.collect, []

        def dying(steps: int, policy: Exploring) -> tuple[Block, dict[str, Array]]:
            blocks.append(steps)
            if len(blocks) == 2:
                marker.touch()
                os.kill(os.getpid(), signal.SIGKILL)
            return collect(steps, policy)

        made.collect = dying  # type: ignore[method-assign]
    return made


def wavering(state: Array) -> Array:
    return np.sin(9 * state[:, :8]).astype(np.float32)


def exploring() -> Exploring:
    n_u = BatchEnv(find("planar"), EnvConfig(), n=1, threads=1).layout.n_u
    return Exploring(
        lambda state: wavering(state)[:, :n_u],
        Noise(sum(EACH), n_u, correlation=0.9, seed=[1, 1]),
        deviation=0.2,
    )


def equal(found: Block, wanted: Block) -> None:
    for name, column in wanted._asdict().items():
        np.testing.assert_array_equal(getattr(found, name), column, err_msg=name)


def test_simulations_are_shared_out_and_problems_taken_in_turns() -> None:
    assert [shares(8, 3), shares(3, 3)] == [[2, 3, 3], [1, 1, 1]]
    with Crew(collector, 2, jobs=1) as crew:
        block = Collectors(crew, EACH, k=2).collect(LIMIT + 1, exploring())
    assert block.episode[0].tolist() == [0, 2, 1]
    assert block.episode[LIMIT].tolist() == [4, 6, 3]


def test_a_saved_crew_goes_on_with_the_same_bits(tmp_path: Path) -> None:
    policy, again = exploring(), exploring()
    with Crew(collector, 2, jobs=1) as crew, Crew(collector, 2, jobs=1) as other:
        whole, parts = Collectors(crew, EACH, k=2), Collectors(other, EACH, k=2)
        whole.collect(LIMIT + 2, policy)
        whole.summary()
        whole.collect(LIMIT, policy)
        save_arrays(tmp_path / "state", whole.state(), kind="test", meta={})
        parts.load_state(load_arrays(tmp_path / "state", kind="test").arrays)
        again._noise = policy._noise  # type: ignore[assignment]
        wanted = whole.collect(3, policy)
        generator = exploring()
        for _ in range(2 * LIMIT + 2):
            generator._noise.draw()
        equal(parts.collect(3, generator), wanted)
        assert parts.summary() == whole.summary()


def told(jobs: str, marker: str) -> None:
    """Print a digest of three blocks and what is said of them."""
    with Crew(partial(collector, marker=Path(marker)), 2, jobs=jobs) as crew:
        source, policy = Collectors(crew, EACH, k=2), exploring()
        columns = [column.tobytes() for _ in range(3) for column in source.collect(3, policy)]
        digest = hashlib.sha256(b"".join(columns)).hexdigest()
        sys.stdout.write(f"{digest} {dict(source.summary())}\n")


def test_a_cluster_gives_the_same_bits_and_a_lost_collector_is_made_again(tmp_path: Path) -> None:
    """A local cluster of two workers, of which one kills itself in its second block; in a process
    of its own, for Ray leaves much behind."""
    pytest.importorskip("ray")
    marker = tmp_path / "died"
    code = (
        "import pathlib; from tests.train.test_collectors import told;"
        f"marker = {str(marker)!r}; told('ray', marker);"
        " assert pathlib.Path(marker).exists(), 'no collector was lost'; told('1', marker)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    if "timed out during startup" in done.stderr:
        pytest.skip("the machine is too busy: Ray waits half a minute for its start")
    assert done.returncode == 0, done.stderr
    there, here = done.stdout.splitlines()[-2:]
    assert there == here
