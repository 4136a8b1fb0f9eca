"""The constants of training, one frozen section per part; the defaults are the `default` preset
(see settings.py).

A field's meaning stands below it, and a value out of its range is a ConfigError wherever it came
from.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from coordlog.errors import ConfigError
from coordlog.tasks.config import FATTEST

Activation = Literal["relu", "crelu"]
Norm = Literal["none", "layer", "batch"]
Gradient = Literal["mask", "mean", "sum", "pcgrad"]
Ascent = Literal["first", "mean"]
Schedule = Literal["linear", "geometric"]


def require(holds: bool, key: str, wanted: str, got: object) -> None:
    """Raise ConfigError "key: expected wanted, got got" unless the condition holds."""
    if not holds:
        raise ConfigError(f"{key}: expected {wanted}, got {got!r}")


def require_choice(key: str, choices: object, got: str) -> None:
    """Raise ConfigError unless the value is one of a Literal's."""
    names = get_args(choices)
    require(got in names, key, "one of " + ", ".join(names), got)


@dataclass(frozen=True)
class NetworkConfig:
    """Shape of the actor μ(s) and of the critic Q(s, a); both have the same hidden layers."""

    hidden: tuple[int, ...] = (256, 256)
    """Units of each hidden layer, before the activation (CReLU doubles them)."""
    activation: Activation = "relu"
    """"relu", or "crelu" = [relu(x), relu(-x)]."""
    actor_norm: Norm = "none"
    """Normalisation before activations: "batch" in every hidden layer, "layer" in all but the
    first, which must keep distances apart."""
    critic_norm: Norm = "layer"
    """The same for the critic, "batch" only in the hidden layers that do not see the action, as in
    DDPG §3."""
    dropout: float = 0.0
    """Probability that a hidden unit is dropped.

    Off when acting, in targets, and in the critic of the actor's step.
    """
    critics: int = 2
    """Critics of which targets take the minimum per head; 1 is DDPG, 2 is TD3."""
    ascent: Ascent = "first"
    """Which of them the actor ascends: the "first", as TD3 prints it, or the "mean" of all, on
    whose errors it cannot sit as easily."""
    action_layer: int = 1
    """Hidden layer of the critic that the action enters: 1 beside the state, 2 as in DDPG §7."""
    final_init: float = 3e-3
    """Weights and biases of output layers start in U(-final_init, final_init), so tanh starts
    unsaturated (DDPG §7)."""

    def __post_init__(self) -> None:
        """Check every field."""
        require(
            len(self.hidden) > 0 and min(self.hidden) > 0,
            "network.hidden",
            "positive layer widths",
            self.hidden,
        )
        require_choice("network.activation", Activation, self.activation)
        require_choice("network.actor_norm", Norm, self.actor_norm)
        require_choice("network.critic_norm", Norm, self.critic_norm)
        require(0 <= self.dropout < 1, "network.dropout", "a probability in [0, 1)", self.dropout)
        require(self.critics >= 1, "network.critics", "at least 1", self.critics)
        require_choice("network.ascent", Ascent, self.ascent)
        require(
            1 <= self.action_layer <= min(2, len(self.hidden)),
            "network.action_layer",
            "1, or 2 with two hidden layers",
            self.action_layer,
        )
        require(self.final_init > 0, "network.final_init", "a positive number", self.final_init)


@dataclass(frozen=True)
class LearnerConfig:
    """DiGrad's update (paper §III-A, eqs. 1-5)."""

    gamma: float = 0.98
    """Discount γ per control step."""
    tau: float = 0.005
    """Polyak rate: θ' ← τ θ + (1 - τ) θ' after each actor update (eq. 5, whose τ and 1 - τ are
    printed swapped)."""
    actor_rate: float = 1e-3
    """Adam learning rate of the actor."""
    critic_rate: float = 1e-3
    """Adam learning rate of the critic."""
    weight_decay: float = 0.0
    """L2 coefficient on the critic's weights (not on biases or norms), as gradient weight_decay ·
    w."""
    actor_delay: int = 1
    """The actor and the targets are updated at every actor_delay-th critic update."""
    target_noise: float = 0.1
    """Standard deviation of the noise on target actions (TD3's target smoothing); 0 for none."""
    target_clip: float = 0.2
    """That noise is clipped to ± this."""
    clip_targets: bool = True
    """Clip targets y_i to the analytic bounds of the return."""
    reward_scale: float = 0.1
    """Rewards are multiplied by this before learning, so that |Q| is about 10 at most.

    Metrics are in unscaled units.
    """
    gradient: Gradient = "mask"
    """How the heads' action gradients combine: "mask" is DiGrad (eq. 3), the others are
    ablations."""
    normalise: bool = True
    """Divide the actor's gradient by mean |Q|, so that the behaviour term keeps its weight as Q
    grows (TD3+BC)."""

    def __post_init__(self) -> None:
        """Check every field."""
        require(0 <= self.gamma < 1, "learner.gamma", "a discount in [0, 1)", self.gamma)
        require(0 < self.tau <= 1, "learner.tau", "a rate in (0, 1]", self.tau)
        require_choice("learner.gradient", Gradient, self.gradient)
        require(self.actor_delay >= 1, "learner.actor_delay", "at least 1", self.actor_delay)
        for name in ("actor_rate", "critic_rate", "reward_scale"):
            require(
                getattr(self, name) > 0, f"learner.{name}", "a positive number", getattr(self, name)
            )
        for name in ("weight_decay", "target_noise", "target_clip"):
            require(
                getattr(self, name) >= 0, f"learner.{name}", "a number ≥ 0", getattr(self, name)
            )


@dataclass(frozen=True)
class BehaviourConfig:
    """Pull towards what was done, w · mean((μ(s) - a)²) in the actor's loss: on samples of logs,
    and on live ones in hindsight.

    What was done is a good way to where it led, whoever did it (Ghosh et al. 2021, GCSL), so it
    teaches to reach from the first steps on; in hindsight it is the steady motion from here to
    there that is imitated, not its detours (`replay.moved`). Samples that a collision or fall
    follows within `replay.horizon` steps are left out.
    """

    weight: float = 20.0
    """w at the first update; 0 for no pull."""
    final: float = 5.0
    """w at the last update. Annealed to nearly nothing, good policies have collapsed."""
    schedule: Schedule = "linear"
    """In between "linear", or "geometric": in equal factors, so that it is weak, and values are
    heard, for most of the run."""
    extra: int = 0
    """Further steps of the actor per update that only imitate, from logs alone: they cost a quarter
    of an update, and it takes thousands to see through the noise of what was done."""
    effort: float = 0.03
    """w_e of the term w_e · mean μ(s)² on all samples: keeps tanh out of saturation, where no
    gradient passes (Andrychowicz 2017)."""

    def __post_init__(self) -> None:
        """Check every field."""
        for name in ("weight", "final", "effort"):
            require(
                getattr(self, name) >= 0, f"behaviour.{name}", "a number ≥ 0", getattr(self, name)
            )
        require(self.extra >= 0, "behaviour.extra", "a number ≥ 0", self.extra)
        require_choice("behaviour.schedule", Schedule, self.schedule)
        ends = self.weight > 0 and self.final > 0
        require(
            self.schedule == "linear" or ends,
            "behaviour.schedule",
            "linear where weight or final is 0",
            self.schedule,
        )

    def at(self, progress: float) -> float:
        """Weight after a fraction `progress` in [0, 1] of the run."""
        if self.schedule == "geometric":
            return float(self.weight * (self.final / self.weight) ** progress)
        return self.weight + (self.final - self.weight) * progress


@dataclass(frozen=True)
class NoiseConfig:
    """Exploration N of Algorithm 1: normal noise on the action, whose deviation decays linearly;
    the sum is clipped to [-1, 1].
    """

    start: float = 0.5
    """Standard deviation at the first step, in units of the action range [-1, 1]."""
    final: float = 0.1
    """Standard deviation once it has decayed."""
    decay: float = 0.6
    """Fraction of the run over which it decays."""
    correlation: float = 0.9
    """Correlation ρ of the noise from one step to the next, [0, 1); 0 in the paper, whose
    independent draws go nowhere at 25 Hz."""

    def __post_init__(self) -> None:
        """Check every field."""
        require(
            0 <= self.final <= self.start,
            "noise.final",
            "a number between 0 and noise.start",
            self.final,
        )
        require(0 < self.decay <= 1, "noise.decay", "a fraction in (0, 1]", self.decay)
        require(
            0 <= self.correlation < 1, "noise.correlation", "a number in [0, 1)", self.correlation
        )

    def at(self, progress: float) -> float:
        """Standard deviation after a fraction `progress` in [0, 1] of the run."""
        return self.start + (self.final - self.start) * min(1.0, progress / self.decay)


@dataclass(frozen=True)
class ReplayConfig:
    """What a batch is drawn from."""

    batch: int = 256
    """Transitions per update."""
    capacity: int = 1_000_000
    """Live transitions kept, first in first out. Logs are never evicted."""
    warmup: int = 5_000
    """Live transitions stored before the first update."""
    log_fraction: float = 0.5
    """Share of each batch that comes from logs when there are logs and live transitions."""
    hindsight: float = 0.8
    """Share of each batch's live transitions whose goals are replaced by palms reached later in the
    same episode."""
    log_hindsight: float = 0.0
    """The same share of transitions from logs. An expert's logs need none: whoever imitates steady
    motions to where it soon was, and not what it did, goes straight where it went around
    something."""
    horizon: int = 20
    """Goals in hindsight are reached at most this many steps later.

    0 for any later step of the episode.
    """
    far: float = 0.0
    """Share of the live transitions in hindsight whose goals are reached at any later step,
    whatever the horizon. The way there is not
    imitated: over a whole episode it is a detour more often than a way."""
    imitation: float = 1.0
    """Weight of the behaviour term on live samples in hindsight, beside 1 on samples of logs."""
    n_step: int = 5
    """Steps whose rewards a target sums before it bootstraps.

    One action at 25 Hz changes too little to be seen in the value.
    """
    cut: bool = False
    """End such a sum before a collision or fall of a later step: that step's action, noise
    included, led to it, and not the first."""
    reorder: bool = True
    """List the spheres of every sample in an order of chance: no order means anything, so each
    sample stands for all of them."""

    def __post_init__(self) -> None:
        """Check every field."""
        require(self.batch >= 2, "replay.batch", "at least 2", self.batch)
        require(
            self.capacity >= self.batch,
            "replay.capacity",
            f"at least replay.batch = {self.batch}",
            self.capacity,
        )
        require(
            self.batch <= self.warmup <= self.capacity,
            "replay.warmup",
            "between replay.batch and replay.capacity",
            self.warmup,
        )
        require(self.horizon >= 0, "replay.horizon", "a number ≥ 0", self.horizon)
        require(self.imitation >= 0, "replay.imitation", "a number ≥ 0", self.imitation)
        require(self.n_step >= 1, "replay.n_step", "at least 1", self.n_step)
        for name in ("log_fraction", "hindsight", "log_hindsight", "far"):
            require(
                0 <= getattr(self, name) <= 1,
                f"replay.{name}",
                "a fraction in [0, 1]",
                getattr(self, name),
            )


@dataclass(frozen=True)
class PracticeConfig:
    """How the live episodes of training differ from those that are judged; the policy, its file and
    evaluations know nothing of it.

    Each is the constant of the same name in [env], for the simulations that are learnt from alone,
    and stands in their logs.
    """

    start_line: float = 0.0
    """Share of episodes that begin on the line from the start pose to another named one."""
    start_random: float = 0.0
    """Share that begin in a random legal posture."""
    start_solved: float = 0.0
    """Share of all that begin near a posture which reaches the goals of another draw instead: a
    curriculum from the goals backwards."""
    inflate: float = 0.0
    """Obstacles are this much larger on every side than the policy is told [m], so that what it
    learns leaves a margin."""

    def __post_init__(self) -> None:
        """Check every field."""
        for name in ("start_line", "start_random", "start_solved"):
            require(
                0 <= getattr(self, name) <= 1,
                f"train.{name}",
                "a share in [0, 1]",
                getattr(self, name),
            )
        require(
            self.start_line + self.start_random <= 1,
            "train.start_random",
            "at most 1 - train.start_line",
            self.start_random,
        )
        require(0 <= self.inflate <= FATTEST, "train.inflate", f"0 to {FATTEST} m", self.inflate)


@dataclass(frozen=True)
class LoopConfig:
    """Budgets and intervals. Whichever budget runs out first ends the run."""

    seed: int = 0
    """Seed of weights, batches and exploration."""
    updates: int = 10_000
    """Gradient updates; 0 for as many as the live steps earn."""
    steps: int = 0
    """Live steps, all simulations together; not used when training from logs alone."""
    pretrain: int = 0
    """Updates from logs alone before the first live step."""
    updates_per_step: float = 0.2
    """Updates per environment step after `replay.warmup` of them, when live."""
    final_rate: float = 1.0
    """Both learning rates fall linearly to this share of themselves at the end of the run."""
    block: int = 8
    """Control steps of every simulation between two snapshots of the actor, when live."""
    overlap: bool = True
    """Simulate the next block while updating on the ones before it.

    The results are the same either way.
    """
    average: float = 0.1
    """The policy that is evaluated and kept is an average of the actors of about this last share of
    the updates so far; 0 for the actor itself."""
    metrics_every: int = 500
    """Updates between two rows of metrics."""
    evaluate_every: int = 2_500
    """Updates between two evaluations; 0 for none."""
    checkpoint_every: int = 2_500
    """Updates between two checkpoints."""

    def __post_init__(self) -> None:
        """Check every field."""
        for name in ("block", "metrics_every", "checkpoint_every"):
            require(getattr(self, name) >= 1, f"loop.{name}", "at least 1", getattr(self, name))
        for name in ("seed", "updates", "steps", "pretrain", "evaluate_every"):
            require(getattr(self, name) >= 0, f"loop.{name}", "a number ≥ 0", getattr(self, name))
        require(
            self.updates_per_step > 0,
            "loop.updates_per_step",
            "a positive number",
            self.updates_per_step,
        )
        require(0 <= self.average <= 1, "loop.average", "a share in [0, 1]", self.average)
        require(0 < self.final_rate <= 1, "loop.final_rate", "a share in (0, 1]", self.final_rate)
