"""The learner against oracles written from the equations: DDPG, sums of gradients, finite
differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from coordlog.errors import SpecError
from coordlog.train.config import LearnerConfig, LoopConfig, NetworkConfig
from coordlog.train.digrad import Batch, Examples, Learner
from coordlog.train.gradients import gradient_mask
from coordlog.train.settings import PRESETS, Settings

N_X, N_U, B = 5, 4, 16
BOUNDS = (-100.0, 100.0)
PLAIN = NetworkConfig(hidden=(12, 9), critic_norm="none", critics=1)
DDPG = LearnerConfig(
    gamma=0.9,
    tau=0.05,
    actor_rate=3e-4,
    critic_rate=1e-3,
    actor_delay=1,
    target_noise=0,
    clip_targets=False,
    reward_scale=1,
    normalise=False,
)
TWO_ARMS = {"left": [0, 1], "right": [0, 2, 3]}
APART = {"left": [0, 1], "right": [2, 3]}


def batch(rng: np.random.Generator, k: int, *, size: int = B, imitated: float = 0.0) -> Batch:
    def draw(*shape: int) -> Tensor:
        return torch.tensor(rng.normal(size=shape), dtype=torch.get_default_dtype())

    discount = DDPG.gamma * (draw(size, 1) <= 1).to(torch.get_default_dtype())
    action, weight = draw(size, N_U).clamp(-1, 1), torch.full((size, 1), imitated)
    return Batch(
        draw(size, N_X),
        action,
        draw(size, k),
        draw(size, N_X),
        discount,
        weight,
        draw(size, N_U).clamp(-1, 1),
    )


def learner(
    arms: dict[str, list[int]],
    *,
    network: NetworkConfig = PLAIN,
    config: LearnerConfig = DDPG,
    seed: int = 0,
) -> Learner:
    settings = Settings(network, config, loop=LoopConfig(seed=seed))
    return Learner(N_X, gradient_mask(arms, N_U), settings, bounds=BOUNDS)


def gradient(made: Learner) -> Tensor:
    """The actor's gradient of the last update."""
    return torch.cat([parameter.grad.reshape(-1) for parameter in made.actor.parameters()])


class PlainDdpg:
    """Lillicrap et al. 2016, Algorithm 1, with networks of `nn.Linear`.

    Starts from the weights of a learner.
    """

    def __init__(self, source: Learner, config: LearnerConfig) -> None:
        self.config = config
        self.actor, self.actor_target = (self._copy(source.actor.mlp, nn.Tanh()) for _ in range(2))
        self.critic, self.critic_target = (
            self._copy(source.critic.mlp, nn.Identity()) for _ in range(2)
        )
        self.actor_adam = torch.optim.Adam(
            self.actor.parameters(), lr=config.actor_rate, fused=False
        )
        self.critic_adam = torch.optim.Adam(
            self.critic.parameters(), lr=config.critic_rate, fused=False
        )

    @staticmethod
    def _copy(mlp: nn.Module, last: nn.Module) -> nn.Sequential:
        modules: list[nn.Module] = []
        for dense in (*mlp.layers, mlp.output):
            linear = nn.Linear(dense.weight.shape[1], dense.weight.shape[2])
            linear.weight.data = dense.weight.data[0].T.clone()
            linear.bias.data = dense.bias.data[0, 0].clone()
            modules += [linear, nn.ReLU()]
        return nn.Sequential(*modules[:-1], last)

    def update(self, data: Batch) -> None:
        with torch.no_grad():
            following = torch.cat((data.next_state, self.actor_target(data.next_state)), dim=1)
            y = data.reward + data.discount * self.critic_target(following)
        loss = nn.functional.mse_loss(self.critic(torch.cat((data.state, data.action), dim=1)), y)
        self.critic_adam.zero_grad()
        loss.backward()
        self.critic_adam.step()
        ascent = -self.critic(torch.cat((data.state, self.actor(data.state)), dim=1)).mean()
        self.actor_adam.zero_grad()
        ascent.backward()
        self.actor_adam.step()
        for target, online in ((self.actor_target, self.actor), (self.critic_target, self.critic)):
            for old, new in zip(target.parameters(), online.parameters(), strict=True):
                old.data = self.config.tau * new.data + (1 - self.config.tau) * old.data


@pytest.mark.usefixtures("double")
def test_one_task_is_ddpg(rng: np.random.Generator) -> None:
    made = learner({"only": [0, 1, 2, 3]})
    oracle = PlainDdpg(made, DDPG)
    for _ in range(100):
        data = batch(rng, 1)
        made.update(data)
        oracle.update(data)
    state, action = batch(rng, 1)[:2]
    torch.testing.assert_close(made.actor(state), oracle.actor(state), rtol=0, atol=1e-9)
    both = torch.cat((state, action), dim=1)
    torch.testing.assert_close(
        made.critic(state, action)[0], oracle.critic(both), rtol=0, atol=1e-9
    )
    torch.testing.assert_close(
        made.target_critic(state, action)[0], oracle.critic_target(both), rtol=0, atol=1e-9
    )


def restricted(made: Learner, state: Tensor, weights: Tensor, at: Tensor) -> Tensor:
    """Σ_i mean Q_i(s, a_i), where a_i follows μ by the share `weights`[i] of each action and
    otherwise stays at `at`."""
    action = made.actor(state)
    total = torch.zeros(())
    for head, share in enumerate(weights):
        moved = share * action + (1 - share) * at
        total = total + made.critic(state, moved, count=1)[0, :, head].mean()
    return total


@pytest.mark.usefixtures("double")
@pytest.mark.parametrize("arms", [TWO_ARMS, APART, {"a": [0, 1], "b": [0, 1, 2], "c": [0, 3]}])
def test_the_actors_gradient_is_equation_3_by_finite_differences(
    arms: dict[str, list[int]], rng: np.random.Generator
) -> None:
    made, data = learner(arms), batch(rng, len(arms))
    before = [parameter.detach().clone() for parameter in made.actor.parameters()]
    made.update(data)
    analytic = gradient(made)
    weights = torch.tensor(gradient_mask(arms, N_U))
    with torch.no_grad():
        for parameter, value in zip(made.actor.parameters(), before, strict=True):
            parameter.copy_(value)
        at, numeric, step = made.actor(data.state), [], 1e-6
        for parameter in made.actor.parameters():
            flat = parameter.view(-1)
            for index in range(0, len(flat), 3):
                values = []
                for sign in (1, -1):
                    flat[index] += sign * step
                    values.append(restricted(made, data.state, weights, at))
                    flat[index] -= sign * step
                numeric.append((values[1] - values[0]) / (2 * step))
    picked = torch.cat([parameter.grad.reshape(-1)[::3] for parameter in made.actor.parameters()])
    assert analytic.abs().max() > 1e-6
    torch.testing.assert_close(picked, torch.stack(numeric), rtol=1e-4, atol=1e-9)


def per_task(arms: dict[str, list[int]], data: Batch) -> tuple[Learner, list[Tensor]]:
    """A learner after one update, and ∂Q_i/∂a at the actor before it, per task."""
    made = learner(arms)
    action = made.actor(data.state).detach().requires_grad_()
    made.update(data)
    values = made.critic(data.state, action, count=1)[0].sum(dim=0)
    return made, [torch.autograd.grad(value, action, retain_graph=True)[0] for value in values]


def pushed(seed_actor: Learner, data: Batch, ascent: Tensor) -> Tensor:
    """∇_θ of mean ascentᵀ μ(s), for an actor that has not been updated."""
    loss = -(ascent * seed_actor.actor(data.state)).sum() / B
    return torch.cat(
        [
            part.reshape(-1)
            for part in torch.autograd.grad(loss, tuple(seed_actor.actor.parameters()))
        ]
    )


@pytest.mark.usefixtures("double")
def test_without_shared_actions_the_gradient_is_the_sum_over_tasks(
    rng: np.random.Generator,
) -> None:
    data = batch(rng, 2)
    made, slopes = per_task(APART, data)
    total = torch.zeros_like(gradient(made))
    for slope, own in zip(slopes, APART.values(), strict=True):
        alone = torch.zeros_like(slope)
        alone[:, own] = slope[:, own]
        total += pushed(learner(APART), data, alone)
    torch.testing.assert_close(gradient(made), total)


@pytest.mark.usefixtures("double")
def test_the_shared_block_is_the_mean_over_tasks_and_private_blocks_are_their_own(
    rng: np.random.Generator,
) -> None:
    data = batch(rng, 2)
    made, slopes = per_task(TWO_ARMS, data)
    ascent = torch.stack(
        [
            (slopes[0][:, 0] + slopes[1][:, 0]) / 2,
            slopes[0][:, 1],
            slopes[1][:, 2],
            slopes[1][:, 3],
        ],
        dim=1,
    )
    torch.testing.assert_close(gradient(made), pushed(learner(TWO_ARMS), data, ascent))


@pytest.mark.usefixtures("double")
def test_a_task_never_moves_the_other_arm(rng: np.random.Generator) -> None:
    made = learner(TWO_ARMS)
    for critic in (made.critic, made.target_critic):
        critic.mlp.output.weight.data[:, :, 1], critic.mlp.output.bias.data[:, :, 1] = 0, 0
    data = batch(rng, 2)
    data.reward[:, 1] = 0
    made.update(data)
    moved = made.actor.mlp.output.weight.grad[0].abs().sum(dim=0)
    assert (moved[:2] > 0).all()
    assert (moved[2:] == 0).all()


@pytest.mark.usefixtures("double")
@pytest.mark.parametrize(("combination", "share"), [("sum", 1.0), ("mean", 0.5)])
def test_the_ablations_ascend_the_unmasked_value(
    combination: str, share: float, rng: np.random.Generator
) -> None:
    data = batch(rng, 2)
    made = learner(TWO_ARMS, config=replace(DDPG, gradient=combination))  # type: ignore[arg-type]
    made.update(data)
    fresh = learner(TWO_ARMS)
    value = -share * made.critic(data.state, fresh.actor(data.state))[0].sum(dim=1).mean()
    wanted = torch.cat(
        [part.reshape(-1) for part in torch.autograd.grad(value, tuple(fresh.actor.parameters()))]
    )
    torch.testing.assert_close(gradient(made), wanted)


@pytest.mark.usefixtures("double")
@pytest.mark.parametrize("ascent", ["first", "mean"])
def test_the_actor_ascends_the_first_critic_or_the_mean_of_all(
    ascent: str, rng: np.random.Generator
) -> None:
    data, network = batch(rng, 2), replace(PLAIN, critics=3, ascent=ascent)  # type: ignore[arg-type]
    config = replace(DDPG, gradient="sum")
    made, fresh = (
        learner(TWO_ARMS, network=network, config=config),
        learner(TWO_ARMS, network=network, config=config),
    )
    made.update(data)
    q = made.critic(data.state, fresh.actor(data.state))
    value = -(q[0] if ascent == "first" else q.mean(dim=0)).sum(dim=1).mean()
    wanted = torch.cat(
        [part.reshape(-1) for part in torch.autograd.grad(value, tuple(fresh.actor.parameters()))]
    )
    torch.testing.assert_close(gradient(made), wanted)


@pytest.mark.usefixtures("double")
def test_both_networks_learn_at_a_share_of_their_rates(rng: np.random.Generator) -> None:
    """Adam's first step is the rate in every entry whose gradient is not tiny, so a tenth of the
    rate is a tenth of the step."""
    data = batch(rng, 2)
    full, slow, before = (learner(TWO_ARMS) for _ in range(3))
    slow.slow_down(0.1)
    full.update(data)
    slow.update(data)
    for name in ("actor", "critic"):
        start, far, near = (
            torch.cat([p.detach().reshape(-1) for p in getattr(made, name).parameters()])
            for made in (before, full, slow)
        )
        moving = (far - start).abs() > 1e-5
        assert moving.any()
        if name == "critic":  # the actor's gradient is that of a critic which has moved less
            torch.testing.assert_close(
                (near - start)[moving], 0.1 * (far - start)[moving], rtol=1e-3, atol=0.0
            )
        else:
            assert (
                0.08
                < (near - start).abs()[moving].mean() / (far - start).abs()[moving].mean()
                < 0.12
            )


@pytest.mark.usefixtures("double")
def test_gradient_surgery_opposes_neither_task(rng: np.random.Generator) -> None:
    data = batch(rng, 2, imitated=1.0)
    made = learner(TWO_ARMS, config=replace(DDPG, gradient="pcgrad"))
    made.update(data, behaviour_weight=0.0)
    fresh = learner(TWO_ARMS)
    value = -made.critic(data.state, fresh.actor(data.state))[0].mean(dim=0)
    for task in value:
        parts = torch.autograd.grad(task, tuple(fresh.actor.parameters()), retain_graph=True)
        assert torch.dot(gradient(made), torch.cat([part.reshape(-1) for part in parts])) > -1e-12


@pytest.mark.usefixtures("double")
@pytest.mark.parametrize("combination", ["mask", "pcgrad"])
def test_the_behaviour_term_pulls_where_actions_are_imitated(
    combination: str, rng: np.random.Generator
) -> None:
    data = batch(rng, 2)
    half = torch.zeros(B, 1)
    half[: B // 2] = torch.linspace(0.5, 1.0, B // 2)[:, None]
    data = data._replace(imitated=half)
    config = replace(DDPG, gradient=combination)  # type: ignore[arg-type]
    with_pull, without = learner(TWO_ARMS, config=config), learner(TWO_ARMS, config=config)
    update = with_pull.update(data, behaviour_weight=3.0)
    without.update(data)
    fresh = learner(TWO_ARMS)
    away = (half * (fresh.actor(data.state) - data.wanted).square()).mean()
    parts = torch.autograd.grad(3.0 * away, tuple(fresh.actor.parameters()))
    torch.testing.assert_close(
        gradient(with_pull) - gradient(without), torch.cat([part.reshape(-1) for part in parts])
    )
    torch.testing.assert_close(update.behaviour, away.detach())


@pytest.mark.usefixtures("double")
def test_the_effort_term_pulls_all_actions_towards_rest(rng: np.random.Generator) -> None:
    data = batch(rng, 2)
    with_effort, without = learner(TWO_ARMS), learner(TWO_ARMS)
    with_effort.update(data, effort=0.7)
    without.update(data)
    fresh = learner(TWO_ARMS)
    parts = torch.autograd.grad(
        0.7 * fresh.actor(data.state).square().mean(), tuple(fresh.actor.parameters())
    )
    torch.testing.assert_close(
        gradient(with_effort) - gradient(without), torch.cat([part.reshape(-1) for part in parts])
    )


@pytest.mark.usefixtures("double")
def test_normalising_divides_by_the_mean_absolute_value(rng: np.random.Generator) -> None:
    data = batch(rng, 2)
    made, plain = learner(TWO_ARMS, config=replace(DDPG, normalise=True)), learner(TWO_ARMS)
    made.update(data)
    plain.update(data)
    size = made.critic(data.state, learner(TWO_ARMS).actor(data.state), count=1).abs().mean()
    torch.testing.assert_close(gradient(made) * size, gradient(plain))


def test_a_termination_is_not_bootstrapped_through_and_a_truncation_is(
    rng: np.random.Generator,
) -> None:
    made = learner(TWO_ARMS)
    made.target_critic.mlp.output.bias.data += 5.0
    data = batch(rng, 2)
    data.discount[:] = 0.9
    data.discount[3] = 0
    y = made.targets(data)
    value = made.target_critic(data.next_state, made.target_actor(data.next_state))[0]
    torch.testing.assert_close(y[3], data.reward[3])
    going = torch.arange(B) != 3  # a truncated step has the discount of any other
    torch.testing.assert_close(y[going], (data.reward + 0.9 * value)[going])
    assert (y - data.reward)[going].abs().min() > 4


def test_twins_give_the_smaller_value_per_head(rng: np.random.Generator) -> None:
    made = learner(TWO_ARMS, network=replace(PLAIN, critics=2))
    made.target_critic.mlp.output.bias.data[0, 0, 0] += 5.0
    made.target_critic.mlp.output.bias.data[1, 0, 1] += 7.0
    data = batch(rng, 2)
    data.discount[:] = 0.9
    values = made.target_critic(data.next_state, made.target_actor(data.next_state))
    least = torch.stack((values[1, :, 0], values[0, :, 1]), dim=1)
    torch.testing.assert_close(made.targets(data), data.reward + 0.9 * least)


def test_targets_are_smoothed_within_their_clip_and_bounded(rng: np.random.Generator) -> None:
    noisy = learner(TWO_ARMS, config=replace(DDPG, target_noise=0.5, target_clip=0.1))
    seen: list[Tensor] = []
    noisy.target_critic.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[1]))
    data = batch(rng, 2)
    noisy.targets(data)
    noise = (seen[0] - noisy.target_actor(data.next_state)).abs()
    assert 0.05 < noise.mean() < noise.max() <= 0.1 + 1e-6
    bounded = Learner(
        N_X,
        gradient_mask(TWO_ARMS, N_U),
        Settings(PLAIN, replace(DDPG, clip_targets=True, reward_scale=0.5)),
        bounds=(-1.0, 2.0),
    )
    y = bounded.targets(data._replace(reward=100 * data.reward))
    assert (y.min().item(), y.max().item()) == (-0.5, 1.0)


def test_rewards_are_scaled_inside_and_values_reported_outside(rng: np.random.Generator) -> None:
    made = learner(TWO_ARMS, config=replace(DDPG, reward_scale=0.1))
    data = batch(rng, 2)
    data.discount[:] = 0
    torch.testing.assert_close(made.targets(data), 0.1 * data.reward)
    q = made.critic(data.state, data.action).detach()
    update = made.update(data)
    torch.testing.assert_close(update.q, q.mean(dim=(0, 1)) * 10)
    torch.testing.assert_close(update.q_high, q.max() * 10)


def test_targets_follow_slowly_and_in_the_right_direction(rng: np.random.Generator) -> None:
    made = learner(TWO_ARMS)
    old = [
        tensor.clone()
        for tensor in (*made.target_actor.parameters(), *made.target_critic.parameters())
    ]
    made.update(batch(rng, 2))
    now = (*made.target_actor.parameters(), *made.target_critic.parameters())
    online = (*made.actor.parameters(), *made.critic.parameters())
    for before, after, new in zip(old, now, online, strict=True):
        torch.testing.assert_close(after, 0.05 * new + 0.95 * before)


def test_the_actor_and_the_targets_wait_for_the_critic(rng: np.random.Generator) -> None:
    made = learner(TWO_ARMS, config=replace(DDPG, actor_delay=3))
    start = made.actor.mlp.output.weight.detach().clone()
    moved = []
    for _ in range(6):
        made.update(batch(rng, 2))
        moved.append(not torch.equal(made.actor.mlp.output.weight, start))
        start = made.actor.mlp.output.weight.detach().clone()
    assert moved == [False, False, True, False, False, True]


def test_running_moments_reach_the_targets(rng: np.random.Generator) -> None:
    made = learner(
        TWO_ARMS,
        network=replace(PRESETS["paper"].network, hidden=(8, 6)),
        config=PRESETS["paper"].learner,
    )
    for _ in range(3):
        made.update(batch(rng, 2))
    for target, online in ((made.target_actor, made.actor), (made.target_critic, made.critic)):
        moments = [
            (name, value)
            for name, value in online.named_buffers()
            if name.endswith(("mean", "variance"))
        ]
        assert moments
        assert all(torch.equal(target.get_buffer(name), value) for name, value in moments)
        assert any(value.abs().max() > 0 for name, value in moments if name.endswith("mean"))


def test_weight_decay_shrinks_the_critics_weights_only(rng: np.random.Generator) -> None:
    made = learner(TWO_ARMS, config=replace(DDPG, weight_decay=0.01))
    decays = {
        id(tensor): group["weight_decay"]
        for group in made.critic_optimiser.param_groups
        for tensor in group["params"]
    }
    named = dict(made.critic.named_parameters())
    assert len(decays) == len(named)
    assert all(
        decays[id(tensor)] == (0.01 if name.endswith("weight") else 0)
        for name, tensor in named.items()
    )
    assert all(group["weight_decay"] == 0 for group in made.actor_optimiser.param_groups)


def two_tasks(action: Tensor) -> Tensor:
    """Private actions are wanted at 0.3 and -0.4, the shared one at 0.5 by the first task and at
    -0.1 by the second.

    The second task also profits from the first one's private action, which a sum of gradients
    follows and DiGrad does not.
    """
    shared, first, second = action[:, 0], action[:, 1], action[:, 2]
    return torch.stack(
        (
            -((first - 0.3) ** 2) - (shared - 0.5) ** 2,
            first - (second + 0.4) ** 2 - (shared + 0.1) ** 2,
        ),
        dim=1,
    )


@pytest.mark.parametrize(
    ("combination", "optimum"), [("mask", [0.2, 0.3, -0.4]), ("sum", [0.2, 0.8, -0.4])]
)
def test_two_tasks_that_share_an_action_are_solved(
    combination: str, optimum: list[float], rng: np.random.Generator
) -> None:
    config = LearnerConfig(
        reward_scale=1.0, actor_rate=1e-3, critic_rate=2e-3, tau=0.05, gradient=combination
    )  # type: ignore[arg-type]
    mask = gradient_mask({"left": [0, 1], "right": [0, 2]}, 3)
    settings = Settings(NetworkConfig(hidden=(48, 48)), config)
    made = Learner(1, mask, settings, bounds=(-10.0, 2.0))
    for _ in range(400):
        state, action = (
            torch.tensor(rng.uniform(-1, 1, (64, width)), dtype=torch.float32) for width in (1, 3)
        )
        made.update(
            Batch(
                state,
                action,
                two_tasks(action),
                state,
                torch.zeros(64, 1),
                torch.zeros(64, 1),
                action,
            )
        )
    with torch.no_grad():
        found = made.actor(torch.linspace(-1, 1, 50)[:, None])
    torch.testing.assert_close(found, torch.tensor(optimum).expand_as(found), rtol=0, atol=0.15)


@pytest.mark.parametrize("preset", PRESETS)
def test_updates_continue_bit_for_bit_from_a_state(preset: str, rng: np.random.Generator) -> None:
    settings = PRESETS[preset]
    network = replace(settings.network, hidden=(16, 12))
    data = [batch(rng, 2, imitated=1.0) for _ in range(10)]
    through, first = (learner(TWO_ARMS, network=network, config=settings.learner) for _ in range(2))
    for item in data[:5]:
        first.update(item, behaviour_weight=0.5)
    second = learner(TWO_ARMS, network=network, config=settings.learner, seed=99)
    second.load_state({name: tensor.clone() for name, tensor in first.state().items()})
    reports = [second.update(item, behaviour_weight=0.5) for item in data[5:]]
    expected = [through.update(item, behaviour_weight=0.5) for item in data][5:]
    for name, tensor in through.state().items():
        assert torch.equal(tensor, second.state()[name]), name
    for one, other in zip(reports, expected, strict=True):
        assert all(torch.equal(a, b) for a, b in zip(one, other, strict=True))


def test_a_state_of_another_layout_is_refused_by_name() -> None:
    saved = learner(TWO_ARMS).state()
    mask = gradient_mask(TWO_ARMS, N_U)
    other = Learner(N_X + 1, mask, Settings(PLAIN, DDPG), bounds=BOUNDS)
    with pytest.raises(
        SpecError,
        match=r"actor\.mlp\.layers\.0\.weight: expected shape \(1, 6, 12\), got \(1, 5, 12\)",
    ):
        other.load_state(saved)
    with pytest.raises(SpecError, match=r"actor\.mlp.* got None"):
        other.load_state({})


def test_the_average_is_of_the_last_share_of_the_actors() -> None:
    config = replace(DDPG, actor_rate=0.01)
    made = Learner(
        N_X,
        gradient_mask(TWO_ARMS, N_U),
        Settings(PLAIN, config, loop=LoopConfig(average=0.5)),
        bounds=BOUNDS,
    )
    first = torch.cat([each.detach().reshape(-1) for each in made.actor.parameters()])
    wanted = first.clone()
    generator = np.random.default_rng(0)
    for update in range(1, 30):
        made.update(batch(generator, 2))
        now = torch.cat([each.detach().reshape(-1) for each in made.actor.parameters()])
        wanted += (now - wanted) * min(1.0, 1 / (0.5 * update))
    found = torch.cat([each.reshape(-1) for each in made.average_actor.parameters()])
    torch.testing.assert_close(found, wanted, rtol=1e-5, atol=1e-6)
    assert not torch.allclose(found, now, atol=1e-4)


def test_imitating_pulls_towards_what_was_done_and_leaves_critics_alone(
    rng: np.random.Generator,
) -> None:
    made = learner(TWO_ARMS, config=replace(DDPG, actor_rate=0.01))
    data = batch(rng, 2)
    done = torch.tanh(torch.linspace(-1, 1, N_U)).expand(B, N_U)
    weight = torch.ones(B, 1)
    weight[0] = 0.0
    before = [each.clone() for each in made.critic.parameters()]
    for _ in range(300):
        made.imitate(Examples(data.state, done, weight), behaviour_weight=1.0, effort=0.0)
    torch.testing.assert_close(made.actor(data.state)[1:], done[1:], atol=0.05, rtol=0.0)
    now = tuple(made.critic.parameters())
    assert all(torch.equal(*pair) for pair in zip(before, now, strict=True))
    assert made.updates == 0
