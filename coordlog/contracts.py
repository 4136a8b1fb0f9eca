"""What the parts of coordlog promise one another, on one page.

    Task      goals, what the policy sees, rewards and endings        tasks/<name>/
    Env       simulations that are reset and stepped together         sim/env.py, record/recorder.py
    Policy    state in, action out                                    policies/
    Checker   how close a posture is to touching anything             kinematics/clearance.py
    Learner   updates a policy from batches of transitions            train/digrad.py
    Store     where episode files are kept                            record/store.py

They are protocols: nothing inherits from them, and whatever has these members fits. Letters in
shapes: N simulations, n of them at once, k arms, n_x policy state, n_u action, n_c actuators,
T steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from coordlog.episode import Array, Json
from coordlog.path import Bools, Floats, Ints
from coordlog.spec import Field

# ---------------------------------------------------------------------------------------- nouns


@dataclass(frozen=True, eq=False)
class Branch:
    """A start state inside a logged episode, reached by that episode's first t actions."""

    parent: str
    """sha256 of the parent episode's file."""
    actions: Array  # (t, n_u) float32
    state: Array  # (n_x,) float32, where they lead


@dataclass(frozen=True, eq=False)
class Problem:
    """One drawn episode: where the robot starts, its goals and obstacles.

    Example:
        >>> env.problem(seed=0, split="test", index=3).goals.shape     # doctest: +SKIP
        (2, 3)
    """

    seed: int
    split: str
    index: int
    goals: Array  # (k, 3) m, at the start
    centre: Array | None  # (3,) of the object, m
    spheres: Array  # (n_spheres, 4): x, y, z, radius, m
    angles: Array  # (n_u,) start angles of the action joints, rad
    branch: Branch | None = None
    """Where the episode begins, if not at its own beginning."""
    track: Array | None = None
    """Where the goals are before each step, (steps + 1, k, 3) m; None where they stand still."""


@dataclass(frozen=True, eq=False)
class Sample:
    """What a task draws for an episode."""

    goals: Array  # (k, 3) m, at the start
    centre: Array | None = None  # (3,) of the object, m
    track: Array | None = None
    """As in `Problem`."""
    reachable: bool = False
    """Known to be reachable as drawn; otherwise inverse kinematics has to find a posture."""


@dataclass(frozen=True, eq=False)
class Reading:
    """What a task is told of n simulations, in SI units, world frame."""

    angles: Array  # (n, n_u) rad
    velocities: Array  # (n, n_u) rad/s
    palms: Array  # (n, k, 3) m
    goals: Array  # (n, k, 3) m
    spheres: Array  # (n, n_spheres, 4): x, y, z, radius, m
    links: Array | None  # (n, k, 3) m, where the last links begin
    com: Array | None  # (n, 2) m
    collision: Array | None = None  # (n,) bool, during the step that led here; None at a start
    instability: Array | None = None  # (n,) bool


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one step led to, one row per simulation stepped.

    Every column is an attribute too: `outcome.reward` is `outcome.columns["reward"]`.

    Example:
        >>> outcome = env.step(action, ids)                     # doctest: +SKIP
        >>> over = outcome.terminated | outcome.truncated       # doctest: +SKIP
        >>> outcome.columns["torque"].shape                     # doctest: +SKIP
        (16, 25)
    """

    columns: Mapping[str, Array]
    """Every field that holds after a step, by name, (n, …): the core's `reward` (n, k),
    `terminated` and `truncated` (n,), `ctrl` and `torque` (n, n_c), then the task's own."""
    diverged: Array
    """Whether the state is no number any more, (n,) bool; then no column means anything."""
    contacts: list[Array]
    """CONTACT rows per simulation, their step not yet filled in."""
    success: Array = field(default_factory=lambda: np.zeros(0, dtype=bool))
    """Whether the episode, if it ends here, has succeeded, (n,) bool; empty where no task says."""
    clean: Array = field(default_factory=lambda: np.zeros(0, dtype=bool))
    """Whether it has, and nothing went wrong at any step, (n,) bool."""

    def __getattr__(self, name: str) -> Array:
        """A column by its name.

        Raises:
            AttributeError: if no column is called that; the message lists those that are.
        """
        columns: Mapping[str, Array] = vars(self).get("columns", {})
        if name in columns:
            return columns[name]
        has = ", ".join(columns)
        raise AttributeError(f"outcome: expected one of its columns ({has}), got '{name}'")


# ------------------------------------------------------------------------------------ protocols


class View(Protocol):
    """Names, scales and places of the entries of the policy state (tasks/reach/observation.py)."""

    @property
    def places(self) -> Mapping[str, slice]:
        """Entries of each part, by name."""
        ...

    def __len__(self) -> int:
        """Number of entries n_x."""
        ...

    def scaled(self, parts: Mapping[str, Array]) -> Array:
        """Parts in physical units, each (n, width), to the state, (n, n_x) float32."""
        ...

    def physical(self, state: Array, part: str) -> Array:
        """One part of a state in physical units, (n, width) float64."""
        ...

    def to_json(self) -> Json:
        """What a log carries of it."""
        ...


class Kinematics(Protocol):
    """Postures of one robot in one scene, as far as a task needs them to draw problems."""

    limits: Array  # (n_u, 2) rad
    standing_angles: Array  # (n_u,) rad, at rest in the start pose

    def palms(self, angles: Array) -> Array:
        """Palm positions at joint angles (n_u,), (k, 3) [m]."""
        ...

    def solve(
        self,
        goals: Array,
        *,
        seed: Array | None = None,
        held: Array | None = None,
        clearance: float = 0.0,
    ) -> Array | None:
        """Joint angles that bring every palm to its goal (k, 3), balanced and touching nothing."""
        ...

    def legal(self, angles: Array, *, clearance: float = 0.0) -> bool:
        """Whether a posture is balanced and touches nothing."""
        ...


class Task(Protocol):
    """What is asked of the robot: pure functions of arrays, in a folder of its own in tasks/.

    A task never sees MuJoCo. `sim/task.py` reads what it needs off the simulations (`Reading`), and
    logs, checks, replays and learning take the names of its columns from `fields`.

    Example:
        >>> task = ReachTask(EnvConfig(), RewardConfig())       # doctest: +SKIP
        >>> columns = task.measure(reading)                     # doctest: +SKIP
        >>> columns |= task.derive(columns)                     # doctest: +SKIP
        >>> task.reward(columns).shape                          # doctest: +SKIP
        (16, 2)
    """

    @property
    def name(self) -> str:
        """As in the header's env record, and the last part of its topic."""
        ...

    @property
    def fields(self) -> tuple[Field, ...]:
        """What it logs of its own for every step, before and after the action."""
        ...

    @property
    def throughout(self) -> bool:
        """Success is a matter of every step of the whole time, not of any one step."""
        ...

    def to_json(self) -> Json:
        """The env record's entry: its name and its own constants."""
        ...

    def view(self, robot: Any, limits: Array, *, spheres: int) -> View:
        """What the policy sees of this robot (`robots.robot.Robot`), among so many spheres.

        `limits` are the ranges of the action joints, (n_u, 2) [rad].
        """
        ...

    def parts(self, reading: Reading, view: View) -> dict[str, Array]:
        """The parts of the policy state in physical units, (n, width) each."""
        ...

    def given(self, reading: Reading) -> dict[str, Array]:
        """Its own columns that hold before an action, (n, …)."""
        ...

    def measure(self, reading: Reading) -> dict[str, Array]:
        """Its own columns that only the simulation can tell, after an action, (n, …)."""
        ...

    def derive(self, columns: Mapping[str, Array]) -> dict[str, Array]:
        """The rest of its own columns, from those that were measured.

        The one definition of every flag, as `reward` and `ended` are of theirs: simulation, check,
        hindsight and Gymnasium's `compute_reward` all come here (`tasks.registry.follow`).
        """
        ...

    def reward(self, columns: Mapping[str, Array]) -> Array:
        """Rewards, (n, k), from its own columns."""
        ...

    def ended(self, columns: Mapping[str, Array]) -> Array:
        """Steps that end the episode for good, (n,) bool, from its own columns."""
        ...

    def accomplished(self, columns: Mapping[str, Array]) -> Array:
        """Steps at which what is asked for holds, (n,) bool; see `throughout`."""
        ...

    def mishaps(self, columns: Mapping[str, Array]) -> Array:
        """Steps at which something went wrong, (n,) bool; an episode without any can be clean."""
        ...

    def sample(
        self, rng: np.random.Generator, scene: Any, kinematics: Kinematics, angles: Array
    ) -> Sample | None:
        """Draw goals in a scene (`tasks.scene.Scene`) for an episode that starts at these joint
        angles (n_u,); None where the draw is of no use and another is to be made.
        """
        ...


class Policy(Protocol):
    """State in, action in [-1, 1] out, for several episodes at once.

    Slots are numbered as the environment's simulations.

    Example:
        >>> class Still:
        ...     def begin(self, ids, state, rngs): ...
        ...     def act(self, ids, state):
        ...         return np.zeros((len(ids), 13), np.float32)
    """

    def begin(self, ids: Array, state: Array, rngs: list[np.random.Generator]) -> None:
        """Episodes start in slots `ids` (n,), in states (n, n_x).

        Whatever is random in one comes from its own generator.
        """
        ...

    def act(self, ids: Array, state: Array) -> Array:
        """Actions (n, n_u) float32 in [-1, 1] for the states (n, n_x) of slots `ids`."""
        ...


class Env(Protocol):
    """Simulations that are reset and stepped together; a recorder is one too.

    Example:
        >>> for ids, outcome in rollout(env, policy, range(10), seed=0):  # doctest: +SKIP
        ...     print(outcome.reward.mean())
    """

    @property
    def n(self) -> int:
        """Number of simulations N."""
        ...

    @property
    def state(self) -> Array:
        """Present policy state of every simulation, (N, n_x) float32."""
        ...

    def problem(self, *, seed: int, split: str, index: int) -> Problem:
        """The problem of one episode."""
        ...

    def reset(self, ids: Array, problems: list[Problem]) -> None:
        """Start an episode in each of the simulations `ids`."""
        ...

    def step(self, action: Array, ids: Array) -> Outcome:
        """Advance simulations `ids` by one control period."""
        ...


class Verdict(NamedTuple):
    """What a checker says about n configurations.

    Example:
        >>> Verdict.from_slack(np.array([[0.1, -0.2]])).what.tolist()
        [1]
    """

    free: Bools  # (n,) everything is allowed
    depth: Floats  # (n,) m, by how much the worst pair falls short; 0 where free
    what: Ints  # (n,) index of that pair, for `describe`; -1 where free

    @classmethod
    def from_slack(cls, slack: Floats) -> Verdict:
        """Verdict on slacks [m] of shape (n, P): free where none is negative or NaN."""
        if not slack.shape[1]:
            return cls(np.ones(len(slack), bool), np.zeros(len(slack)), np.full(len(slack), -1))
        what = slack.argmin(axis=1)
        worst = slack[np.arange(len(slack)), what]
        free = worst >= 0.0
        depth = np.where(np.isnan(worst), np.inf, -worst)
        return cls(free, np.where(free, 0.0, depth), np.where(free, -1, what))


class Checker(Protocol):
    """Decides which configurations are allowed: collision, self-collision, balance.

    What a certificate needs besides is in smooth/feasibility.py.

    Example:
        >>> checker.check(time, angles, 0.01).free.all()        # doctest: +SKIP
        True
    """

    def check(self, time: Floats, q: Floats, clearance: float) -> Verdict:
        """Judge a block of configurations, in any order, independently of one another.

        Args:
            time: Time of each configuration within the path [s], shape (n,); for whatever else
                moves with it, such as the base the log recorded.
            q: Joint angles [rad], shape (n, n_j).
            clearance: Distance [m] that pairs of bodies must keep; a pair closer than this is not
                free. Balance has its own margin.
        """
        ...

    def describe(self, what: int) -> str:
        """Name a pair of `Verdict.what` for people, such as "l_forearm and table_top"."""
        ...


class Learner(Protocol):
    """Updates the weights of a policy from batches of transitions.

    Example:
        >>> figures = learner.update(batch)                     # doctest: +SKIP
    """

    def update(self, batch: Any, *, behaviour_weight: float = 0.0, effort: float = 0.0) -> Any:
        """One update from a batch (`train.replay.Batch`), and its figures."""
        ...

    def state(self) -> Mapping[str, Any]:
        """All that the next update depends on, by name."""
        ...

    def load_state(self, tensors: Mapping[str, Any]) -> None:
        """Continue from a `state()`."""
        ...


class Store(Protocol):
    """Where episode files are kept: a folder, a pack, a bucket.

    Example:
        >>> for entry in store.list():                          # doctest: +SKIP
        ...     data = store.read(entry.name)
    """

    def list(self) -> Sequence[Any]:
        """The episode files, by name: entries (`record.places.Entry`) of name, size and time."""
        ...

    def read(self, name: str) -> bytes:
        """All bytes of a file."""
        ...

    def path(self, name: str) -> Path:
        """A file of this machine with those bytes."""
        ...

    def publish(self, name: str, part: Path) -> Path:
        """Keep a finished file under a name, and say where it is."""
        ...
