"""Tests for recorder.py: a recorded environment is the environment, and no step is lost whatever
ends the run."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from coordlog.errors import SpecError, StorageError
from coordlog.mjcf import load_attached
from coordlog.policies.scripted import scripted
from coordlog.record.reader import read_attachments, read_episode
from coordlog.record.recorder import Finished, Recorder
from coordlog.sim.env import BatchEnv
from coordlog.sim.replay import Log, exact_here, replay
from coordlog.sim.rollout import rollout
from coordlog.tasks.scene import SCENES

POLICY = {"kind": "scripted", "name": "random", "checkpoint_sha256": "", "noise": {}}


def record(
    folder: Path,
    *,
    scene: str = "planar",
    n: int = 3,
    episodes: int = 4,
    policy: str = "random",
    threads: int = 1,
) -> list[Finished]:
    env, done = BatchEnv(SCENES[scene], n=n, threads=threads), []
    with Recorder(env, folder, policy=POLICY, epoch=0, finished=done.append) as recorder:
        for _ in rollout(recorder, scripted(policy, env), range(episodes), seed=3):
            pass
    return sorted(done, key=lambda item: item.path)


def logged(path: Path) -> Log:
    episode, attached = read_episode(path), read_attachments(path)
    model = load_attached(attached)
    return Log(episode.header, model, np.frombuffer(attached["initial_state.f64"]), episode.action)


@pytest.mark.parametrize(
    ("scene", "policy"), [("planar", "random"), ("spheres", "random"), ("table", "expert")]
)
def test_a_replay_from_the_file_alone_is_bit_exact(tmp_path: Path, scene: str, policy: str) -> None:
    done = record(tmp_path, scene=scene, policy=policy, n=2, episodes=3)
    traces = replay([logged(item.path) for item in done])
    for item, trace in zip(done, traces, strict=True):
        episode = read_episode(item.path)
        assert exact_here(episode.header) == ""
        for name, column in trace.columns.items():
            assert getattr(episode, name).tobytes() == column.tobytes(), name
        assert episode.contacts.tobytes() == trace.contacts.tobytes()


def test_a_replay_of_other_actions_differs(tmp_path: Path) -> None:
    log = logged(record(tmp_path, episodes=1)[0].path)
    changed = log.action.copy()
    changed[5, 0] = -changed[5, 0]
    first, second = replay([log, log._replace(action=changed)])
    same = (first.columns["qpos"] == second.columns["qpos"]).all(axis=1)
    assert same[:6].all()
    assert not same[6:].any()


def test_equal_settings_give_equal_bytes_at_any_number_of_simulations(tmp_path: Path) -> None:
    for folder, n, threads in (("one", 1, 1), ("many", 3, 2)):
        record(tmp_path / folder, scene="spheres", n=n, threads=threads, episodes=3)
    names = sorted(path.name for path in (tmp_path / "one").iterdir())
    assert len(names) == 3
    for name in names:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "many" / name).read_bytes()


def test_a_second_run_adds_and_replaces_nothing(tmp_path: Path) -> None:
    first = {item.path: item.path.read_bytes() for item in record(tmp_path, episodes=2)}
    second = record(tmp_path, episodes=2)
    assert not first.keys() & {item.path for item in second}
    assert all(path.read_bytes() == content for path, content in first.items())


def test_an_interrupted_run_keeps_every_step(tmp_path: Path) -> None:
    env, done = BatchEnv(SCENES["planar"], n=2, threads=1), []
    with Recorder(env, tmp_path, policy=POLICY, finished=done.append) as recorder:
        for _ in islice(rollout(recorder, scripted("still", env), range(2), seed=0), 30):
            pass
    assert [item.result.aborted for item in done] == ["interrupted"] * 2
    assert [item.result.length for item in done] == [30, 30]
    assert not list(tmp_path.glob("*.part"))


def test_an_interruption_inside_a_step_ends_before_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    env, done = BatchEnv(SCENES["planar"], n=1, threads=1), []
    original, calls = BatchEnv.step, []

    def failing(self: BatchEnv, action: np.ndarray, ids: np.ndarray) -> object:
        outcome = original(self, action, ids)
        calls.append(1)
        if len(calls) == 10:
            raise ZeroDivisionError
        return outcome

    monkeypatch.setattr(BatchEnv, "step", failing)
    with (
        pytest.raises(ZeroDivisionError),
        Recorder(env, tmp_path, policy=POLICY, finished=done.append) as recorder,
    ):
        for _ in rollout(recorder, scripted("random", env), range(1), seed=0):
            pass
    episode = read_episode(done[0].path)
    assert len(episode) == 9
    assert done[0].result.aborted == "failed: ZeroDivisionError"
    trace = replay([logged(done[0].path)])[0]
    assert trace.columns["qpos"].tobytes() == episode.qpos.tobytes()


def test_a_diverged_simulation_is_closed_with_its_last_sound_state_and_the_others_go_on(
    tmp_path: Path,
) -> None:
    env, done = BatchEnv(SCENES["planar"], n=3, threads=1), []
    with Recorder(env, tmp_path, policy=POLICY, finished=done.append) as recorder:
        for count, _ in enumerate(rollout(recorder, scripted("random", env), range(3), seed=0)):
            if count == 40:
                env.physics.qvel[1] = np.nan
    aborted = [item for item in done if item.result.aborted]
    assert [item.header.episode["index"] for item in aborted] == [1]
    assert aborted[0].result.aborted.startswith("diverged")
    assert aborted[0].result.length == 41
    assert len(done) == 3
    assert all(
        np.isfinite(read_episode(item.path).qpos).all() for item in done if item is not aborted[0]
    )


def test_a_policy_that_gives_no_number_is_refused(tmp_path: Path) -> None:
    class Broken:
        def begin(
            self, ids: np.ndarray, state: np.ndarray, rngs: list[np.random.Generator]
        ) -> None:
            pass

        def act(self, ids: np.ndarray, state: np.ndarray) -> np.ndarray:
            return np.full((len(ids), 8), np.nan, dtype=np.float32)

    env = BatchEnv(SCENES["planar"], n=1, threads=1)
    with (
        pytest.raises(SpecError, match="action: expected numbers"),
        Recorder(env, tmp_path, policy=POLICY) as recorder,
    ):
        next(rollout(recorder, Broken(), range(1), seed=0))
    assert not list(tmp_path.iterdir()), "an episode without a step is no episode"


def test_a_folder_that_cannot_be_made_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="cannot make the folder"):
        Recorder(BatchEnv(SCENES["planar"], n=1), tmp_path / "file" / "logs", policy=POLICY)
