"""DiGrad: one actor, one critic head per task, and a policy gradient in which each head moves only
the joints of its task.

Paper §III-A, with its open ends tied as in DDPG (Lillicrap et al. 2016) and TD3 (Fujimoto et al.
2018). Everything random in an update comes from the learner's own generator, so an update depends
on its state and its batch alone.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any, NamedTuple

import torch
from torch import Tensor

from coordlog.episode import Array
from coordlog.errors import SpecError
from coordlog.policies.checkpoint import under
from coordlog.train.gradients import head_weights, project_conflicts
from coordlog.train.networks import Actor, Critic
from coordlog.train.settings import Settings

NETWORKS = ("actor", "critic", "target_actor", "target_critic")
OPTIMISERS = ("actor_optimiser", "critic_optimiser")
SATURATED = 0.99
SMALLEST_SCALE = 1e-6


class Batch(NamedTuple):
    """B transitions as tensors of one floating type; rewards unscaled."""

    state: Tensor  # (B, n_x)
    action: Tensor  # (B, n_u) executed, in [-1, 1]
    reward: Tensor  # (B, k) of one step, or discounted of several
    next_state: Tensor  # (B, n_x) after them
    # (B, 1) what its value counts: γ to their number, 0 where the task ended; truncation is not an
    # end
    discount: Tensor
    imitated: Tensor  # (B, 1) weight of the behaviour term
    wanted: Tensor  # (B, n_u) action that it pulls towards


class Examples(NamedTuple):
    """B states, and what was done there."""

    state: Tensor  # (B, n_x)
    action: Tensor  # (B, n_u)
    imitated: Tensor  # (B, 1) weight of the behaviour term


class Update(NamedTuple):
    """What one update did, as tensors (reading one waits for the device).

    Values in units of the unscaled return.
    """

    critic_loss: Tensor  # () eq. (4), in scaled units
    q: Tensor  # (k,) mean Q_i(s, a) over the batch
    q_low: Tensor  # () least Q of all heads and members
    q_high: Tensor  # () greatest
    actor_value: Tensor  # (k,) mean Q_i(s, μ(s)) at the last actor update
    behaviour: Tensor  # () mean squared distance of μ(s) to logged actions at the last actor update
    saturation: Tensor  # () share of |μ(s)| > 0.99 at the last actor update


class Learner:
    """Networks, targets and optimisers of one run.

    `update` is the paper's line "Update networks".
    """

    def __init__(
        self,
        n_x: int,
        mask: Array,
        settings: Settings,
        *,
        bounds: tuple[float, float],
        device: str = "cpu",
    ) -> None:
        """Initialise networks from the seed, and targets as their copies.

        Args:
            n_x: Width of the state.
            mask: Which task moves which action, shape (k, n_u); see `gradients.gradient_mask`.
            settings: Of them `network` shapes the networks and `learner` has the update's
                constants; `loop.seed` is that of the weights and of everything random in an
                update, and `loop.average` the share of the updates so far that `average_actor` is
                an average over, 0 for the actor itself.
            bounds: Least and greatest return any policy can have, unscaled; see
                `relabel.value_bounds`.
            device: Where the networks live.
        """
        k, n_u = mask.shape
        network, config, average = settings.network, settings.learner, settings.loop.average
        self.config, self.k, self.device, self.updates = config, k, torch.device(device), 0
        birth = torch.Generator().manual_seed(settings.loop.seed)
        self.actor = Actor(n_x, n_u, config=network, generator=birth).to(self.device)
        self.critic = Critic(n_x, n_u, k, config=network, generator=birth).to(self.device)
        self.target_actor = copy.deepcopy(self.actor).requires_grad_(False)
        self.target_critic = copy.deepcopy(self.critic).requires_grad_(False)
        self.actor_optimiser = torch.optim.Adam(
            self.actor.parameters(), lr=config.actor_rate, fused=True
        )
        self.critic_optimiser = torch.optim.Adam(
            _decayed(self.critic, config.weight_decay), lr=config.critic_rate, fused=True
        )
        self.generator = torch.Generator(self.device).manual_seed(settings.loop.seed)

        online = torch.nn.ModuleList([self.actor, self.critic])
        targets = torch.nn.ModuleList([self.target_actor, self.target_critic])
        self._online, self._targets = (
            tuple[Tensor, ...](networks.parameters()) for networks in (online, targets)
        )
        self._moments = _moments(targets, online)
        self.average_actor, self._average = self.actor, average
        self._networks = (*NETWORKS, "average_actor") if average > 0 else NETWORKS
        if average > 0:
            self.average_actor = copy.deepcopy(self.target_actor)
            self._moments += _moments(self.average_actor, self.actor)
        dtype = self._online[0].dtype
        self._ascended = 1 if network.ascent == "first" else network.critics
        self._head_weights = torch.as_tensor(
            head_weights(config.gradient, mask), dtype=dtype, device=self.device
        )
        self._bounds = (bounds[0] * config.reward_scale, bounds[1] * config.reward_scale)
        zero = torch.zeros((), dtype=dtype, device=self.device)
        self._last = (zero.expand(k), zero, zero)

    def slow_down(self, share: float) -> None:
        """Learn at this share of the configured rates from now on."""
        rates = (
            (self.actor_optimiser, self.config.actor_rate),
            (self.critic_optimiser, self.config.critic_rate),
        )
        for optimiser, rate in rates:
            for group in optimiser.param_groups:
                group["lr"] = rate * share

    def update(self, batch: Batch, *, behaviour_weight: float = 0.0, effort: float = 0.0) -> Update:
        """One gradient step of the critic.

        At every `actor_delay`-th one, of the actor, and of the targets towards both.
        """
        self.updates += 1
        loss, q = self._update_critic(batch)
        if self.updates % self.config.actor_delay == 0:
            self._last = self._update_actor(batch, behaviour_weight, effort)
            self._update_targets()
        low, high = torch.aminmax(q)
        scale = self.config.reward_scale
        return Update(loss, q.mean(dim=(0, 1)) / scale, low / scale, high / scale, *self._last)

    def imitate(self, examples: Examples, *, behaviour_weight: float, effort: float) -> None:
        """One gradient step of the actor on the behaviour and effort terms alone."""
        action: Tensor = self.actor(examples.state, training=True, generator=self.generator)
        done = action.detach()
        away = (done - examples.action) * examples.imitated
        pull = (away * behaviour_weight + done * effort) * (2 / done.numel())
        self._step_actor(action, [], pull)

    @torch.no_grad()
    def targets(self, batch: Batch) -> Tensor:
        """y_i = r_i + γ (1 - terminated) min_e Q'_ei(s', clip(μ'(s') + ε)), clipped to the bounds:
        (B, k), in scaled units.

        Over n steps r_i is their discounted sum and γ becomes γⁿ; `returns.n_step` has worked both
        out.

        The smoothing noise ε and the minimum over members e are TD3's (target_noise = 0 and one
        critic give the paper's y_i).
        """
        config = self.config
        action = self.target_actor(batch.next_state)
        if config.target_noise > 0:
            noise = torch.empty_like(action).normal_(
                0, config.target_noise, generator=self.generator
            )
            action = action.add_(noise.clamp_(-config.target_clip, config.target_clip)).clamp_(
                -1, 1
            )
        value: Tensor = self.target_critic(batch.next_state, action)
        value = value.amin(dim=0) if len(value) > 1 else value[0]
        y = torch.addcmul(batch.reward * config.reward_scale, batch.discount, value)
        return y.clamp_(*self._bounds) if config.clip_targets else y

    def _update_critic(self, batch: Batch) -> tuple[Tensor, Tensor]:
        """Eq. (4): L = Σ_i mean (Q_i(s, a) - y_i)², summed over members.

        Returns the loss and Q (E, B, k).
        """
        y = self.targets(batch)
        q: Tensor = self.critic(batch.state, batch.action, training=True, generator=self.generator)
        loss = (q - y).square().sum() / len(y)
        self.critic_optimiser.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        self.critic_optimiser.step()
        return loss.detach(), q.detach()

    def _update_actor(
        self, batch: Batch, behaviour_weight: float, effort: float
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Eqs. (2) and (3), with the behaviour term and the normalisation of TD3+BC if asked for.

        θ^μ ascends mean_s Σ_i (m_i ⊙ ∇_a Q_i(s, a))ᵀ ∇_θ μ(s) / λ - w ∇_θ mean |μ(s) - a_logged|² /
        n_u at a = μ(s), λ = mean |Q|. The effort term, w_e mean |μ(s)|² / n_u, joins the loss
        likewise. The behaviour term is divided by B, not by the number of samples it applies to: a
        sample's balance of value against imitation does not depend on what else is in the batch.
        """
        action: Tensor = self.actor(batch.state, training=True, generator=self.generator)
        leaf = action.detach().requires_grad_()
        q: Tensor = self.critic(batch.state, leaf, count=self._ascended).mean(dim=0)  # (B, k)
        heads = q.sum(dim=0).unbind()
        slopes = [
            torch.autograd.grad(head, leaf, retain_graph=True)[0] for head in heads
        ]  # k of (B, n_u)
        with torch.no_grad():
            q = q.detach()
            size = len(q) * (
                q.abs().mean().clamp_min(SMALLEST_SCALE) if self.config.normalise else 1
            )
            away = leaf - batch.wanted
            behaviour = (away.square() * batch.imitated).mean()
            pull = away * batch.imitated * (2 * behaviour_weight / away.numel()) + leaf * (
                2 * effort / leaf.numel()
            )
            saturation = (leaf.abs() > SATURATED).to(q.dtype).mean()
        weighted = zip(slopes, self._head_weights, strict=True)
        self._step_actor(action, [slope * weight / size for slope, weight in weighted], pull)
        return q.mean(dim=0) / self.config.reward_scale, behaviour, saturation

    def _step_actor(self, action: Tensor, ascents: list[Tensor], pull: Tensor) -> None:
        """Back-propagate the action gradients through μ: their sum, or for "pcgrad" their projected
        sum over θ^μ.
        """
        self.actor_optimiser.zero_grad(set_to_none=True)
        if self.config.gradient != "pcgrad" or not ascents:
            action.backward(gradient=pull - sum(ascents, torch.zeros_like(pull)))  # type: ignore[no-untyped-call]
        else:
            parameters = tuple(self.actor.parameters())
            flat = []
            for ascent in ascents:
                parts = torch.autograd.grad(
                    action, parameters, grad_outputs=-ascent, retain_graph=True
                )
                flat.append(torch.cat([part.reshape(-1) for part in parts]))
            action.backward(gradient=pull)  # type: ignore[no-untyped-call]
            merged = project_conflicts(flat, generator=self.generator)
            parts = torch.split(merged, [parameter.numel() for parameter in parameters])
            for parameter, part in zip(parameters, parts, strict=True):
                assert parameter.grad is not None
                parameter.grad += part.view_as(parameter)
        self.actor_optimiser.step()

    @torch.no_grad()
    def _update_targets(self) -> None:
        """Eq. (5) as DDPG has it: θ' ← τ θ + (1 - τ) θ'; and the average that is evaluated.

        The rate of the latter falls as 1/updates: it forgets the first actors, however long a run
        is. Running moments of batch normalisation are copied.
        """
        torch._foreach_lerp_(self._targets, self._online, self.config.tau)
        if self._average > 0:
            window = self._average * self.updates / self.config.actor_delay
            average, actor = (
                tuple[Tensor, ...](each.parameters()) for each in (self.average_actor, self.actor)
            )
            torch._foreach_lerp_(average, actor, min(1.0, 1 / window))
        for target, moment in self._moments:
            target.copy_(moment)

    def state(self) -> dict[str, Tensor]:
        """Everything the next update depends on or reports, by name.

        Tensors are the learner's own, not copies.
        """
        tensors = {"updates": torch.tensor(self.updates), "generator": self.generator.get_state()}
        tensors |= {f"last.{index}": value for index, value in enumerate(self._last)}
        for name in self._networks:
            tensors |= {
                f"{name}.{key}": value for key, value in getattr(self, name).state_dict().items()
            }
        for name in OPTIMISERS:
            for index, slots in getattr(self, name).state_dict()["state"].items():
                tensors |= {f"{name}.{index}.{key}": value for key, value in slots.items()}
        return tensors

    def load_state(self, tensors: Mapping[str, Tensor]) -> None:
        """Continue from a `state()`.

        Raises:
            SpecError: if a network's tensor is missing or has another shape: the state is of
                another layout or network.
        """
        for name in self._networks:
            module, found = getattr(self, name), under(f"{name}.", tensors)
            for key, value in module.state_dict().items():
                got = tuple(found[key].shape) if key in found else None
                if got != tuple(value.shape):
                    raise SpecError(
                        f"{name}.{key}: expected shape {tuple(value.shape)}, got {got}; this state "
                        "is of another layout or network"
                    )
            module.load_state_dict(found)
        for name in OPTIMISERS:
            optimiser, slots = getattr(self, name), dict[int, dict[str, Tensor]]()
            for key, value in under(f"{name}.", tensors).items():
                index, _, slot = key.partition(".")
                slots.setdefault(int(index), {})[slot] = value
            optimiser.load_state_dict(
                {"state": slots, "param_groups": optimiser.state_dict()["param_groups"]}
            )
        value, behaviour, saturation = (
            tensors[f"last.{index}"].to(self.device) for index in range(3)
        )
        self._last = (value, behaviour, saturation)
        self.updates = int(tensors["updates"])
        self.generator.set_state(tensors["generator"].cpu())


def _decayed(critic: Critic, weight_decay: float) -> list[dict[str, Any]]:
    """The critic's parameters as groups of an optimiser; weights alone decay."""
    named = [*critic.named_parameters()]
    weights = [tensor for name, tensor in named if name.endswith("weight")]
    others = [tensor for name, tensor in named if not name.endswith("weight")]
    return [{"params": weights, "weight_decay": weight_decay}, {"params": others}]


def _moments(targets: torch.nn.Module, online: torch.nn.Module) -> list[tuple[Tensor, Tensor]]:
    """Running moments of batch normalisation in pairs: where they are copied to, and from."""
    return [
        (target, moment)
        for target, moment in zip(targets.buffers(), online.buffers(), strict=True)
        if moment.dim() > 1
    ]
