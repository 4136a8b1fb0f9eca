"""The batched environment keeps its contract, and its flags and endings are what happened."""

import json

import mujoco
import numpy as np
import pytest
import zstandard

from coordlog.episode import INITIAL_STATE, MODEL_XML
from coordlog.errors import ConfigError
from coordlog.kinematics.balance import support_margin
from coordlog.policies.expert import Expert
from coordlog.policies.noise import Random
from coordlog.sim.env import BatchEnv
from coordlog.sim.settling import settled
from coordlog.tasks.config import EnvConfig, RewardConfig
from coordlog.tasks.scene import SCENES, find
from tests.contracts import EnvContract

CURRENT = mujoco.mjtState.mjSTATE_INTEGRATION


class TestSpheres(EnvContract):
    k, n_u, n_x = 2, 13, 63

    def make(self, n):
        return BatchEnv(SCENES["spheres"], n=n, threads=1)


class TestPlanar(EnvContract):
    k, n_u, n_x = 3, 8, 35

    def make(self, n):
        return BatchEnv(SCENES["planar"], n=n, threads=1)


class TestShelfWatchingTheZeroMomentPoint(EnvContract):
    k, n_u, n_x = 2, 13, 44

    def make(self, n):
        return BatchEnv(
            SCENES["shelf"],
            EnvConfig(balance="com+zmp", state_extras=("difference", "velocity")),
            n=n,
            threads=1,
        )


def started(name="free", *, n=1, config=None, reward=None, start="stand"):
    env = BatchEnv(SCENES[name], config, reward, n=n, threads=1, start=start)
    env.reset(np.arange(n), [env.problem(seed=0, split="train", index=index) for index in range(n)])
    return env


def steps(env, action, count):
    """Outcomes of a constant action for all simulations, until one ends."""
    ids, action = np.arange(env.n), np.tile(np.asarray(action, dtype=np.float32), (env.n, 1))
    found = []
    for _ in range(count):
        found.append(env.step(action, ids))
        if (found[-1].terminated | found[-1].truncated).any():
            break
    return found


def joint(env, name, value=1.0):
    action = np.zeros(len(env.task.servos))
    action[env.scene.robot.action_joints.index(name)] = value
    return action


def test_an_unknown_start_pose_lists_the_choices():
    with pytest.raises(
        ConfigError, match="unknown start pose 'sit'; choose one of: home, neutral, stand"
    ):
        BatchEnv(find("free"), start="sit")


@pytest.mark.parametrize("start", ["stand", "home"])
def test_an_episode_starts_at_rest_on_its_soles(start):
    env = started(start=start)
    state = env.state.copy()
    outcomes = steps(env, np.zeros(13), 25)
    assert not any(outcome.collision.any() or outcome.instability.any() for outcome in outcomes)
    assert np.abs(env.physics.qvel).max() < 0.05
    assert np.abs(env.state - state).max() < 0.02


def test_time_starts_at_zero_and_counts_control_periods():
    env = started(n=2)
    assert env.simulation.time.tolist() == [0.0, 0.0]
    env.step(np.zeros((1, 13), dtype=np.float32), np.array([1]))
    assert env.simulation.time.tolist() == [0.0, 0.04]


def test_an_episode_is_truncated_at_its_last_step_and_not_before():
    env = started(config=EnvConfig(max_steps=7))
    outcomes = steps(env, np.zeros(13), 20)
    assert [bool(outcome.truncated[0]) for outcome in outcomes] == [False] * 6 + [True]
    assert not any(outcome.terminated[0] for outcome in outcomes)


def test_a_joint_moves_at_its_speed_and_stops_at_its_limit():
    env = started(config=EnvConfig(max_steps=1000))
    index = env.scene.robot.action_joints.index("l_elbow_y")
    place = env.task.qpos_index[index]
    angles = [env.physics.qpos[0, place]]
    for _ in range(80):
        env.step(
            np.asarray(joint(env, "l_elbow_y", -1.0), dtype=np.float32)[None],
            np.zeros(1, dtype=int),
        )
        angles.append(env.physics.qpos[0, place])
    speed = np.diff(angles)[20:40] / env.task.config.control_period
    assert speed == pytest.approx(-env.task.config.speed, rel=0.05)
    assert angles[-1] == pytest.approx(np.radians(-148), abs=0.02)
    assert min(angles) >= np.radians(-148) - 0.02


def test_a_joint_leaves_its_limit_as_soon_as_it_is_told_to():
    env = started(config=EnvConfig(max_steps=1000, smoothing=0.0))
    place, one = (
        env.task.qpos_index[env.scene.robot.action_joints.index("l_elbow_y")],
        np.zeros(1, dtype=int),
    )
    for value in [-1.0] * 120 + [1.0] * 8:  # far longer than the limit is away, then back
        env.step(joint(env, "l_elbow_y", value).astype(np.float32)[None], one)
    assert env.physics.qpos[0, place] > np.radians(-148) + 0.15


def test_the_spine_is_slower_than_the_arms_and_a_command_builds_up():
    env = started()
    config, target = env.task.config, env.simulation.target
    spine, elbow = (
        env.scene.robot.action_joints.index("abs_z"),
        env.scene.robot.action_joints.index("l_elbow_y"),
    )
    action = (joint(env, "abs_z") + joint(env, "l_elbow_y", -1.0)).astype(np.float32)[None]
    moved, filtered = [], 0.0
    for _ in range(4):
        before = target.copy()
        env.step(action, np.zeros(1, dtype=int))
        moved.append((env.simulation.target - before)[0, env.task.servos[[spine, elbow]]])
        filtered = config.smoothing * filtered + (1 - config.smoothing)
        assert moved[-1][0] == pytest.approx(filtered * config.shared_speed * config.control_period)
        assert moved[-1][1] == pytest.approx(-filtered * config.speed * config.control_period)


def test_legs_and_head_are_held():
    env = started(n=4)
    held = [i for i in range(env.task.model.nu) if i not in env.task.servos]
    assert len(held) == 14
    before = env.physics.ctrl[:, held].copy()
    steps(env, np.ones(13) * 0.5, 10)
    assert env.physics.ctrl[:, held].tobytes() == before.tobytes()


def test_throwing_the_spine_back_is_instability_and_ends_the_episode():
    env = started(config=EnvConfig(shared_speed=3.0, smoothing=0.0))
    outcomes = steps(
        env,
        joint(env, "abs_y", -1.0)
        + joint(env, "bust_y", -1.0)
        + joint(env, "l_shoulder_y")
        + joint(env, "r_shoulder_y"),
        60,
    )
    assert outcomes[-1].instability[0]
    assert outcomes[-1].terminated[0]
    assert not outcomes[-1].goal.any()
    assert (outcomes[-1].reward < -9).all()


def test_a_tipped_torso_is_instability_even_over_the_feet():
    upright, tipped = (started(config=EnvConfig(tilt=tilt)) for tilt in (1.2, 0.3))
    lean = joint(upright, "abs_y") + joint(upright, "bust_y")
    outcomes = steps(upright, lean, 45)
    assert not outcomes[-1].instability[0]
    assert steps(tipped, lean, 45)[-1].instability[0]


def test_watching_the_zero_moment_point_trips_earlier():
    """The spine thrown forward: its inertia counts before the centre of mass has gone anywhere."""
    lengths = {}
    for balance in ("com", "com+zmp"):
        env = started(config=EnvConfig(balance=balance, shared_speed=1.0, smoothing=0.0))
        outcomes = steps(env, joint(env, "abs_y") + joint(env, "bust_y"), 60)
        assert outcomes[-1].instability[0]
        lengths[balance] = len(outcomes)
    assert lengths["com+zmp"] < lengths["com"] - 5


def test_the_zero_moment_point_is_that_of_the_last_control_period():
    """Flags against a computation of our own, from the sensors before and after every step."""
    env = started(config=EnvConfig(balance="com+zmp", shared_speed=0.5, smoothing=0.5))
    model, sensors, one = env.task.model, env.physics.sensors, np.zeros(1, dtype=int)

    def read(name):
        return sensors[0, model.sensor(name).adr[0] + np.arange(3)].copy()

    flags = []
    for step in range(40):
        before = read("com_velocity")
        sway = joint(env, "abs_y", (-1.0) ** (step // 4)) + joint(
            env, "bust_y", (-1.0) ** (step // 4)
        )
        outcome = env.step(sway.astype(np.float32)[None], one)
        com, acceleration = read("com"), (read("com_velocity") - before) / 0.04
        point = com[:2] - com[2] / (9.81 + acceleration[2]) * acceleration[:2]
        corners = np.array(
            [read(f"{side}_foot_sole_corner_{i}") for side in "lr" for i in range(4)]
        )
        margin = min(support_margin(point, corners), support_margin(com[:2], corners))
        assert outcome.instability[0] == (margin < 0.01)
        flags.append(bool(outcome.instability[0]))
    assert 3 < sum(flags) < 37


def test_watching_the_zero_moment_point_does_not_trip_at_rest():
    assert not any(
        outcome.instability.any()
        for outcome in steps(started(config=EnvConfig(balance="com+zmp")), np.zeros(13), 30)
    )


def test_reaching_both_goals_ends_the_episode_with_kappa():
    reward = RewardConfig(kappa=77.0)
    env = started("planar", n=8, reward=reward)
    for sim in range(8):  # put the goals where the palms are
        env.physics.mocap_pos[sim, env.task.goal_mocaps] = env.task.palms(env.physics.sensors)[sim]
    (outcome,) = steps(env, np.zeros(8), 1)
    assert outcome.goal.all()
    assert outcome.terminated.all()
    assert (outcome.reward == 77.0).all()


def test_reaching_the_goals_with_the_last_step_is_no_truncation():
    env = started("planar", config=EnvConfig(max_steps=1))
    env.physics.mocap_pos[0, env.task.goal_mocaps] = env.task.palms(env.physics.sensors)[0]
    (outcome,) = steps(env, np.zeros(8), 1)
    assert outcome.terminated.tolist() == [True]
    assert outcome.truncated.tolist() == [False]


def test_two_of_three_goals_do_not_end_it():
    env = started("planar")
    env.physics.mocap_pos[0, env.task.goal_mocaps[:2]] = env.task.palms(env.physics.sensors)[0, :2]
    env.physics.mocap_pos[0, env.task.goal_mocaps[2]] = 0.3, 0.3, 0.0
    (outcome,) = steps(env, np.zeros(8), 1)
    assert outcome.goal.tolist() == [[True, True, False]]
    assert not outcome.terminated.any()


def test_distances_are_from_the_palms_to_the_goals():
    env = started("shelf", n=3)
    (outcome,) = steps(env, np.full(13, 0.3), 1)
    for sim in range(3):
        model, data = env.task.model, mujoco.MjData(env.task.model)
        mujoco.mj_setState(model, data, env.physics.rows[sim], CURRENT)
        mujoco.mj_forward(model, data)
        for i, arm in enumerate(env.scene.robot.arms):
            gap = data.body(f"goal_{arm.name}").xpos - data.site(arm.palm).xpos
            assert outcome.distance[sim, i] == pytest.approx(np.linalg.norm(gap), abs=1e-12)


def test_a_hand_on_the_table_is_a_collision_with_names():
    env = started("table", start="home")
    outcomes = steps(env, joint(env, "l_elbow_y") + joint(env, "r_elbow_y"), 30)
    first = next(outcome for outcome in outcomes if outcome.collision[0])
    names = {
        env.task.model.geom(int(i)).name
        for i in (*first.contacts[0]["geom1"], *first.contacts[0]["geom2"])
    }
    assert "table" in names
    assert (first.contacts[0]["depth"] >= 0).all()
    assert first.contacts[0]["z"] == pytest.approx(0.46, abs=0.03)
    assert first.reward[0] == pytest.approx(
        -first.distance[0] - 0.3 + 0.1 * first.boundary[0]
    )  # α 1, n1 0.3, m1 0.1


@pytest.mark.parametrize("name", ["table", "spheres"])
def test_the_attachments_are_enough_to_simulate_the_episode_again(name):
    env = started(name, n=2)
    files, unpack = env.attachments(1), zstandard.ZstdDecompressor().decompress
    models = (mujoco.MjModel.from_xml_string(unpack(files[MODEL_XML]).decode()),)
    assert set(files) == {MODEL_XML, INITIAL_STATE}
    start = np.frombuffer(files[INITIAL_STATE])
    config, action = (
        env.task.config,
        np.random.default_rng(0).uniform(-1, 1, (15, 13)).astype(np.float32),
    )
    for each in action:
        env.step(np.stack([each, each]), np.arange(2))
    for model in models:
        data = mujoco.MjData(model)
        mujoco.mj_setState(model, data, start, CURRENT)
        velocity, target = np.zeros(13), data.ctrl.copy()
        for each in action.astype(np.float64):  # by the book, without any of our classes
            velocity = config.smoothing * velocity + (1 - config.smoothing) * each
            after = target.copy()
            servos = env.task.servos
            after[servos] = np.clip(
                target[servos] + velocity * env.task.speeds * config.control_period,
                *env.task.limits.T,
            )
            for substep in range(10):
                data.ctrl[:] = target + (after - target) * ((substep + 1) / 10)
                mujoco.mj_step(model, data)
            target = after
        assert data.qpos.tobytes() == env.physics.qpos[1].tobytes()
        assert data.qvel.tobytes() == env.physics.qvel[1].tobytes()


def test_the_description_is_json_and_names_every_index():
    for scene in SCENES.values():
        described = json.loads(json.dumps(started(scene.name).describe()))
        layout = described["layout"]
        assert len(described["state"]) == layout["n_x"]
        assert len(described["action_joints"]) == layout["n_u"]
        assert len(described["arms"]) == layout["k"]
        assert len(described["joints"]) == len(described["actuators"])
        assert described["mujoco_version"] == mujoco.__version__


def test_settling_needs_no_luck():
    for name in ("free", "planar"):
        env = started(name)
        for pose in env.scene.robot.poses:
            row = settled(env.scene.robot, env.task.model, pose)
            assert row.tobytes() == settled(env.scene.robot, env.task.model, pose).tobytes()
            assert row[0] == 0.0  # time


def test_random_episodes_fall_collide_and_time_out_and_every_flag_is_consistent():
    n = 24
    env = started("table", n=n, config=EnvConfig(max_steps=60, shared_speed=1.0))
    policy = Random(n, 13)
    policy.begin(np.arange(n), env.state, [np.random.default_rng(i) for i in range(n)])
    running, ends = np.arange(n), {"fell": 0, "collided": 0, "timed out": 0}
    while len(running):
        outcome = env.step(policy.act(running, env.state[running]), running)
        assert (outcome.terminated == (outcome.instability | outcome.goal.all(axis=1))).all()
        assert (outcome.goal <= outcome.boundary).all()
        assert ([len(rows) > 0 for rows in outcome.contacts] == outcome.collision).all()
        ends["fell"] += int(outcome.instability.sum())
        ends["collided"] += int(outcome.collision.sum())
        ends["timed out"] += int(outcome.truncated.sum())
        running = running[~(outcome.terminated | outcome.truncated)]
    assert min(ends.values()) > 0, ends


def test_the_expert_ends_an_episode_on_its_goals():
    env = started("free", n=2)
    expert, ids = Expert(env.task, env.draw.reach, 2), np.arange(2)
    expert.begin(ids, env.state, [np.random.default_rng(i) for i in range(2)])
    while True:
        outcome = env.step(expert.act(ids, env.state[ids]), ids)
        if outcome.terminated.any() or outcome.truncated.any():
            break
    assert (outcome.distance[outcome.terminated] < 0.03).all()
    assert (outcome.reward[outcome.terminated] == env.task.reward.kappa).all()


# decisions slower than the servo ticks


def test_a_slow_decision_is_several_fast_ones():
    """Three of 0.04 s with the same action lead to where one of 0.12 s does, contacts and flags
    included."""
    fast = started("table", n=2, config=EnvConfig(smoothing=0.0))
    slow = started("table", n=2, config=EnvConfig(smoothing=0.0, control_period=0.12, max_steps=50))
    ids, touched = np.arange(2), []
    action = np.tile(sum(joint(fast, f"{side}_shoulder_y", -0.8) for side in "lr"), (2, 1)).astype(
        np.float32
    )  # no joint gets to its stop
    for _ in range(8):
        parts = [fast.step(action, ids) for _ in range(3)]
        whole = slow.step(action, ids)
        np.testing.assert_allclose(slow.simulation.qpos, fast.simulation.qpos, atol=1e-9)
        np.testing.assert_array_equal(
            whole.collision, np.any([part.collision for part in parts], axis=0)
        )
        np.testing.assert_array_equal(whole.instability, parts[-1].instability)
        touched.append(whole.collision)
    np.testing.assert_allclose(slow.simulation.time, fast.simulation.time)
    assert np.any(touched), "something was touched, so that the flags were looked at"
    assert not np.all(touched)


# obstacles that are larger in training


def test_panels_grow_by_what_was_asked_for_on_every_side():
    true, larger = started("shelf"), started("shelf", config=EnvConfig(inflate=0.005))
    for panel in true.scene.panels:
        before, after = (env.task.model.geom(panel.name) for env in (true, larger))
        np.testing.assert_allclose(after.size, before.size + 0.005, atol=1e-12)
        np.testing.assert_array_equal(after.pos, before.pos)
    np.testing.assert_array_equal(true.state, larger.state)


def test_the_policy_is_told_the_true_size_of_spheres_that_are_larger():
    true, larger = started("spheres"), started("spheres", config=EnvConfig(inflate=0.01))
    radii = true.problem(seed=0, split="train", index=0).spheres[:, 3]
    np.testing.assert_allclose(
        larger.physics.model_of(0).geom_size[larger.task.sphere_geoms, 0], radii + 0.01
    )
    np.testing.assert_allclose(larger.state, true.state, atol=1e-6)


@pytest.mark.parametrize(
    ("key", "value"), [("inflate", 0.03), ("start_line", 1.5), ("start_random", -0.1)]
)
def test_what_makes_training_easier_has_a_range(key, value):
    with pytest.raises(ConfigError, match=f"{key}: expected"):
        EnvConfig(**{key: value})
    with pytest.raises(
        ConfigError, match=r"start_line \+ start_random: expected at most 1, got 1.2"
    ):
        EnvConfig(start_line=0.6, start_random=0.6)
