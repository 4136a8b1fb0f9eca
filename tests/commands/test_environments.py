"""Learning from the logs of environments that are not ours, and acting in them with what was
learnt."""

import json
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from typer.testing import CliRunner

import coordlog
from coordlog.api.environments import Performance
from coordlog.cli import app
from coordlog.errors import ConfigError, SpecError
from coordlog.monitor import Monitor
from coordlog.policies.foreign import load
from coordlog.policies.learned import Policy
from coordlog.record.foreign import record_env, recording
from coordlog.record.recording import Recording
from tests.record.test_foreign import TEXT

RUN = CliRunner()
FEW = ["--set", "replay.batch=32", "--set", "replay.warmup=32", "--set", "network.hidden=[32, 32]"]


class Level:
    """A pointer whose joint is to be held level: reward 0 there, and less away from it; the second
    head asks for little effort."""

    text = TEXT

    def __init__(self, heads=1, noise=0.0):
        self.model = mujoco.MjModel.from_xml_string(self.text)
        self.data, self.heads, self.noise = mujoco.MjData(self.model), heads, noise

    def reset(self, seed=None):
        mujoco.mj_resetData(self.model, self.data)
        self.rng, self.count = np.random.default_rng(seed), 0
        self.data.qpos[:] = self.rng.uniform(-1, 1, 2)
        return self._seen(), {}

    def _seen(self):
        return {"angle": self.data.qpos.copy(), "speed": self.data.qvel.copy()}

    def step(self, action):
        self.data.qvel[:] = 0
        self.data.ctrl[:] = action
        self.data.qpos[:] += 0.2 * np.clip(action, -3, 3)
        mujoco.mj_step(self.model, self.data)
        self.count += 1
        reward = [-float(np.abs(self.data.qpos).sum()), -float(np.square(action).sum())]
        whole = reward[0] if self.heads == 1 else reward
        return self._seen(), whole, False, self.count == 15, {}


def wander(seed):
    """An action of chance that lasts for a while."""
    rng = np.random.default_rng(seed)
    return lambda observation: rng.uniform(-3, 3, 2)


def train(*arguments):
    return RUN.invoke(app, ["train", *map(str, arguments)])


def returns(files):
    return np.mean([sum(Recording(path).result.returns) for path in files])


def test_what_random_actions_led_to_teaches_to_act_better(tmp_path):
    random = record_env(
        Level(), wander(0), episodes=30, out=tmp_path / "logs", source=TEXT, verify=False
    )
    run = tmp_path / "run"
    done = train("--from", tmp_path / "logs", "--out", run, "--updates", 250, *FEW, "--set",
                 "learner.gamma=0.8", "--set", "learner.actor_rate=3e-3", "--set",
                 "learner.critic_rate=3e-3", "--set", "behaviour.weight=0.3", "--set",
                 "behaviour.final=0.3")  # fmt: skip
    assert done.exit_code == 0, done.output
    assert "nothing is evaluated" in done.output
    act, about = load(str(run))
    assert about["kind"] == "digrad"
    better = record_env(
        Level(), act, episodes=10, out=tmp_path / "b", seed=900, source=TEXT, verify=False
    )
    assert returns(better.files) > 0.5 * returns(random.files)  # both are negative
    by_name = coordlog.record(
        Level(), run, episodes=10, out=tmp_path / "c", seed=900, source=TEXT, verify=False
    )
    assert returns(by_name) == pytest.approx(returns(better.files))


def test_a_reward_of_several_numbers_is_a_critic_of_several_heads(tmp_path):
    record_env(Level(2), wander(0), episodes=4, out=tmp_path / "logs", source=TEXT, verify=False)
    done = train("--from", tmp_path / "logs", "--out", tmp_path / "run", "--updates", 4, *FEW)
    assert done.exit_code == 0, done.output
    said = json.loads((tmp_path / "run" / "run.json").read_text())
    assert list(said["env"]["arms"]) == ["reward_0", "reward_1"]
    row = json.loads((tmp_path / "run" / "metrics.jsonl").read_text().splitlines()[0])
    assert {"q_reward_0", "q_reward_1"} <= {*row}


def test_a_loop_of_ones_own_is_learnt_from_and_the_run_resumes_to_the_same_bits(tmp_path):
    model = mujoco.MjModel.from_xml_string(TEXT)
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    with recording(model, data, tmp_path / "logs", source=TEXT) as log:
        for step in range(60):
            data.ctrl[:] = rng.uniform(-1, 1, 2)
            mujoco.mj_step(model, data, 4)
            log.step(data.ctrl, reward=-abs(float(data.qpos[0])), truncated=step == 59)
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    given = ["--from", tmp_path / "logs", *FEW]
    assert train(*given, "--out", whole, "--updates", 20).exit_code == 0
    assert train(*given, "--out", parts, "--updates", 12).exit_code == 0
    assert train(*given, "--out", parts, "--updates", 20, "--resume").exit_code == 0
    acts = [load(str(folder))[0] for folder in (whole, parts)]
    seen = np.linspace(-1, 1, 4)
    assert np.array_equal(acts[0](seen), acts[1](seen))


def test_an_environment_of_gymnasiums_judges_what_was_learnt_of_it(tmp_path):
    pytest.importorskip("gymnasium")
    logs, run = tmp_path / "logs", tmp_path / "run"
    made = ["record", "--env", "InvertedPendulum-v5", "--episodes", "4", "--out", str(logs)]
    assert RUN.invoke(app, made).exit_code == 0
    few = [*FEW, "--updates", 6, "--eval-episodes", 2]
    done = train("--from", logs, "--out", run, *few, "--tensorboard")
    assert done.exit_code == 0, done.output
    assert "best: return" in done.output
    assert len(list((run / "episodes" / "eval-0000006").glob("*.mcap"))) == 2
    assert RUN.invoke(app, ["check", str(run / "episodes")]).exit_code == 0
    again = [*made[:-1], str(tmp_path / "again"), "--policy", str(run)]
    assert RUN.invoke(app, again).exit_code == 0
    drawn = RUN.invoke(app, ["plot", str(run), "--out", str(tmp_path / "curves.png")])
    assert drawn.exit_code == 0, drawn.output
    elsewhere = [
        "record",
        "--env",
        "Reacher-v5",
        "--policy",
        str(run),
        "--out",
        str(tmp_path / "x"),
    ]
    refused = RUN.invoke(app, elsewhere)
    assert isinstance(refused.exception, ConfigError)
    assert "learnt in 'InvertedPendulum-v5'" in str(refused.exception)
    older = [*again[:2], "InvertedPendulum-v4", *again[3:], "--json"]
    said = RUN.invoke(app, older)
    assert said.exit_code == 0, said.output
    assert "acts in 'InvertedPendulum-v4', whose model is" in said.stderr


class Heard(Monitor):
    """Keeps what is said."""

    def __init__(self):
        self.said = []

    def note(self, text):
        self.said.append(text)


class Elsewhere(Level):
    """Another environment, by its name."""


class Heavier(Level):
    """Of another model."""

    text = TEXT.replace('size=".05"', 'size=".06"')


class Renamed(Level):
    """Of another robot with as many joints."""

    text = TEXT.replace('"k"', '"elbow"')


@pytest.mark.parametrize(
    ("env", "named", "wanted"),
    [
        (Level, "Level", ""),
        (Heavier, "Level", "another model here than where it was learnt"),
        (Elsewhere, "Elsewhere", "acts in 'Elsewhere', whose model is the same"),
        (Heavier, "Heavier", None),
        (Renamed, "Renamed", None),
    ],
)
def test_what_was_learnt_acts_at_home_and_elsewhere_with_a_word_or_not_at_all(
    env, named, wanted, tmp_path
):
    record_env(Level(), wander(0), episodes=1, out=tmp_path / "l", source=TEXT, verify=False)
    run = tmp_path / "run"
    assert train("--from", tmp_path / "l", "--out", run, "--updates", 1, *FEW).exit_code == 0
    here = env()
    here.spec = SimpleNamespace(id=named)  # as Gymnasium says what an environment is called
    given = {"episodes": 1, "out": tmp_path / "new", "source": env.text, "verify": False}
    heard = Heard()
    if wanted is None:
        with pytest.raises(ConfigError, match=f"learnt in 'Level'.* than in '{named}'"):
            coordlog.record(here, run, monitor=heard, **given)
        assert not (tmp_path / "new").exists()
        return
    assert len(coordlog.record(here, run, monitor=heard, **given)) == 1
    assert [wanted in text for text in heard.said] == [True] * bool(wanted)


def test_an_evaluation_that_was_cut_goes_on_with_what_is_whole(tmp_path):
    record_env(Level(), wander(0), episodes=2, out=tmp_path / "l", source=TEXT, verify=False)
    run = tmp_path / "run"
    assert train("--from", tmp_path / "l", "--out", run, "--updates", 1, *FEW).exit_code == 0
    policy = Policy.load(run / "policy.safetensors")

    def judge(folder, env):
        folder = tmp_path / folder
        return Performance(env, policy.about["env"], folder, run="r", episodes=3, window=None)(
            policy, 7
        ), sorted((folder / "episodes" / "eval-0000007").iterdir())

    class Cut(Level):
        """The process is stopped in the second episode."""

        episodes = 0

        def reset(self, seed=None):
            self.episodes += 1
            return super().reset(seed)

        def step(self, action):
            if self.episodes == 2 and self.count == 9:
                raise KeyboardInterrupt
            return super().step(action)

    Cut.__name__ = "Level"
    figures, files = judge("whole", Level())
    with pytest.raises(KeyboardInterrupt):
        judge("cut", Cut())
    folder = tmp_path / "cut" / "episodes" / "eval-0000007"
    first = sorted(folder.iterdir())[0]
    kept = first.read_bytes()
    half = folder / (files[2].name + ".part")  # as a killed process leaves it
    half.write_bytes(files[2].read_bytes()[:4000])
    again, found = judge("cut", Level())
    assert again == figures
    assert first.read_bytes() == kept
    whole = [path for path in found if not Recording(path).result.aborted]
    assert [path.suffix for path in found] == [".mcap"] * 4
    assert len(whole) == 3


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("--live", None, "--live: only for coordlog's own scenes"),
        ("--memory", "1GB", "--memory: only for"),
        ("--scene", "table", "--scene: only for"),
        ("--hindsight", "0.5", "--hindsight: only for"),
        ("--set", "reward.n1=2.0", "[env], [reward] and [task]: only for"),
    ],
)
def test_what_only_our_scenes_have_is_refused(option, value, said, tmp_path):
    record_env(Level(), wander(0), episodes=1, out=tmp_path / "logs", source=TEXT, verify=False)
    given = [option] if value is None else [option, value]
    steps = ["--steps", "100"] if option == "--live" else []
    done = train("--from", tmp_path / "logs", "--out", tmp_path / "run", *given, *steps)
    assert isinstance(done.exception, ConfigError), done.output
    assert said in str(done.exception).replace("--live, --steps", "--live")


def test_logs_without_a_reward_teach_nothing(tmp_path):
    model = mujoco.MjModel.from_xml_string(TEXT)
    data = mujoco.MjData(model)
    with recording(model, data, tmp_path, source=TEXT) as log:
        for step in range(3):
            mujoco.mj_step(model, data)
            log.step(data.ctrl, truncated=step == 2)
    done = train("--from", tmp_path, "--out", tmp_path / "run")
    assert isinstance(done.exception, SpecError)
    assert "got 0 at every step" in str(done.exception)
