"""Recording: a policy acts in simulations of a scene, or in somebody else's environment."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from coordlog.errors import ConfigError
from coordlog.monitor import Monitor
from coordlog.parallel import shard as share

if TYPE_CHECKING:
    from coordlog.contracts import Policy
    from coordlog.episode import Json
    from coordlog.policies.foreign import Act
    from coordlog.record.branches import Parents
    from coordlog.record.recorder import Recorder
    from coordlog.record.spool import Sink
    from coordlog.sim.env import BatchEnv
    from coordlog.sim.scoring import Scoreboard
    from coordlog.tasks.scene import Scene

EPISODES = 10
"""How many are recorded without a word."""


@dataclass(frozen=True)
class RecordPlan:
    """What is to be recorded of a scene.

    Example:
        >>> RecordPlan(scene="shelf", episodes=512, noise=0.15).policy
        'expert'
    """

    scene: str | Scene = ""
    """A scene, its name, FILE.py:NAME or ROBOT.toml; by default the policy's, or table."""
    policy: Any = "expert"
    """Its name as on the command line, or a `Policy` (`coordlog.contracts`)."""
    episodes: int | None = None
    """How many; by default 10, or one per branch."""
    seed: int = 0
    """Of goals, obstacles, start poses and noise."""
    split: str = "train"
    """"train", or "test": problems that training never sees."""
    noise: float = 0.0
    """Standard deviation of Gaussian noise on the actions; logged."""
    noise_correlation: float = 0.0
    """Of the noise from step to step, 0 to below 1."""
    shield: bool | None = None
    """Whether a velocity damper is around the policy; None: as its card says."""
    branch: Sequence[str | Path] | None = None
    """Folders of logs; each episode begins in one of those, just before it went wrong."""
    where: str = ""
    """Which of them, in SQL."""
    start: str = "stand"
    """Start pose of the robot."""
    pack: bool = False
    """Write a pack: many episodes in a few large files."""
    shard: str = ""
    """ "I/N": the I-th of N equal shares of the episodes."""
    envs: int = 16
    """Simulations at once; changes the speed, never the result."""
    threads: int = 0
    """Threads to simulate on; 0 for all cores."""
    config: Path | None = None
    """TOML file with tables [env], [reward], [task], [policy] and [damper]."""
    tables: Mapping[str, Any] = field(default_factory=dict)
    """The same as tables by name, in place of those of the file."""
    epoch: int | None = None
    """Start time [ns since 1970]; equal runs then write equal bytes."""
    display: bool = True
    """Also write topics for viewers."""

    def __post_init__(self) -> None:
        for name, least in (("episodes", 1), ("envs", 1), ("threads", 0), ("seed", 0)):
            value = getattr(self, name)
            if value is not None and value < least:
                raise ConfigError(f"{name}: expected at least {least}, got {value}")


class Recorded(NamedTuple):
    """What came of it."""

    files: list[Path]
    """The episodes, by name; addresses where they were handed to a store."""
    figures: Json
    """Counts and rates, by name; rates are of the episodes that ended."""


def record_scene(plan: RecordPlan, out: Path, monitor: Monitor) -> Recorded:
    """Record episodes of a scene into a folder, a pack or an object store.

    Raises:
        ConfigError: for an unknown name, or a value out of range.
        SpecError: for a policy that does not fit the scene.
        SimulationError: if physics cannot be built.
        StorageError: if a file cannot be written.
    """
    from coordlog.catalog.asking import catalogued
    from coordlog.config import read_toml
    from coordlog.policies.scripted import TABLES, with_noise
    from coordlog.record.beside import keep
    from coordlog.record.branches import Branched
    from coordlog.record.recorder import Recorder
    from coordlog.record.spool import sink_at
    from coordlog.sim.examine import scarce
    from coordlog.sim.rollout import rollout
    from coordlog.sim.scoring import Scoreboard

    parents = _parents(plan, monitor)
    numbers = share(range(plan.episodes or (len(parents) if parents else EPISODES)), plan.shard)
    tables = (read_toml(plan.config) if plan.config else {}) | dict(plan.tables)
    around = {name: table for name, table in tables.items() if name not in TABLES}
    env = _env(plan, around, parents, monitor, envs=max(min(plan.envs, len(numbers)), 1))
    chosen, described = _policy(plan, env, tables)
    actor, described["noise"] = with_noise(
        chosen, env, sigma=plan.noise, correlation=plan.noise_correlation
    )
    board = Scoreboard(env.n, env.layout.k)
    steps, began = 0, time.perf_counter()
    with (
        sink_at(out, monitor, pack=plan.pack) as sink,
        monitor.progress(f"recording {env.scene.name}", len(numbers)) as progress,
    ):
        make = partial(Branched, parents) if parents else Recorder
        options: Json = {"display": plan.display, "epoch": plan.epoch, "finished": sink.take}
        keep(out, env.looks.meshes)
        with make(env, sink.folder, policy=described, **options) as recorder:
            for ids, outcome in rollout(recorder, actor, numbers, seed=plan.seed, split=plan.split):
                board.add(ids, outcome)
                steps += len(ids)
                speed = steps / (time.perf_counter() - began)
                progress.update(len(sink.done), f"{speed:,.0f} steps/s")
                if monitor.stopped:
                    break
        progress.update(len(sink.done))
    seconds = time.perf_counter() - began
    catalogued(out, [item.path for item in sink.done])
    if seldom := scarce(env):
        monitor.note(seldom)
    found = _figures(board, sink, recorder, steps=steps, seconds=seconds)
    return Recorded([Path(name) for name in found["files"]], {**found, "wanted": len(numbers)})


def _parents(plan: RecordPlan, monitor: Monitor) -> Parents | None:
    """The logs to branch from, if any."""
    from coordlog.api.logs import load_logs
    from coordlog.record.branches import Parents

    if plan.where and not plan.branch:
        raise ConfigError(
            "--where: chooses among the logs of --branch, of which there are none; "
            "name their folders"
        )
    if not plan.branch:
        return None
    return Parents(
        load_logs([Path(each) for each in plan.branch], where=plan.where, monitor=monitor)
    )


def _env(
    plan: RecordPlan,
    tables: Mapping[str, Any],
    parents: Parents | None,
    monitor: Monitor,
    *,
    envs: int,
) -> BatchEnv:
    """The scene that was asked for, or the policy's, with constants of logs or training."""
    from coordlog.policies.registry import DEFAULT_SCENE, about, policy_file
    from coordlog.sim.making import make_env
    from coordlog.tasks.own import scene_of
    from coordlog.tasks.scene import find

    asked = scene_of(plan.scene) if isinstance(plan.scene, str) and plan.scene else plan.scene
    if not asked and parents:
        asked = find(parents.scene)
    if parents and asked and asked.name != parents.scene:
        raise ConfigError(
            f"--scene: expected the scene of the logs to branch from, '{parents.scene}', "
            f"got '{asked.name}'; leave it out"
        )
    file = None
    if isinstance(plan.policy, str):
        file = policy_file(plan.policy, asked.name if asked else DEFAULT_SCENE)
    trained = about(file) if file else {}
    return make_env(
        asked or find(trained.get("scene", DEFAULT_SCENE)),
        tables,
        start=parents.start if parents else plan.start,
        envs=envs,
        threads=plan.threads,
        like=parents.env if parents else trained.get("env"),
        doubts=monitor.note,
    )


def _policy(plan: RecordPlan, env: BatchEnv, tables: Mapping[str, Any]) -> tuple[Policy, Json]:
    """Who acts, and the `coordlog.policy` record without noise."""
    from coordlog.policies.registry import make_policy
    from coordlog.policies.scripted import Constants, require_none, shield_said, with_shield

    constants = Constants.of(tables)
    if isinstance(plan.policy, str):
        return make_policy(plan.policy, env, shield=plan.shield, constants=constants)
    name = type(plan.policy).__name__
    require_none(constants, name)
    said: Json = {"kind": "own", "name": name, "checkpoint_sha256": ""}
    if not plan.shield:
        return plan.policy, said
    shielded = with_shield(plan.policy, env, constants.damper)
    return shielded, said | shield_said(constants.damper)


def _figures(
    board: Scoreboard, sink: Sink, recorder: Recorder, *, steps: int, seconds: float
) -> Json:
    from coordlog.sim.scoring import figures

    return {
        "run": recorder.run,
        **figures(board.scores),
        "aborted": sum(bool(item.result.aborted) for item in sink.done),
        "steps": steps,
        "seconds": seconds,
        "steps_per_second": steps / seconds,
        "megabytes": sink.size / 1e6,
        "recording_us_per_step": recorder.seconds / max(steps, 1) * 1e6,
        "files": [str(item.path) for item in sorted(sink.done, key=lambda item: item.path)],
    }


def actor(
    env: Any, policy: Any, *, seed: int, monitor: Monitor, source: Path | str | None = None
) -> tuple[Act, Json]:
    """A policy for somebody else's environment, and its `coordlog.policy` record.

    What coordlog has learnt acts where it was learnt, and elsewhere with a word or not at all.

    Args:
        env: Where it is to act.
        policy: "random", a name as `policies.foreign.load` takes it, a function from observation to
            action, or an object with `predict` or `act`.
        seed: Of random actions.
        monitor: Hears of an environment that is nearly the one where it was learnt.
        source: The file or the text of its model, where the environment does not say it.

    Raises:
        ConfigError: if there is none, or it was learnt in another environment.
    """
    from coordlog.policies.foreign import as_act, at_home, load
    from coordlog.policies.learned import Policy
    from coordlog.policies.registry import policy_file
    from coordlog.record.foreign_env import Subject, name_of, several, simulation_of, source_of

    if isinstance(policy, str) and policy == "random" and hasattr(env, "action_space"):
        env.action_space.seed(seed)
        return lambda observation: env.action_space.sample(), {"kind": "random", "name": "random"}
    if not isinstance(policy, str | Path):
        return as_act(policy, "policy"), {}
    act, about = load(str(policy))
    if about["kind"] == "digrad":
        one = (several(env) or [env])[0]
        subject = Subject(simulation_of(one)[0], source_of(one) if source is None else source)
        file = policy_file(str(policy), "")
        assert file is not None  # it was loaded
        note = at_home(Policy.load(file), file, {"environment": name_of(one), **subject.names})
        if note:
            monitor.note(note)
    return act, about
