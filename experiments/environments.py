"""Environments of other people's libraries: recorded, simulated again, and what recording costs.

    python -m experiments.environments --work FOLDER --out TABLE.md [--only Reacher-v5 …]

Needs gymnasium[mujoco], gymnasium-robotics, dm-control and robosuite, each where it can be imported;
what cannot be made is named with its own library's reason. Random actions; a bare loop of one's own
is among them. Costs are processor time of one and the same run: bare, recorded, and recorded with
each step simulated again.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np

from coordlog.record.foreign import Recorder, record_env
from coordlog.record.foreign_env import after, takes_seed
from coordlog.verify.physics import check_replay

EPISODES = 63
"""Of each: eight environments make 500 together."""
COSTED = 1000
"""Steps over which costs are taken."""
ROUNDS = 3
HEAD = (
    "environment",
    "episodes",
    "steps",
    "set by the environment itself",
    "simulated again",
    "recorded, times bare",
    "and verified",
    "said",
)
SWING = """
<mujoco><option timestep="0.01"/><worldbody>
  <body><joint name="swing"/><geom size=".1" pos=".2 0 0"/></body>
</worldbody><actuator><motor joint="swing"/></actuator></mujoco>"""


class Bare:
    """A loop of one's own: a swing that is pushed, with a force that no control says."""

    def __init__(self) -> None:
        self.model = mujoco.MjModel.from_xml_string(SWING)
        self.data = mujoco.MjData(self.model)
        self.steps = 0

    def reset(self, seed: int | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin anew."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = np.random.default_rng(seed).uniform(-1, 1)
        self.steps = 0
        return self.data.qpos.copy(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Four physics steps."""
        self.data.ctrl[:] = action
        self.data.xfrc_applied[1, 2] = self.steps % 3
        mujoco.mj_step(self.model, self.data, 4)
        self.steps += 1
        return self.data.qpos.copy(), 0.0, False, self.steps == 100, {}


def gymnasium_env(name: str) -> tuple[Any, Callable[[], Any]]:
    """One of Gymnasium's, or of gymnasium-robotics."""
    import gymnasium

    if not name.endswith("-v5"):
        robotics()
    env = gymnasium.make(name)
    env.action_space.seed(0)
    return env, env.action_space.sample


def robotics() -> None:
    """Register gymnasium-robotics' environments. Version 1.4.2 looks up a joint's kind in a way
    that MuJoCo 4.0 no longer answers; its four functions that do are given anew.
    """
    import gymnasium
    import gymnasium_robotics
    from gymnasium_robotics.utils import mujoco_utils

    def give(part: str, data_of: Any, name: str, value: Any) -> None:
        getattr(data_of.joint(name), part)[:] = value

    for part in ("qpos", "qvel"):
        setter = lambda model, data, name, value, part=part: give(part, data, name, value)  # noqa: E731
        getter = lambda model, data, name, part=part: getattr(data.joint(name), part).copy()  # noqa: E731
        setattr(mujoco_utils, f"set_joint_{part}", setter)
        setattr(mujoco_utils, f"get_joint_{part}", getter)
    gymnasium.register_envs(gymnasium_robotics)


def control_suite(domain: str, task: str) -> tuple[Any, Callable[[], Any]]:
    """One of dm_control's. Version 1.0.50 lists arrays of a model that MuJoCo 4.0 no longer has;
    they are struck from its list.
    """
    from dm_control.mujoco.wrapper.mjbindings import sizes

    for struct, kind in (("mjmodel", mujoco.MjModel), ("mjdata", mujoco.MjData)):
        listed = sizes.array_sizes[struct]
        for name in [each for each in listed if not hasattr(kind, each)]:
            del listed[name]
    from dm_control import suite

    env = suite.load(domain, task, task_kwargs={"random": 0, "time_limit": 2.0})
    bounds, rng = env.action_spec(), np.random.default_rng(0)
    return env, lambda: rng.uniform(bounds.minimum, bounds.maximum)


def robosuite_env(name: str) -> tuple[Any, Callable[[], Any]]:
    """One of robosuite's. Version 1.5.2 asks of what kind a joint is, and for the inertia matrix, in
    ways that MuJoCo 4.0 no longer answers; the functions that do are given anew.
    """
    import robosuite
    from robosuite.controllers.parts import controller
    from robosuite.utils.binding_utils import MjData, MjModel

    inertia = lambda model, matrix, data: mujoco.mj_fullM(model, data, matrix)  # noqa: E731
    controller.mujoco = SimpleNamespace(**{**vars(mujoco), "mj_fullM": inertia})
    MjData.qM = property(lambda data: data._data)

    def place(model: Any, joint: str, starts: str, widths: tuple[int, ...]) -> Any:
        at = model.joint_name2id(joint)
        start, width = int(getattr(model, starts)[at]), widths[int(model.jnt_type[at])]
        return start if width == 1 else (start, start + width)

    MjModel.get_joint_qpos_addr = lambda model, name: place(
        model, name, "jnt_qposadr", (7, 4, 1, 1)
    )
    MjModel.get_joint_qvel_addr = lambda model, name: place(model, name, "jnt_dofadr", (6, 3, 1, 1))
    env = robosuite.make(
        name,
        robots="Panda",
        has_renderer=False,
        has_offscreen_renderer=False,
        use_camera_obs=False,
        horizon=50,
        hard_reset=False,
    )
    low, high = env.action_spec
    rng = np.random.default_rng(0)
    return env, lambda: rng.uniform(low, high)


def bare() -> tuple[Any, Callable[[], Any]]:
    """The loop of one's own."""
    rng = np.random.default_rng(0)
    return Bare(), lambda: rng.uniform(-1, 1, 1)


ENVIRONMENTS: dict[str, Callable[[], tuple[Any, Callable[[], Any]]]] = {
    **{
        name: partial(gymnasium_env, name)
        for name in ("Reacher-v5", "Pusher-v5", "Ant-v5", "FetchReach-v4", "HandReach-v3")
    },
    "dm_control cheetah run": partial(control_suite, "cheetah", "run"),
    "robosuite Lift": partial(robosuite_env, "Lift"),
    "a bare loop": bare,
}


def steps_of(env: Any, act: Callable[[], Any], count: int) -> float:
    """Processor time of some steps, resets left out [s]."""
    spent, done = 0.0, 0
    inner = getattr(env, "_env", env)
    seeds = itertools.count() if takes_seed(inner.reset) else None
    while done < count:
        env.reset(**({"seed": next(seeds)} if seeds else {}))
        over, began = False, time.process_time()
        while not over and done < count:
            found = after(env, env.step(act()))
            over = found.terminated or found.truncated
            done += 1
        spent += time.process_time() - began
    return spent


def costs(env: Any, act: Callable[[], Any], work: Path) -> tuple[float, float]:
    """Step time recorded, without and with verification, in units of the bare step time."""
    ratios = []
    for _ in range(ROUNDS):
        plain = steps_of(env, act, COSTED)
        taken = []
        for verify in (False, True):
            with Recorder(env, work, verify=verify, source=_source(env)) as recorder:
                taken.append(steps_of(recorder, act, COSTED) / plain)
        ratios.append(taken)
    low, high = np.median(ratios, axis=0)
    return float(low), float(high)


def _source(env: Any) -> str | None:
    return SWING if isinstance(env, Bare) else None


def line(name: str, work: Path, episodes: int) -> list[str]:
    """One line of the table."""
    try:
        env, act = ENVIRONMENTS[name]()
    except Exception as error:  # noqa: BLE001 - whatever another library raises
        return [name, *["-"] * 6, f"{type(error).__name__}: {error}".splitlines()[0]]
    folder = work / name.replace(" ", "-")
    policy = lambda observation: act()  # noqa: E731
    try:
        done = record_env(env, policy, episodes=episodes, out=folder, source=_source(env))
    except Exception as error:  # noqa: BLE001 - as above, or a step that cannot be replayed
        return [name, *["-"] * 6, f"{type(error).__name__}: {error}".splitlines()[0]]
    replays = check_replay(done.files)
    sound = "all sound" if not replays.findings else f"{len(replays.findings)} findings"
    plain, verified = costs(env, act, work / f"{folder.name}-costs")
    said = "; ".join(sorted(set(replays.inexact.values())))
    counts = (len(done.files), f"{replays.steps:,}", done.set_from_outside, sound)
    return [name, *map(str, counts), f"{plain:.2f}", f"{verified:.2f}", said]


def main() -> None:
    """Write the table, a line at a time."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--episodes", type=int, default=EPISODES)
    parser.add_argument("--only", nargs="*", default=list(ENVIRONMENTS))
    asked = parser.parse_args()
    lines = ["| " + " | ".join(HEAD) + " |", "|" + "---|" * len(HEAD)]
    for name in asked.only:
        lines.append("| " + " | ".join(line(name, asked.work, asked.episodes)) + " |")
        asked.out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
