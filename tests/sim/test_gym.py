"""The Gymnasium face: conformant, goal-conditioned, and the same physics as the batch."""

import pickle
import tomllib
import warnings
from importlib.metadata import EntryPoint
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.envs import registration
from gymnasium.utils.env_checker import check_env

from coordlog.errors import ConfigError, SpecError
from coordlog.sim.env import BatchEnv
from coordlog.sim.gym import GymEnv
from coordlog.sim.gym_ids import gym_id, register
from coordlog.tasks.config import EnvConfig, RewardConfig
from coordlog.tasks.scene import SCENES

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def env():
    return GymEnv("table")


@pytest.fixture(scope="module")
def arm():
    return GymEnv("planar", config=EnvConfig(max_steps=12))


def random_steps(env, count, *, seed=0):
    """Observations, rewards, endings and infos of random actions.

    Starts a new episode when one ends.
    """
    rng = np.random.default_rng(seed)
    env.reset(seed=seed)
    found = []
    for _ in range(count):
        found.append(env.step(rng.uniform(-1, 1, env.action_space.shape).astype(np.float32)))
        if found[-1][2] or found[-1][3]:
            env.reset()
    return found


@pytest.mark.parametrize("name", list(SCENES))
def test_passes_gymnasiums_checker_without_a_warning(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(GymEnv(name), skip_render_check=True)


def test_gymnasium_finds_the_ids_by_the_entry_point_of_the_package():
    """As `gymnasium.make` loads plugins: the entry point within a namespace of its name."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    ((name, value),) = project["entry-points"]["gymnasium.envs"].items()
    for scene in SCENES:
        gymnasium.registry.pop(gym_id(scene), None)
    with registration.namespace(name):
        EntryPoint(name, value, "gymnasium.envs").load()()
    assert set(map(gym_id, SCENES)) <= set(gymnasium.registry)
    register()  # again is harmless
    made = gymnasium.make("coordlog/free-v0")
    assert isinstance(made.unwrapped, GymEnv)
    observation, _ = made.reset(seed=0)
    assert made.observation_space.contains(observation)
    made.close()


@pytest.mark.parametrize("name", ["planar", "hold"])
def test_infos_have_the_same_keys_types_and_shapes_after_a_reset_as_after_a_step(name):
    env = GymEnv(name)
    _, first = env.reset(seed=0)
    *_, second = env.step(np.zeros(env.action_space.shape, np.float32))
    assert list(first) == list(second)
    for key, value in first.items():
        assert type(value) is type(second[key]), key
        assert np.shape(value) == np.shape(second[key]), key
    assert not first["collision"]
    assert (first["rewards"] == 0).all()


def test_a_pickled_environment_goes_on_with_the_next_problem():
    env = GymEnv("free", config=EnvConfig(max_steps=9), split="test")
    env.reset(seed=3)
    copy = pickle.loads(pickle.dumps(env))
    with pytest.raises(gymnasium.error.ResetNeeded):
        copy.step(np.zeros(copy.action_space.shape, np.float32))
    (one, said), (other, same) = env.reset(), copy.reset()
    assert {key: said[key] for key in ("seed", "index", "split")} == {
        "seed": 3,
        "index": 1,
        "split": "test",
    }
    assert [same[key] for key in ("seed", "index", "split")] == [3, 1, "test"]
    for key, value in one.items():
        assert value.tobytes() == other[key].tobytes(), key


def test_is_the_same_simulation_as_the_batch(env):
    batch = BatchEnv(SCENES["table"], n=1, threads=1)
    one = np.zeros(1, dtype=int)
    batch.reset(one, [batch.problem(seed=5, split="test", index=3)])
    observation, info = env.reset(seed=5, options={"index": 3, "split": "test"})
    assert (info["seed"], info["index"], info["split"]) == (5, 3, "test")
    rng = np.random.default_rng(0)
    for _ in range(20):
        action = rng.uniform(-1, 1, 13).astype(np.float32)
        observation, reward, terminated, truncated, info = env.step(action)
        outcome = batch.step(action[None], one)
        assert reward == outcome.reward[0].mean()
        assert info["rewards"].tobytes() == outcome.reward[0].tobytes()
        assert (terminated, truncated) == (outcome.terminated[0], outcome.truncated[0])
        assert info["collision"] == outcome.collision[0]
        goals = batch.task.goals(batch.physics.mocap_pos[:1]).ravel()
        assert observation["desired_goal"].tobytes() == goals.tobytes()
        distance = np.linalg.norm(
            (observation["desired_goal"] - observation["achieved_goal"]).reshape(2, 3), axis=1
        )
        assert distance == pytest.approx(info["distance"], abs=1e-12)


def test_the_observation_does_not_give_the_goals_away(env):
    """Else a goal swapped in hindsight would contradict the observation beside it."""
    names = [env._env.task.view.names[i] for i in env._seen]
    assert not [name for name in names if "goal" in name or "difference" in name]
    assert len(names) == 13 + 6 + 2


@pytest.mark.parametrize("name", ["env", "arm"])
def test_reward_and_endings_can_be_computed_again_for_one_and_for_many(name, request):
    env = request.getfixturevalue(name)
    found = random_steps(env, 40)
    for observation, reward, terminated, truncated, info in found:
        goals = observation["achieved_goal"], observation["desired_goal"]
        assert env.compute_reward(*goals, info) == reward
        assert env.compute_terminated(*goals, info) == terminated
        assert env.compute_truncated(*goals, info) == truncated
    achieved, desired = (
        np.stack([each[0][key] for each in found]) for key in ("achieved_goal", "desired_goal")
    )
    infos = [each[4] for each in found]
    assert env.compute_reward(achieved, desired, infos).tolist() == [each[1] for each in found]
    assert env.compute_terminated(achieved, desired, infos).tolist() == [each[2] for each in found]
    assert env.compute_truncated(achieved, desired, infos).tolist() == [each[3] for each in found]


def test_hindsight_reaches_its_goal_unless_something_was_touched(env):
    observation, _, _, _, info = random_steps(env, 1)[0]
    palms = observation["achieved_goal"]
    assert not info["collision"]
    assert env.compute_reward(palms, palms, info) == RewardConfig().kappa
    assert env.compute_terminated(palms, palms, info)
    assert not env.compute_truncated(
        palms, palms, {**info, "step": EnvConfig().max_steps}
    )  # it ended by itself
    assert env.compute_reward(palms, palms, {**info, "collision": True}) < 1.0
    assert env.compute_reward(palms, palms, {**info, "instability": True}) < 0.0


def test_an_info_that_is_not_steps_own_is_refused(env):
    with pytest.raises(SpecError, match=r"without 'collision' .*copy_info_dict=True"):
        env.compute_reward(np.zeros((2, 6)), np.zeros((2, 6)), [{}, {}])


def test_truncation_is_part_of_the_environment(arm):
    arm.reset(seed=1)
    ends = []
    for _ in range(12):
        *_, terminated, truncated, info = arm.step(np.zeros(8, dtype=np.float32))
        ends.append((terminated, truncated))
    assert ends == [(False, False)] * 11 + [(False, True)]
    assert info["step"] == 12


def test_a_seed_is_a_stream_of_problems(env):
    def goals(**reset):
        return env.reset(**reset)[0]["desired_goal"].tobytes()

    first, second = goals(seed=1), goals()
    assert first != second
    assert goals(seed=1) == first
    assert goals() == second
    assert goals(seed=1, options={"index": 1}) == second
    assert goals(options={"index": 0}) == first
    assert goals(seed=2) != first
    assert goals(seed=1, options={"split": "test"}) != first


def test_without_a_seed_two_environments_differ():
    one, other = GymEnv("planar"), GymEnv("planar")
    assert one.reset()[0]["desired_goal"].tobytes() != other.reset()[0]["desired_goal"].tobytes()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"goal": 1}, "unknown reset option 'goal'; choose one of: index, split"),
        ({"split": "all"}, "unknown split 'all'"),
        ({"index": -2}, "'index': expected a number from 0, got -2"),
    ],
)
def test_bad_reset_options_are_refused(env, options, message):
    with pytest.raises(ConfigError, match=message):
        env.reset(seed=0, options=options)


def test_bad_arguments_are_refused():
    with pytest.raises(ConfigError, match="unknown scene 'attic'"):
        GymEnv("attic")
    with pytest.raises(ConfigError, match="unknown split 'dev'"):
        GymEnv("free", split="dev")
    with pytest.raises(ConfigError, match="unknown render mode 'human'; choose one of: rgb_array"):
        GymEnv("free", render_mode="human")


def test_bad_actions_are_refused(env):
    env.reset(seed=0)
    with pytest.raises(
        SpecError, match=r"expected \(13,\) numbers in \[-1, 1\], got shape \(12,\)"
    ):
        env.step(np.zeros(12, dtype=np.float32))
    with pytest.raises(SpecError, match="nan"):
        env.step(np.full(13, np.nan, dtype=np.float32))


def test_actions_beyond_the_range_are_clipped(env):
    ends = []
    for value in (1.0, 5.0):
        env.reset(seed=0)
        ends.append(env.step(np.full(13, value, dtype=np.float32))[0]["achieved_goal"].tobytes())
    assert ends[0] == ends[1]


def test_a_step_before_a_reset_is_refused():
    with pytest.raises(gymnasium.error.ResetNeeded):
        GymEnv("planar").step(np.zeros(8, dtype=np.float32))


def test_a_diverged_simulation_ends_the_episode_with_numbers(env):
    before, _ = env.reset(seed=0)
    env._env.physics.qvel[0, 10] = np.nan
    with np.errstate(all="ignore"):
        observation, reward, terminated, truncated, info = env.step(np.zeros(13, dtype=np.float32))
    assert info["diverged"]
    assert (reward, terminated, truncated) == (0.0, False, True)
    assert env.observation_space.contains(observation)
    assert observation["observation"].tobytes() == before["observation"].tobytes()
    assert not env.reset()[1].get("diverged", False)
    assert not env.step(np.zeros(13, dtype=np.float32))[4]["diverged"]


def test_without_a_render_mode_there_is_no_picture(arm):
    arm.reset(seed=0)
    assert arm.render() is None
    arm.close()


def test_renders_an_image():
    pytest.importorskip("OpenGL")
    from coordlog.errors import SimulationError

    env = GymEnv("spheres", render_mode="rgb_array")
    env.reset(seed=0)
    try:
        image = env.render()
    except SimulationError:
        pytest.skip("no OpenGL here")
    assert image.shape == (360, 480, 3)
    assert len(np.unique(image)) > 100
    env.close()
    env.close()


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_learns_with_hindsight_replay_of_another_library():
    sb3 = pytest.importorskip("stable_baselines3")
    env = GymEnv("planar", config=EnvConfig(max_steps=15))
    model = sb3.DDPG(
        "MultiInputPolicy",
        env,
        replay_buffer_class=sb3.HerReplayBuffer,
        replay_buffer_kwargs={"n_sampled_goal": 4, "copy_info_dict": True},
        policy_kwargs={"net_arch": [8]},
        learning_starts=30,
        batch_size=16,
        buffer_size=1000,
        seed=0,
        device="cpu",
    )
    model.learn(45)
    batch = model.replay_buffer.sample(64)
    gap = (
        (batch.next_observations["achieved_goal"] - batch.next_observations["desired_goal"])
        .numpy()
        .reshape(64, 3, 3)
    )
    hit = np.linalg.norm(gap, axis=2).max(axis=1) < 0.02
    rewards = batch.rewards.numpy().ravel()
    assert hit.any()  # some goals were swapped for what was achieved
    assert (rewards[hit] == RewardConfig().kappa).all()
    assert (rewards[~hit] < 1.0).any()
