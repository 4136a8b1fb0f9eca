"""The policy state: named, scaled to about ±1, and undone by whoever holds a log."""

import json
from dataclasses import replace

import numpy as np
import pytest

from coordlog.robots.humanoid import HUMANOID
from coordlog.robots.planar import PLANAR
from coordlog.sim.env import BatchEnv
from coordlog.tasks.config import EnvConfig
from coordlog.tasks.reach.observation import NEAR, TIP, StateView, nearness, state_view
from coordlog.tasks.scene import SCENES

ALL = EnvConfig(state_extras=("difference", "com", "nearness", "velocity"))


def view(robot=HUMANOID, *, spheres=0, config=None):
    limits = np.tile([-1.0, 3.0], (len(robot.action_joints), 1))
    return state_view(robot, limits, spheres=spheres, config=config or EnvConfig())


def random_parts(shown, rng, n):
    return {
        name: rng.uniform(-1, 1, (n, place.stop - place.start))
        for name, place in shown.places.items()
    }


def test_the_papers_state_is_angles_palms_goals_and_spheres():
    assert len(view(config=EnvConfig(state_extras=()))) == 13 + 6 + 6
    assert len(view(spheres=3, config=EnvConfig(state_extras=()))) == 25 + 12
    assert len(view(config=ALL)) == 25 + 6 + 2 + 13


def test_widths_follow_from_the_robot():
    assert len(view(PLANAR, config=EnvConfig(state_extras=()))) == 8 + 9 + 9
    assert "com" not in view(PLANAR, config=ALL).places  # nothing to balance


def test_every_entry_has_one_name_and_one_place():
    shown = view(spheres=3, config=ALL)
    assert len(set(shown.names)) == len(shown.names) == len(shown)
    covered = np.concatenate(
        [np.arange(place.start, place.stop) for place in shown.places.values()]
    )
    assert covered.tolist() == list(range(len(shown)))
    assert shown.names[shown.places["goals"]] == (
        "goal_left_x",
        "goal_left_y",
        "goal_left_z",
        "goal_right_x",
        "goal_right_y",
        "goal_right_z",
    )
    assert shown.names[shown.places["spheres"]][3] == "sphere_0_radius"
    assert shown.names[:13] == HUMANOID.action_joints


def test_physical_undoes_scaled_up_to_float32():
    rng, shown = np.random.default_rng(0), view(spheres=3, config=ALL)
    parts = random_parts(shown, rng, 50)
    state = shown.scaled(parts)
    assert state.shape == (50, len(shown))
    assert state.dtype == np.float32
    for name, values in parts.items():
        assert shown.physical(state, name) == pytest.approx(values, abs=2e-7)


def test_scales_are_the_ranges_they_stand_for():
    shown = view(config=ALL)
    parts = {name: np.zeros((1, place.stop - place.start)) for name, place in shown.places.items()}
    parts["angles"] = np.full((1, 13), 3.0)
    parts["palms"] = np.tile(np.array(HUMANOID.centre) + HUMANOID.reach, (1, 2))
    parts["goals"] = np.tile(HUMANOID.centre, (1, 2))
    state = shown.scaled(parts)[0]
    assert state[shown.places["angles"]] == pytest.approx(1.0)
    assert state[shown.places["palms"]] == pytest.approx(1.0)
    assert state[shown.places["goals"]] == pytest.approx(0.0)


def test_a_view_survives_json():
    shown, rng = view(spheres=3, config=ALL), np.random.default_rng(1)
    again = StateView.from_json(json.loads(json.dumps(shown.to_json())))
    assert again.names == shown.names
    assert dict(again.places) == dict(shown.places)
    parts = random_parts(shown, rng, 5)
    assert again.scaled(parts).tobytes() == shown.scaled(parts).tobytes()


@pytest.mark.parametrize("name", list(SCENES))
def test_a_live_state_is_what_the_simulation_is_in(name):
    env = BatchEnv(SCENES[name], ALL, n=3, threads=1)
    ids = np.arange(3)
    problems = [env.problem(seed=0, split="train", index=index) for index in range(3)]
    env.reset(ids, problems)
    rng = np.random.default_rng(0)
    for _ in range(3):
        env.step(rng.uniform(-1, 1, (3, len(env.task.servos))).astype(np.float32), ids)
    shown, task, physics = env.task.view, env.task, env.physics
    assert np.isfinite(env.state).all()
    assert np.abs(env.state).max() < 3.0
    angles = physics.qpos[:, task.qpos_index]
    assert shown.physical(env.state, "angles") == pytest.approx(angles, abs=1e-6)
    assert shown.physical(env.state, "velocity") == pytest.approx(
        physics.qvel[:, task.qvel_index], abs=1e-6
    )
    there = [problem.goals if problem.track is None else problem.track[3] for problem in problems]
    goals = np.array([points.ravel() for points in there])
    assert shown.physical(env.state, "goals") == pytest.approx(goals, abs=1e-6)
    palms = shown.physical(env.state, "palms")
    assert shown.physical(env.state, "difference") == pytest.approx(goals - palms, abs=1e-6)
    if task.n_spheres:
        spheres = np.array([problem.spheres.ravel() for problem in problems])
        assert shown.physical(env.state, "spheres") == pytest.approx(spheres, abs=1e-6)


def test_a_sphere_in_the_state_does_not_depend_on_the_extras():
    plain, full = view(spheres=2, config=EnvConfig(state_extras=())), view(spheres=2, config=ALL)
    assert plain.places["spheres"] == full.places["spheres"]
    assert plain.names == full.names[: len(plain)]


def test_the_order_of_extras_in_the_config_does_not_matter():
    one = view(config=EnvConfig(state_extras=("com", "difference")))
    other = view(config=replace(EnvConfig(), state_extras=("difference", "com")))
    assert one.names == other.names


def test_nearness_points_from_the_nearest_point_of_a_link_and_grows_to_one_at_its_surface():
    rng = np.random.default_rng(3)
    links, palms = rng.uniform(-0.2, 0.2, (2, 200, 2, 3))
    spheres = np.concatenate(
        [rng.uniform(-0.4, 0.4, (200, 3, 3)), rng.uniform(0.02, 0.1, (200, 3, 1))], axis=2
    )
    found = nearness(links, palms, spheres)
    assert found.shape == (200, 3, 2, 3)
    points = (
        links[:, None] + np.linspace(0, TIP, 4001)[:, None, None] * (palms - links)[:, None]
    )  # (n, 4001, k, 3)
    for i in range(3):
        gap = spheres[:, i, None, None, :3] - points
        distance = np.linalg.norm(gap, axis=3)
        nearest = distance.argmin(axis=1)[:, None]
        least = np.take_along_axis(distance, nearest, axis=1)[:, 0]
        length = np.linalg.norm(found[:, i], axis=2)
        assert length == pytest.approx(
            np.clip(1 - (least - spheres[:, i, None, 3]) / NEAR, 0, None), abs=1e-5
        )
        direction = np.take_along_axis(gap, nearest[..., None], axis=1)[:, 0] / least[..., None]
        assert found[:, i] == pytest.approx(direction * length[..., None], abs=1e-2)
    assert (length == 0).any()
    assert (length > 1).any()


def test_nearness_is_touch_in_the_simulation():
    env, one = BatchEnv(SCENES["spheres"], EnvConfig(), n=1, threads=1), np.array([0])
    drawn = env.problem(seed=7, split="train", index=0)
    env.reset(one, [drawn])
    place, size = env.task.view.places["nearness"], SCENES["spheres"].sphere_radius[0]
    palm = env.task.view.physical(env.state, "palms")[0, :3]
    for gap, touches in (
        (0.03, False),
        (-0.004, True),
    ):  # in front of the left hand, whose radius is 18 mm
        spheres = drawn.spheres.copy()
        spheres[0] = [*np.add(palm, (0.018 + gap + size, 0.0, 0.0)), size]
        env.reset(one, [replace(drawn, spheres=spheres)])
        length = np.linalg.norm(env.state[0, place].reshape(3, 2, 3), axis=2)
        outcome = env.step(np.zeros((1, 13), np.float32), one)
        assert length[0, 0] == pytest.approx(1 - (0.018 + gap) / NEAR, abs=0.05)
        assert bool(outcome.collision[0]) == touches


def test_only_scenes_with_spheres_have_nearness():
    assert "nearness" not in view(config=ALL).places
    assert len(view(spheres=3).names[view(spheres=3).places["nearness"]]) == 3 * 2 * 3
