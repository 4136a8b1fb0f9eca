"""Planning beside the policy: the planner's rules, its time law, the kinematic rollout, and both
executed from the same start."""

from __future__ import annotations

import numpy as np
import pytest

from coordlog.sim.env import BatchEnv
from experiments import case as cases
from experiments import ompl_plan, planner
from experiments.actors import actor
from experiments.evaluate import environment
from experiments.measure import SEED, SPLIT
from experiments.safe import KNOTS, PEAK, SLOWER, executed, kinematic, safe


@pytest.fixture(scope="module")
def env() -> BatchEnv:
    return environment("table", "pretrained", radius=0.03, torso="free", envs=1, threads=1)


def test_the_rules_are_those_of_the_scene(env: BatchEnv) -> None:
    rng, where, reach = np.random.default_rng(0), cases.case(env, 0), env.draw.reach
    rules = ompl_plan.Rules(env, where)
    rules.keep(0.01)
    low, high = env.task.limits.T
    postures = [where.problem.angles + 0.6 * rng.normal(size=13) for _ in range(150)] + list(
        rng.uniform(low, high, (50, 13))
    )
    answers = [rules.free(q) for q in postures]
    assert answers == [reach.legal(q, clearance=0.01) for q in postures]
    assert 20 < sum(answers) < 180


def test_a_plan_starts_at_the_start_ends_at_the_goals_and_is_free(env: BatchEnv) -> None:
    where = cases.case(env, 2)
    planned = ompl_plan.plan(env, where)
    assert planned.points is not None
    assert set(planned.cpu) == {"ik", "rrt", "simplify"}
    assert np.abs(planned.points[0] - where.problem.angles).max() < 1e-9
    assert (
        np.linalg.norm(env.draw.reach.palms(planned.points[-1]) - where.problem.goals, axis=1).max()
        < 0.004
    )
    rules = ompl_plan.Rules(env, where)
    assert all(rules.free(q) for q in planned.points)


def test_a_timed_path_keeps_the_speeds_and_rests_at_its_ends() -> None:
    points, speeds = (
        np.array([[0.0, 0.0], [1.0, 0.1], [1.0, 0.1], [1.5, -0.2]]),
        np.array([1.0, 0.3]),
    )
    path = ompl_plan.Timed.of(points, speeds)
    assert path.duration == pytest.approx(1.875 * (1.0 + 1.0))
    time = np.linspace(0.0, path.duration, 4001)
    speed = np.abs(np.diff(path(time), axis=0)) / np.diff(time)[:, None] / speeds
    assert speed.max() == pytest.approx(1.0, abs=1e-3)
    assert speed[[0, -1]].max() < 1e-3
    assert path(0.0).tolist() == [0.0, 0.0]
    assert path(99.0) == pytest.approx([1.5, -0.2])


def test_a_kinematic_rollout_becomes_a_proven_path_that_arrives(env: BatchEnv) -> None:
    where = cases.case(env, 0)
    found = safe(env, where, [actor("pretrained", env)[0]], physics=False)
    assert found.rollout.arrived
    assert found.result.certified
    base = found.rollout.qpos[:, :7]
    assert (base == base[0]).all(), "the base stands still"
    scored = cases.score(executed(where, env, found))
    assert scored.clean
    assert max(scored.arrival) == scored.length - 1


def test_a_rollout_taken_as_a_path_is_timed_as_a_planners_and_ends_on_the_goals() -> None:
    env = environment("free", "pretrained", radius=0.03, torso="free", envs=1, threads=1)
    where = cases.case(env, 0)
    rolled = kinematic(env, where, actor("pretrained", env)[0])
    angles = rolled.qpos[:, env.task.qpos_index]
    assert (
        np.linalg.norm(env.draw.reach.palms(angles[-1]) - where.problem.goals, axis=1).max() < 0.004
    )
    assert rolled.time[-1] == pytest.approx(
        PEAK * (np.abs(angles[-1] - angles[0]) / env.task.speeds).max()
    )
    assert rolled.time[-1] > SLOWER * len(rolled.action) * env.task.config.control_period, (
        "the policy itself is faster"
    )
    assert len(angles) <= KNOTS
    assert (np.diff(rolled.time) > 0).all()


def test_the_first_policy_whose_path_is_proven_counts_and_all_that_were_tried_are_paid_for(
    env: BatchEnv,
) -> None:
    class Stands:
        def begin(
            self, ids: np.ndarray, state: np.ndarray, rngs: list[np.random.Generator]
        ) -> None:
            pass

        def act(self, ids: np.ndarray, state: np.ndarray) -> np.ndarray:
            return np.zeros((1, 13), np.float32)

    good = actor("pretrained", env)[0]
    one, two, none = (
        safe(env, cases.case(env, 0), ways, physics=False)
        for ways in ([good, Stands()], [Stands(), good], [Stands()])
    )
    assert one.rollout.arrived
    assert two.rollout.arrived
    assert not none.rollout.arrived
    np.testing.assert_array_equal(one.result.spline.position, two.result.spline.position)
    assert len(none.rollout.action) == env.task.config.max_steps


def test_a_rollout_in_the_simulation_is_the_evaluations(env: BatchEnv) -> None:
    from coordlog.sim.rollout import rollout

    policy = actor("pretrained", env)[0]
    steps = sum(1 for _ in rollout(env, policy, [3], seed=SEED, split=SPLIT))
    found = safe(env, cases.case(env, 3), [policy], physics=True)
    assert len(found.rollout.action) == steps


def test_a_problem_without_a_path_is_a_failure_in_every_share() -> None:
    tried = planner.Tried()
    tried.add(
        {"cpu": 1.0, "seconds": np.nan, "jerk": np.nan}, ran=None, nearest=np.inf, certified=False
    )
    row = tried.row()
    assert (row["success"]["count"], row["success"]["of"], row["found"]["count"]) == (0, 1, 0)
    assert row["jerk"] is None
    assert row["cpu"]["median"] == 1.0


def test_ratios_are_taken_problem_by_problem_where_both_have_one() -> None:
    ours, theirs = planner.Tried(), planner.Tried()
    ours.numbers = {"cpu": [1.0, 1.0, 1.0], "jerk": [1.0, 2.0, 1.0], "seconds": [1.0, 1.0, 1.0]}
    theirs.numbers = {
        "cpu": [2.0, 4.0, 8.0],
        "jerk": [10.0, 20.0, np.nan],
        "seconds": [2.0, 2.0, np.nan],
    }
    found = planner.ratios(ours, theirs)
    assert found["cpu"]["median"] == 0.25
    assert (found["jerk"]["median"], found["jerk"]["n"]) == (10.0, 2)
    assert found["jerk_same_duration"]["median"] == 80.0


@pytest.mark.parametrize("scene", ["spheres", "shelf"])
def test_a_kinematic_rollout_shows_the_policy_what_the_simulation_would(scene: str) -> None:
    env = environment(scene, "pretrained", radius=0.03, torso="free", envs=1, threads=1)
    where, seen = cases.case(env, 1), []

    class Watch:
        def begin(
            self, ids: np.ndarray, state: np.ndarray, rngs: list[np.random.Generator]
        ) -> None:
            pass

        def act(self, ids: np.ndarray, state: np.ndarray) -> np.ndarray:
            seen.append(state[0])
            return np.zeros((1, 13), np.float32)

    kinematic(env, where, Watch())
    env.reset(np.array([0]), [where.problem])
    np.testing.assert_allclose(seen[0], env.state[0], atol=2e-3)
