"""Problems: every draw can be solved, and which one it is depends on seed, split and index
alone."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from coordlog.errors import ConfigError, SimulationError
from coordlog.sim import sampler as draw
from coordlog.sim.env import BatchEnv
from coordlog.sim.sampler import CLEARANCE, Draw
from coordlog.tasks.config import EnvConfig
from coordlog.tasks.scene import SCENES, find, sphere_geom

PAPER = ("free", "spheres", "table", "shelf")
DRAWS = 15


@pytest.fixture(scope="module")
def envs():
    return {name: BatchEnv(scene, n=1, threads=1) for name, scene in SCENES.items()}


def problems(env, *, seed=0, split="train", count=DRAWS):
    return [env.problem(seed=seed, split=split, index=index) for index in range(count)]


def posed(env, problem, angles):
    """The whole robot at joint angles among the problem's obstacles, computed afresh: model with
    the radii, and data."""
    model = env.physics.model_of(0)
    for i, sphere in enumerate(problem.spheres):
        model.geom(sphere_geom(i)).size[0] = sphere[3]
    if len(problem.spheres):
        mujoco.mj_setConst(model, mujoco.MjData(model))
    data = mujoco.MjData(model)
    data.qpos[:] = env._rest[1 : 1 + model.nq]
    for i, sphere in enumerate(problem.spheres):
        data.mocap_pos[model.body(sphere_geom(i)).mocapid[0]] = sphere[:3]
    for name, angle in zip(env.scene.robot.action_joints, angles, strict=True):
        data.qpos[model.joint(name).qposadr[0]] = angle
    mujoco.mj_forward(model, data)
    return model, data


def touching(model, data, robot):
    """Geom names of contacts that are no sole on the floor."""
    pairs = [{model.geom(a).name, model.geom(b).name} for a, b in data.contact.geom]
    return [pair for pair in pairs if not ("floor" in pair and pair & set(robot.soles))]


@pytest.mark.parametrize("name", PAPER)
@pytest.mark.parametrize("split", ["train", "test"])
def test_every_problem_has_a_posture_with_both_palms_on_their_goals(envs, name, split):
    env, robot = envs[name], envs[name].scene.robot
    for problem in problems(env, split=split):
        env.draw.reach.place(problem.spheres)
        angles = env.draw.reach.solve(problem.goals)
        assert angles is not None
        low, high = env.task.limits.T
        assert ((angles >= low) & (angles <= high)).all()
        model, data = posed(env, problem, angles)
        palms = np.array([data.site(arm.palm).xpos for arm in robot.arms])
        assert np.linalg.norm(palms - problem.goals, axis=1).max() < 0.005
        assert touching(model, data, robot) == []
        x, y = data.subtree_com[model.body(robot.torso).rootid[0], :2]
        assert -0.0375 + 0.01 < x < 0.1055 - 0.01  # the hull of both feet in the stand pose, shrunk
        assert abs(y) < 0.073 - 0.01


@pytest.mark.parametrize("name", PAPER)
def test_every_start_is_legal_near_the_pose_and_away_from_obstacles(envs, name):
    env = envs[name]
    for problem in problems(
        env, count=55 if name == "spheres" else DRAWS
    ):  # one in forty would start too close to a sphere
        assert (
            np.abs(problem.angles - env.draw.reach.standing_angles).max()
            <= env.task.config.start_noise + 1e-12
        )
        model, data = posed(env, problem, problem.angles)
        assert touching(model, data, env.scene.robot) == []
        arms = [
            i
            for i in range(model.ngeom)
            if model.geom_contype[i] and model.body_mocapid[model.geom_bodyid[i]] < 0
        ]
        for sphere in range(len(problem.spheres)):
            geom = model.geom(sphere_geom(sphere)).id
            nearest = min(
                mujoco.mj_geomDistance(model, data, i, geom, 1.0, None)
                for i in arms
                if model.geom_type[i] != 0
            )
            assert nearest >= CLEARANCE - 1e-6


@pytest.mark.parametrize("name", PAPER)
def test_goals_are_the_faces_of_an_object_inside_its_box(envs, name):
    scene = SCENES[name]
    low, high = np.array(scene.object_box).T
    side = np.array([0.0, scene.palm_offset, 0.0])
    for problem in problems(envs[name]):
        assert (problem.centre >= low).all()
        assert (problem.centre <= high).all()
        assert problem.goals == pytest.approx(
            np.stack([problem.centre + side, problem.centre - side])
        )


def test_goals_lie_outside_every_obstacle_with_room_for_a_palm(envs):
    for problem in problems(envs["spheres"], count=40):
        assert problem.spheres.shape == (3, 4)
        for *centre, radius in problem.spheres:
            assert 0.03 <= radius <= 0.06
            assert np.linalg.norm(problem.goals - centre, axis=1).min() >= radius + 0.04
    for name in ("table", "shelf"):
        for problem in problems(envs[name]):
            for panel in SCENES[name].panels:
                assert (np.abs(problem.goals - panel.centre) - panel.half).max(axis=1).min() > 0.0


def test_a_problem_depends_on_seed_split_and_index_alone(envs):
    env = envs["spheres"]
    forwards = [env.problem(seed=3, split="test", index=index) for index in range(4)]
    backwards = [env.problem(seed=3, split="test", index=index) for index in (3, 2, 1, 0)][::-1]
    fresh = BatchEnv(find("spheres"), n=3, threads=2)
    again = [fresh.problem(seed=3, split="test", index=index) for index in range(4)]
    for one, two, three in zip(forwards, backwards, again, strict=True):
        for field in ("goals", "centre", "spheres", "angles"):
            assert (
                getattr(one, field).tobytes()
                == getattr(two, field).tobytes()
                == getattr(three, field).tobytes()
            )


def test_seeds_splits_and_indices_are_all_different(envs):
    env = envs["free"]
    drawn = {
        (seed, split, index): env.problem(seed=seed, split=split, index=index).goals.tobytes()
        for seed in (0, 1, 2)
        for split in ("train", "test")
        for index in range(12)
    }
    assert len(set(drawn.values())) == len(drawn)


def test_draws_fill_their_box(envs):
    centres = np.array([problem.centre for problem in problems(envs["free"], count=60)])
    low, high = np.array(SCENES["free"].object_box).T
    assert ((centres.max(axis=0) - centres.min(axis=0)) > 0.8 * (high - low)).all()


def test_an_unknown_split_is_refused(envs):
    with pytest.raises(ConfigError, match="unknown split 'validation'; choose one of: test, train"):
        envs["free"].problem(seed=0, split="validation", index=0)


def test_a_scene_that_asks_too_much_says_so(envs, monkeypatch):
    monkeypatch.setattr(draw, "ATTEMPTS", 3)
    far = replace(find("free"), object_box=((2.0, 2.1), (0.0, 0.1), (0.5, 0.6)))
    env = envs["free"]
    with pytest.raises(
        SimulationError, match=r"scene 'free': no feasible problem in 3 draws \(seed 0, episode 7\)"
    ):
        Draw(
            far,
            env.task.rules,
            env.task.model,
            EnvConfig(),
            standing=env._rest[1 : 1 + env.task.model.nq],
        ).problem(seed=0, split="train", index=7)


# starts of training


def elsewhere(name, **shares):
    return BatchEnv(find(name), EnvConfig(**shares), n=1, threads=1)


@pytest.mark.parametrize("name", ["table", "shelf", "planar"])
@pytest.mark.parametrize("share", ["start_line", "start_random", "start_solved"])
def test_training_starts_elsewhere_and_every_start_is_legal(envs, name, share):
    env, plain = elsewhere(name, **{share: 1.0}), envs[name]
    away = []
    for problem in problems(env):
        low, high = env.task.limits.T
        assert ((problem.angles >= low) & (problem.angles <= high)).all()
        env.draw.reach.place(problem.spheres)
        assert env.draw.reach.legal(problem.angles)
        away.append(np.abs(problem.angles - env.draw.reach.standing_angles).max())
    poses = len([pose for pose in env.scene.robot.poses if pose not in ("stand", "neutral")])
    if share == "start_line" and not poses:
        assert max(away) <= env.task.config.start_noise, "there is no other pose to go to"
    else:
        assert np.median(away) > 4 * env.task.config.start_noise
    for one, other in zip(problems(env, split="test"), problems(plain, split="test"), strict=True):
        assert one.angles.tobytes() == other.angles.tobytes(), (
            "what is judged begins where it always did"
        )
        assert one.goals.tobytes() == other.goals.tobytes()


def test_starts_on_the_line_lie_between_two_poses():
    env = elsewhere("table", start_line=1.0, start_noise=0.0)
    stand, home = env.draw.reach.standing_angles, env.draw.reach.angles_of(env.scene.robot, "home")
    shares = []
    for problem in problems(env):
        way = home - stand
        shares.append((problem.angles - stand) @ way / (way @ way))
        np.testing.assert_allclose(problem.angles, stand + shares[-1] * way, atol=1e-12)
    assert 0 <= min(shares) < 0.4
    assert 0.6 < max(shares) <= 1


def test_starts_near_solutions_are_nearer_to_goals_than_the_pose_is():
    env = elsewhere("table", start_solved=1.0)
    other = [env.problem(seed=7, split="test", index=index).goals for index in range(40)]

    def nearest(angles):
        palms = env.draw.reach.palms(angles)
        return min(np.linalg.norm(palms - goals, axis=1).max() for goals in other)

    near = np.median([nearest(problem.angles) for problem in problems(env)])
    assert near < 0.7 * nearest(env.draw.reach.standing_angles)


def test_shares_of_starts_are_what_was_asked_for():
    env = elsewhere("free", start_line=0.2, start_random=0.3)
    away = np.array(
        [
            np.abs(problem.angles - env.draw.reach.standing_angles).max()
            for problem in problems(env, count=200)
        ]
    )
    stayed = (away <= env.task.config.start_noise).mean()
    assert 0.4 < stayed < 0.62, "half of them; and a few of those on the line, near its beginning"
