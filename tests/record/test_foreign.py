"""Environments of others: what is recorded of them replays to the bit, what they set themselves is
logged as such, and what cannot be replayed is said at the step that shows it."""

from dataclasses import replace
from typing import NamedTuple

import mujoco
import numpy as np
import pytest

from coordlog.errors import ConfigError, SimulationError, SpecError
from coordlog.record.foreign import Recorder, record_env, recording
from coordlog.record.foreign_env import attachments_of, simulation_of
from coordlog.record.reader import read_attachments, read_episode
from coordlog.record.writer import write_episode
from coordlog.sim.watch import Watch
from coordlog.verify.physics import check_replay

TEXT = """
<mujoco><option timestep="0.01"/><worldbody>
  <body><joint name="j"/><geom size=".1" pos=".2 0 0"/>
    <body pos=".4 0 0"><joint name="k" axis="0 1 0"/><geom size=".05" pos=".1 0 0"/></body></body>
</worldbody><actuator><motor joint="j"/><motor joint="k"/></actuator></mujoco>
"""


class Env:
    """As Gymnasium's: a swing with two joints, and one habit that some environments have."""

    def __init__(self, habit="", steps=12):
        self.model = mujoco.MjModel.from_xml_string(TEXT)
        self.data, self.habit, self.steps = mujoco.MjData(self.model), habit, steps

    @property
    def unwrapped(self):
        return self

    def _seen(self):
        return np.concatenate([self.data.qpos, self.data.qvel])

    def reset(self, seed=None):
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = np.random.default_rng(seed).uniform(-1, 1, 2)
        mujoco.mj_forward(self.model, self.data)
        self.count = 0
        return self._seen(), {}

    def step(self, action):
        model, data = self.model, self.data
        self.count += 1
        if self.habit == "teleports before":
            data.qpos[0] += 0.1
        for i in range(4):
            data.ctrl[:] = action
            if self.habit == "a controller of its own":
                data.ctrl[:] = action - 0.5 * data.qvel * i
            if self.habit == "in halves":
                mujoco.mj_step1(model, data)
                data.ctrl[:] = action - data.qvel
                mujoco.mj_step2(model, data)
            else:
                mujoco.mj_step(model, data)
        if self.habit == "pushes":
            data.xfrc_applied[1, 2] = float(self.count % 3)
        if self.habit == "forwards":
            mujoco.mj_forward(model, data)
        if self.habit == "teleports after" and self.count % 4 == 0:
            data.qvel[1] = 0.0
        if self.habit == "moved by something else":
            data.qpos[:], data.qvel[:] = np.random.default_rng(self.count).normal(size=(2, 2))
        if self.habit == "resets itself" and self.count == 5:
            mujoco.mj_resetData(model, data)
        info = {"height": float(data.xpos[2, 2]), "word": "no number"}
        return self._seen(), -1.0, False, self.count == self.steps, info


def policy(observation):
    return -0.3 * observation[:2]


HABITS = {
    "": 0,
    "a controller of its own": 0,
    "in halves": 0,
    "pushes": 0,
    "forwards": 0,
    "teleports before": 12,
    "teleports after": 3,
}


@pytest.mark.parametrize("habit", HABITS)
def test_every_step_of_an_episode_replays_to_the_bit(habit, tmp_path):
    recorder = record_env(Env(habit), policy, episodes=2, out=tmp_path, seed=3)
    assert len(recorder.files) == 2
    found = check_replay(recorder.files)
    assert found.findings == []
    assert found.steps == 24
    assert recorder.set_from_outside == 2 * HABITS[habit]
    episode = read_episode(recorder.files[0])
    assert episode.header.task == "environment"
    assert episode.header.episode["seed"] == 3
    assert episode.action.shape == (12, 2)
    assert episode.reward[:, 0].tolist() == [-1.0] * 12
    assert episode.substeps.tolist() == [4] * 12
    assert episode.observation[:, :2].tobytes() == episode.qpos.tobytes()
    assert episode.info_height.shape == (12,)
    assert episode.truncated.tolist() == [False] * 11 + [True]
    assert not episode.has("distance")


def test_a_changed_number_is_found(tmp_path):
    file = record_env(Env(), policy, episodes=1, out=tmp_path).files[0]
    episode = read_episode(file)
    ctrl = episode.columns["ctrl"].copy()
    ctrl[5, 0] = np.nextafter(ctrl[5, 0], 1.0)
    other = replace(episode, columns={**episode.columns, "ctrl": ctrl})
    write_episode(tmp_path / "other.mcap", other, attachments=read_attachments(file), display=False)
    findings = check_replay([tmp_path / "other.mcap"]).findings
    assert [f.step for f in findings] == [6]


@pytest.mark.parametrize(
    ("habit", "step", "said"),
    [
        ("moved by something else", 0, "something else moves this simulation"),
        ("resets itself", 4, "time went back"),
    ],
)
def test_what_cannot_be_replayed_is_said_at_the_step_that_shows_it(habit, step, said, tmp_path):
    with pytest.raises(SimulationError, match=f"step {step} cannot be replayed: .*{said}"):
        record_env(Env(habit), policy, episodes=1, out=tmp_path)
    files = list(tmp_path.glob("*.mcap"))
    assert len(files) == (1 if step else 0)
    for file in files:
        episode = read_episode(file)
        assert len(episode) == step
        assert episode.result.aborted.startswith(f"not replayable at step {step}")
        assert check_replay([file]).findings == []


def test_a_loop_of_ones_own_is_recorded(tmp_path):
    model = mujoco.MjModel.from_xml_string(TEXT)
    data = mujoco.MjData(model)
    with recording(model, data, tmp_path, name="swing", source=TEXT) as log:
        for step in range(30):
            data.ctrl[0] = np.sin(step)
            mujoco.mj_step(model, data, 3)
            log.step(data.ctrl, [1.0, 2.0], terminated=step == 29)
    file = next(tmp_path.glob("swing-*.mcap"))
    episode = read_episode(file)
    assert episode.result.returns == (30.0, 60.0)
    assert episode.terminated[-1]
    assert check_replay([file]).findings == []


def fail(model, folder):
    """A loop that ends in an error after one step."""
    data = mujoco.MjData(model)
    with recording(model, data, folder, source=TEXT) as log:
        mujoco.mj_step(model, data)
        log.step(data.ctrl)
        raise ZeroDivisionError


def test_a_loop_that_fails_keeps_what_it_did(tmp_path):
    with pytest.raises(ZeroDivisionError):
        fail(mujoco.MjModel.from_xml_string(TEXT), tmp_path)
    episode = read_episode(next(tmp_path.glob("*.mcap")))
    assert len(episode) == 1
    assert episode.result.aborted == "failed: ZeroDivisionError"


def test_mujoco_is_as_it_was_afterwards(tmp_path):
    before = mujoco.mj_step, mujoco.mj_step2
    record_env(Env(), policy, episodes=1, out=tmp_path)
    assert (mujoco.mj_step, mujoco.mj_step2) == before
    model = mujoco.MjModel.from_xml_string(TEXT)
    data, other = mujoco.MjData(model), mujoco.MjData(model)
    watch = Watch(model, data)
    mujoco.mj_step(model, other)
    mujoco.mj_step(model, data, 2)
    assert [row[0] for row in watch.taken()] == [0.0]
    watch.close()
    assert (mujoco.mj_step, mujoco.mj_step2) == before


def test_a_model_that_was_changed_after_it_was_compiled_is_logged_as_it_is(tmp_path):
    env = Env()
    env.model.body_mass[2] *= 1.7
    env.model.opt.gravity[2] = -3.0
    with pytest.raises(ConfigError, match="compiles to other physics"):
        Recorder(env, tmp_path)  # constants that follow from masses are still the old ones
    mujoco.mj_setConst(env.model, env.data)
    file = record_env(env, policy, episodes=1, out=tmp_path).files[0]
    assert check_replay([file]).findings == []


def test_what_is_not_on_mujoco_or_has_no_text_or_no_number_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="object: expected an environment on MuJoCo"):
        simulation_of(object())
    model = mujoco.MjModel.from_xml_string(TEXT)
    mujoco.MjModel.from_xml_string("<mujoco><worldbody/></mujoco>")
    with pytest.raises(ConfigError, match="the text that the model was compiled from"):
        attachments_of(model)
    with Recorder(Env(), tmp_path) as env:
        env.reset(seed=0)
        with pytest.raises(SpecError, match="action: expected numbers, got NaN"):
            env.step(np.array([np.nan, 0.0]))


def test_an_environment_of_gymnasiums(tmp_path):
    gym = pytest.importorskip("gymnasium")
    pytest.importorskip("imageio")
    env = gym.make("Reacher-v5", max_episode_steps=10)
    env.action_space.seed(0)
    recorder = record_env(env, lambda _: env.action_space.sample(), episodes=1, out=tmp_path)
    assert check_replay(recorder.files).findings == []
    assert recorder.set_from_outside == 0
    assert read_episode(recorder.files[0]).state.shape == (11, 10)


class Odd(Env):
    """A swing that gives something else at its fifth step."""

    def __init__(self, what, value):
        super().__init__()
        self.what, self.value = what, value

    def step(self, action):
        given = dict(
            zip(("seen", "reward", "over", "cut", "info"), super().step(action), strict=True)
        )
        if self.count == 5:
            given[self.what] = self.value
        return tuple(given.values())


@pytest.mark.parametrize(
    ("what", "value", "said"),
    [
        ("seen", np.full(4, np.nan), "step 4: state: expected numbers, got NaN"),
        ("seen", np.zeros(3), "step 4: state: expected 4 values as before, got 3"),
        ("reward", np.nan, "step 4: reward: expected numbers, got NaN"),
        ("cut", np.zeros(2, dtype=bool), "several environments in one"),
    ],
)
def test_an_odd_step_is_refused_and_what_came_before_it_replays(what, value, said, tmp_path):
    with pytest.raises(SpecError, match=said):
        record_env(Odd(what, value), policy, episodes=1, out=tmp_path)
    replays = check_replay(list(tmp_path.glob("*.mcap")))
    assert replays.steps == 4
    assert not replays.findings


@pytest.mark.parametrize("value", [np.float32(2.0), np.array([2.0], np.float32), 2, True])
def test_rewards_of_any_kind_of_number_are_logged(value, tmp_path):
    env = Env()
    with recording(env.model, env.data, tmp_path, source=TEXT) as log:
        env.reset()
        for _ in range(3):
            env.step(np.zeros(2))
            log.step(np.zeros(2), value)
    episode = read_episode(next(tmp_path.glob("*.mcap")))
    assert (episode.reward == float(np.squeeze(value))).all()


def test_numbers_that_come_later_in_an_info_are_left_out(tmp_path):
    env = Odd("info", {"height": 0.0, "is success/now": True, "": 1.0})
    record_env(env, policy, episodes=1, out=tmp_path)
    (file,) = tmp_path.glob("*.mcap")
    assert len(read_episode(file)) == 12


def test_from_python_a_policy_may_be_an_object_and_options_are_known(tmp_path):
    class Still:
        def act(self, observation):
            return np.zeros(2)

    import coordlog

    assert len(coordlog.record(Env(), Still(), episodes=2, out=tmp_path, source=TEXT)) == 2
    with pytest.raises(ConfigError, match="unknown option of an environment 'start'"):
        coordlog.record(Env(), Still(), out=tmp_path, start="stand")


def test_an_episode_that_has_ended_takes_no_more_steps(tmp_path):
    env = Env()
    env.reset()
    with recording(env.model, env.data, tmp_path, source=TEXT) as log:
        env.step(np.zeros(2))
        log.step(np.zeros(2), truncated=True)
        with pytest.raises(SimulationError, match="has ended"):
            log.step(np.zeros(2))


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("WIDE", "with the policy .*WIDE: ValueError: Action dimension"),
        ("NEEDS", "the class cannot be made without arguments"),
        ("", "write FILE.py:NAME"),
    ],
)
def test_a_policy_of_the_users_that_fails_is_said_to_be_theirs(name, said, tmp_path):
    pytest.importorskip("gymnasium")
    from coordlog.commands.foreign import record_environment

    file = tmp_path / "mine.py"
    file.write_text(
        "WIDE = lambda o: [0.0] * 7\nclass NEEDS:\n    def __init__(self, a): pass\n",
        encoding="utf-8",
    )
    chosen = f"{file}:{name}" if name else str(file)
    with pytest.raises(ConfigError, match=said):
        record_environment(
            "Reacher-v5", chosen, episodes=1, seed=0, out=tmp_path / "out", as_json=False
        )


class Step(NamedTuple):
    """A time step as dm_env has it."""

    step_type: int
    reward: float | None
    discount: float | None
    observation: dict

    def last(self):
        return self.step_type == 2


class Control(Env):
    """A swing as dm_control has it."""

    def _timed(self, kind, discount=1.0):
        return Step(kind, -1.0, discount, {"qpos": self.data.qpos.copy()})

    def reset(self):
        super().reset(0)
        return self._timed(0)

    def step(self, action):
        over = super().step(action)[3]
        return self._timed(2 if over else 1, 0.0 if self.habit == "ends" else 1.0)


class Suite(Env):
    """A swing as robosuite has it."""

    def reset(self):
        return {"qpos": super().reset(0)[0][:2]}

    def step(self, action):
        seen, reward, _, over, info = super().step(action)
        return {"qpos": seen[:2]}, reward, over, info


@pytest.mark.parametrize(
    ("env", "terminated"), [(Control(), False), (Control("ends"), True), (Suite(), True)]
)
def test_environments_of_other_libraries_are_recorded_as_they_are(env, terminated, tmp_path):
    done = record_env(env, lambda seen: -0.1 * seen["qpos"], episodes=1, out=tmp_path, source=TEXT)
    episode = read_episode(done.files[0])
    assert episode.terminated[-1] == terminated
    assert episode.truncated[-1] != terminated
    assert check_replay(done.files).findings == []


def test_a_second_recorder_knows_the_text_though_mujoco_has_compiled_others_since(tmp_path):
    env = Env()
    for _ in range(2):
        with Recorder(env, tmp_path) as recorder:
            recorder.reset(seed=0)
            recorder.step(np.zeros(2))
        mujoco.MjModel.from_xml_string("<mujoco><worldbody/></mujoco>")
    assert len(list(tmp_path.glob("*.mcap"))) == 2


def test_each_environment_of_a_vectorised_one_has_its_own_files(tmp_path):
    gym = pytest.importorskip("gymnasium")
    pytest.importorskip("imageio")
    envs = gym.vector.SyncVectorEnv([lambda: gym.make("Reacher-v5", max_episode_steps=4)] * 2)
    own = list(envs.envs)
    with Recorder(envs, tmp_path) as recorder:
        recorder.reset(seed=0)
        for _ in range(8):
            recorder.step(np.zeros((2, 2)))
    assert list(envs.envs) == own
    assert recorder.steps == 14  # after an ending, Gymnasium's next step is a reset
    files = sorted(tmp_path.glob("*.mcap"))
    assert len(files) == 4
    assert set(files) <= set(recorder.files)
    replays = check_replay(files)
    assert (replays.steps, replays.findings) == (14, [])


def test_environments_in_other_processes_are_refused():
    class Many:
        num_envs = 3

    with pytest.raises(ConfigError, match=r"use gymnasium\.vector\.SyncVectorEnv"):
        simulation_of(Many())


def test_a_weld_that_was_set_after_compilation_is_logged_as_it_is(tmp_path):
    hold = '<body name="hand" mocap="true" pos="0 0 1"/>'
    tie = '<equality><weld body1="hand" body2="bob"/></equality>'
    bob = '<body name="bob" pos=".1 .2 .9"><freejoint/><geom size=".05"/></body>'
    held = TEXT.replace("</worldbody>", hold + bob + "</worldbody>" + tie)
    model = mujoco.MjModel.from_xml_string(held)
    model.eq_data[0, 3:10] = (0, 0, 0, 1, 0, 0, 0)
    data = mujoco.MjData(model)
    with recording(model, data, tmp_path, source=held) as log:
        for _ in range(5):
            mujoco.mj_step(model, data, 2)
            log.step(data.ctrl)
    assert check_replay(list(tmp_path.glob("*.mcap"))).findings == []


def test_a_text_whose_files_lie_elsewhere_on_the_disk_is_logged_with_them(tmp_path):
    corners = [[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    (tmp_path / "box.obj").write_text(
        "".join(f"v {x} {y} {z}\n" for x, y, z in corners) + "f 1 2 3\nf 2 3 4\nf 5 6 7\nf 6 7 8\n"
    )
    text = TEXT.replace(
        "<worldbody>",
        f'<asset><mesh name="box" file="{tmp_path}/box.obj" scale=".1 .1 .1"/></asset><worldbody>'
        '<geom type="mesh" mesh="box" pos="0 0 -1"/>',
    )

    class Told(Env):
        """As robosuite's: a model's text from the environment, and a new model at every reset."""

        def __init__(self):
            super().__init__()
            self.data = None
            self.model, self.sim = self, self
            self._begin()

        def get_xml(self):
            return text

        def _begin(self):
            self._model = mujoco.MjModel.from_xml_string(text)
            self.data = mujoco.MjData(self._model)

        def reset(self, seed=None):
            self._begin()
            self.count = 0
            return self.data.qpos.copy(), {}

        def step(self, action):
            mujoco.mj_step(self._model, self.data)
            self.count += 1
            return self.data.qpos.copy(), 0.0, False, self.count == 3, {}

    done = record_env(Told(), lambda seen: np.zeros(2), episodes=2, out=tmp_path / "logs")
    (tmp_path / "box.obj").unlink()
    replays = check_replay(done.files)
    assert (replays.steps, replays.findings) == (6, [])
