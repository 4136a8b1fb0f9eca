"""The page of contracts: what a step led to, column by column."""

import copy
import inspect
import pickle

import mujoco
import numpy as np
import pytest

from coordlog import contracts
from coordlog.contracts import Outcome
from coordlog.sim.env import BatchEnv
from coordlog.tasks.scene import SCENES


def stepped(name, count=3):
    env = BatchEnv(SCENES[name], n=2, threads=1)
    ids = np.arange(2)
    env.reset(ids, [env.problem(seed=0, split="train", index=i) for i in range(2)])
    start = env.physics.rows.copy()
    action = np.random.default_rng(0).uniform(-1, 1, (count, 2, env.layout.n_u))
    return env, start, [env.step(each.astype(np.float32), ids) for each in action]


def test_every_column_is_an_attribute_and_another_name_lists_them():
    outcome = Outcome({"reward": np.ones((2, 1))}, np.zeros(2, bool), [])
    assert outcome.reward is outcome.columns["reward"]
    with pytest.raises(AttributeError, match=r"its columns \(reward\), got 'goal'"):
        _ = outcome.goal
    for again in (copy.copy(outcome), pickle.loads(pickle.dumps(outcome))):
        assert again.reward.tolist() == [[1.0], [1.0]]


def test_an_outcome_has_the_columns_of_the_core_and_of_the_task():
    env, _, outcomes = stepped("planar", 1)
    own = [field.name for field in env.fields]
    core = ["reward", "terminated", "truncated", "ctrl", "torque"]
    assert list(outcomes[0].columns) == core + own
    for field in env.fields:
        assert outcomes[0].columns[field.name].dtype == field.type
    assert env.describe()["task"]["name"] == env.task.name


@pytest.mark.parametrize("name", ["table", "planar"])
def test_ctrl_and_torque_are_those_at_the_end_of_the_step(name):
    """Against MuJoCo stepped plainly, one substep after the other."""
    env, start, outcomes = stepped(name)
    model, count = env.task.model, env.task.substeps
    for sim in range(2):  # both: what one shows must not be what the other left
        data = mujoco.MjData(model)
        mujoco.mj_setState(model, data, start[sim], mujoco.mjtState.mjSTATE_INTEGRATION)
        before = data.ctrl.copy()
        for outcome in outcomes:
            after = outcome.ctrl[sim]
            for i in range(count):
                data.ctrl[:] = before + (after - before) * ((i + 1.0) / count)
                mujoco.mj_step(model, data)
            assert outcome.torque[sim].tobytes() == data.actuator_force.tobytes()
            assert np.abs(outcome.torque[sim]).max() > 0.01
            before = after


def implementers():
    from coordlog.kinematics.clearance import SceneChecker
    from coordlog.policies.damper import Shielded
    from coordlog.policies.expert import Expert
    from coordlog.policies.learned import Policy as Network
    from coordlog.record.recorder import Recorder
    from coordlog.record.store import LocalStore, PackStore
    from coordlog.sim.replay import LogEnv, Logged
    from coordlog.sim.traced import Traced
    from coordlog.tasks.registry import TASKS
    from coordlog.tasks.unknown import UnknownTask
    from coordlog.train.digrad import Learner

    return {
        contracts.Task: [*(kind for kind, _ in TASKS.values()), UnknownTask],
        contracts.Env: [BatchEnv, Recorder, LogEnv, Traced],
        contracts.Policy: [Expert, Network, Shielded, Logged],
        contracts.Checker: [SceneChecker],
        contracts.Learner: [Learner],
        contracts.Store: [LocalStore, PackStore],
    }


def test_whoever_implements_a_contract_has_its_members_with_its_arguments():
    for contract, kinds in implementers().items():
        members = {name for name in vars(contract) if not name.startswith("_")}
        assert members
        for kind in kinds:
            for name in members:
                asked = getattr(contract, name)
                if not callable(asked):
                    assert hasattr(kind, name) or name == "name", (kind, name)
                    continue
                wanted = inspect.signature(asked).parameters
                got = inspect.signature(getattr(kind, name)).parameters
                assert list(got)[: len(wanted)] == list(wanted), (kind, name)
