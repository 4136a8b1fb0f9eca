"""Tests for driving smoothed paths through the simulation: bit-exact replays of the raw run,
tracking, and honest judgement."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from coordlog.episode import INITIAL_STATE, Episode, Header, Result
from coordlog.kinematics.clearance import SceneChecker
from coordlog.policies.scripted import scripted, with_noise
from coordlog.sim.env import BatchEnv
from coordlog.sim.replay import Log, LogEnv, bound_task, replay
from coordlog.sim.rollout import rollout
from coordlog.sim.tracking import Drive, run, targets
from coordlog.smooth.execute import execute, logged_torques, worse
from coordlog.smooth.limits import Limits
from coordlog.smooth.smoother import smooth
from coordlog.tasks.scene import find


def recorded(scene, *, index=0, noise=0.15):
    """One episode of the noisy expert, in memory, and what a replay needs of it."""
    env = BatchEnv(find(scene), n=1, threads=1)
    policy, _ = with_noise(scripted("expert", env), env, sigma=noise, correlation=0.0)
    actions, start = [], []
    spy = env.step

    def step(action, ids):
        if not actions:
            start.append(np.frombuffer(env.attachments(0)[INITIAL_STATE]).copy())
        actions.append(action[0].copy())
        return spy(action, ids)

    env.step = step
    for _ in rollout(env, policy, [index], seed=0):
        pass
    episode = {
        "schema_version": 1,
        "control_period": 0.04,
        "start_time": 0,
        "goals": [],
        "obstacles": [],
    }
    header = Header(
        episode,
        env.describe(),
        {"kind": "scripted", "name": "expert", "checkpoint_sha256": "", "noise": {}},
    )
    log = Log(header, env.physics.model_of(0), start[0], np.array(actions))
    (trace,) = replay([log])
    columns = trace.columns
    success = bool(columns["goal"][-1].all())
    result = Result(
        len(actions),
        tuple(columns["reward"].sum(axis=0)),
        success,
        success,
        bool(columns["terminated"][-1]),
        bool(columns["truncated"][-1]),
        "",
        "",
    )
    return log, Episode(header, result, action=log.action, contacts=trace.contacts, **columns)


@pytest.fixture(scope="module")
def table():
    log, episode = recorded("table")
    task = bound_task(log)
    checker = SceneChecker(
        log.model, task.robot, task.config, time=episode.time, qpos=episode.qpos, initial=log.start
    )
    limits = Limits(task.limits[:, 0], task.limits[:, 1])
    result = smooth(
        episode.time, episode.qpos[:, task.qpos_index], checker, limits=limits, clearance=0.005
    )
    return log, episode, result


def test_logged_actions_run_again_to_the_same_bits(table):
    log, episode, _ = table
    again = run(log, lambda step, _: log.action[step], steps=len(log.action))
    for name, column in again.columns.items():
        assert column.dtype == getattr(episode, name).dtype, name
        assert column.tobytes() == getattr(episode, name).tobytes(), name
    assert again.contacts.tobytes() == episode.contacts.tobytes()
    assert again.torque.shape == episode.action.shape
    assert not again.diverged


def test_servo_targets_are_those_the_simulation_used(table):
    log, episode, _ = table
    found, angles = targets(log), episode.qpos[:, bound_task(log).qpos_index]
    assert found.shape == angles.shape
    assert np.abs(found - angles).max() < 0.2
    moved = np.abs(np.diff(found, axis=0))
    assert (moved <= bound_task(log).speeds * bound_task(log).config.control_period + 1e-12).all()


@pytest.mark.parametrize("seed", range(5))
def test_an_action_brings_about_the_target_it_was_made_for(table, seed):
    """The command filter and its inverse, with a target in reach.

    One out of reach is approached with all speed.
    """
    log, _, _ = table
    env, rng, ids = LogEnv([log]), np.random.default_rng(seed), np.array([0])
    env.reset(ids, [env.problem(seed=0, split="", index=0)])
    task, drive = env.task, Drive(env.simulation)
    for _ in range(10):
        env.step(rng.uniform(-0.3, 0.3, (1, len(task.servos))).astype(np.float32), ids)
    wanted = drive.target + 0.2 * task.speeds * task.config.control_period * rng.uniform(
        -1, 1, len(task.servos)
    )
    action = drive.action_to(wanted)
    assert action.dtype == np.float32
    assert (np.abs(action) <= 1.0).all()
    before = drive.target.copy()
    env.step(action[None], ids)
    free = np.abs(action) < 1.0
    assert free.any()
    assert np.abs(drive.target - wanted)[free].max() < 1e-7
    far = drive.action_to(before + 10.0)
    assert (far == 1.0).all()


def test_a_smoothed_path_is_followed_and_works_the_servos_less(table):
    log, episode, result = table
    done = execute(log, result, episode)
    assert result.status == "smoothed"
    assert (done.status, done.reason) == ("smoothed", "")
    assert done.away < 0.01
    assert done.smoothed.rate < 0.6 * done.raw.rate
    assert done.run.columns["goal"][-1].all()
    assert not done.run.columns["collision"].any()
    assert len(done.run.columns["action"]) <= bound_task(log).config.max_steps


def test_what_was_executed_replays_to_the_same_bits(table):
    log, episode, result = table
    done = execute(log, result, episode).run
    (trace,) = replay([Log(log.header, log.model, log.start, done.columns["action"])])
    for name, column in trace.columns.items():
        assert column.tobytes() == done.columns[name].tobytes(), name


def test_torques_of_a_log_without_them_are_those_of_its_simulation(table):
    log, episode, _ = table
    again = run(log, lambda step, _: log.action[step], steps=len(log.action))
    found = logged_torques(log, episode, targets(log))
    np.testing.assert_array_equal(found, again.torque)


def test_a_raw_path_is_not_executed(table):
    log, episode, result = table
    kept = replace(result, status="kept_raw", reason="because")
    done = execute(log, kept, episode)
    assert (done.status, done.reason, done.run, done.smoothed) == (
        "kept_raw",
        "because",
        None,
        None,
    )


def test_a_path_that_misses_the_goal_is_not_taken(table):
    """The same path, bent away from the goal: proven or not, the execution decides."""
    log, episode, result = table
    astray = replace(
        result.spline,
        position=result.spline.position
        + 0.3 * np.linspace(0, 1, len(result.spline.time))[:, None] ** 2,
    )
    done = execute(log, replace(result, spline=astray), episode)
    assert done.status == "kept_raw"
    assert done.run is None
    assert "executed" in done.reason
    assert done.smoothed is not None, "what it cost is known all the same"


def test_what_is_worse_is_named(table):
    log, episode, result = table
    run_ = execute(log, result, episode).run
    fine = run_.columns
    assert worse(run_, episode) == ""
    fallen = fine | {"instability": np.arange(len(fine["action"])) == 7}
    assert "balance at 0.28 s" in worse(run_._replace(columns=fallen), episode)
    late = fine | {"goal": np.zeros_like(fine["goal"])}
    assert "no longer reaches the goal" in worse(run_._replace(columns=late), episode)
    assert (
        worse(
            run_._replace(columns=late),
            replace(episode, result=replace(episode.result, success=False)),
        )
        == ""
    )
    contact = np.zeros(1, dtype=run_.contacts.dtype)
    contact["geom1"], contact["geom2"], contact["depth"] = 3, 5, 0.002
    hit = fine | {"collision": np.arange(len(fine["action"])) == 5}
    assert "2.0 mm deep" in worse(run_._replace(columns=hit, contacts=contact), episode)
    assert "diverge" in worse(run_._replace(diverged=True), episode)
