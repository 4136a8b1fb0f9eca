from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn
from torch.nn import functional as F  # noqa: N812

from coordlog.policies.learned import Policy
from coordlog.train.config import NetworkConfig
from coordlog.train.networks import Actor, Critic
from coordlog.train.settings import PRESETS

B, N_X, N_U, K = 12, 7, 4, 3
PAPER = replace(PRESETS["paper"].network, hidden=(10, 6))


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def numbers(*shape: int, seed: int = 1) -> torch.Tensor:
    return torch.randn(*shape, generator=seeded(seed))


def test_an_ensemble_is_its_members_evaluated_one_by_one() -> None:
    critic = Critic(N_X, N_U, K, config=NetworkConfig(hidden=(8, 5), critics=3), generator=seeded())
    state, action = numbers(B, N_X), numbers(B, N_U, seed=2)
    together = critic(state, action)
    for member in range(3):
        h = torch.cat((state, action), dim=1)
        for index, layer in enumerate(critic.mlp.layers):
            h = h @ layer.weight[member] + layer.bias[member, 0]
            h = F.relu(F.layer_norm(h, (layer.weight.shape[2],)) if index > 0 else h)
        alone = h @ critic.mlp.output.weight[member] + critic.mlp.output.bias[member, 0]
        torch.testing.assert_close(together[member], alone)
    torch.testing.assert_close(critic(state, action, count=1), together[:1])


def test_the_papers_critic_meets_the_action_in_its_second_layer_and_normalises_only_before_it() -> (
    None
):
    critic = Critic(N_X, N_U, K, config=PAPER, generator=seeded())
    assert [layer.weight.shape for layer in critic.mlp.layers] == [(1, N_X, 10), (1, 20 + N_U, 6)]
    assert [layer.norm for layer in critic.mlp.layers] == ["batch", "none"]
    actor = Actor(N_X, N_U, config=PAPER, generator=seeded())
    assert [layer.norm for layer in actor.mlp.layers] == ["batch", "batch"]


def test_batch_normalisation_is_torchs_own() -> None:
    actor = Actor(
        N_X,
        N_U,
        config=replace(PAPER, dropout=0.0, activation="relu", hidden=(5,), action_layer=1),
        generator=seeded(),
    )
    layer, reference = actor.mlp.layers[0], nn.BatchNorm1d(5, momentum=0.01)
    state = numbers(B, N_X)
    for training in (True, True, False):
        reference.train(training)
        h = F.relu(reference(state @ layer.weight[0] + layer.bias[0, 0]))
        wanted = torch.tanh(h @ actor.mlp.output.weight[0] + actor.mlp.output.bias[0, 0])
        torch.testing.assert_close(actor(state, training=training), wanted)
    torch.testing.assert_close(layer.mean[0, 0], reference.running_mean)
    torch.testing.assert_close(layer.variance[0, 0], reference.running_var)


def test_dropout_drops_its_share_keeps_the_mean_and_is_off_when_acting() -> None:
    config = NetworkConfig(hidden=(400,), dropout=0.2, final_init=1.0)
    actor = Actor(N_X, N_U, config=config, generator=seeded())
    seen: list[torch.Tensor] = []
    actor.mlp.output.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0]))
    state = numbers(256, N_X)
    actor(state), actor(state, training=True, generator=seeded())
    alive = seen[0] > 0
    assert (seen[1][alive] == 0).float().mean() == pytest.approx(0.2, abs=0.01)
    torch.testing.assert_close(seen[1][seen[1] > 0], seen[0][seen[1] > 0] / 0.8)
    torch.testing.assert_close(actor(state), actor(state))


def test_output_layers_start_small_and_hidden_ones_by_fan_in() -> None:
    actor = Actor(
        N_X, N_U, config=NetworkConfig(hidden=(400, 300), final_init=3e-3), generator=seeded()
    )
    limits = [layer.weight.abs().max().item() for layer in (*actor.mlp.layers, actor.mlp.output)]
    assert limits == pytest.approx([N_X**-0.5, 400**-0.5, 3e-3], rel=0.02)


@pytest.mark.parametrize("norm", ["none", "layer", "batch"])
@pytest.mark.parametrize("activation", ["relu", "crelu"])
def test_a_policy_acts_as_its_actor_does(norm: str, activation: str) -> None:
    config = NetworkConfig(
        hidden=(16, 9), activation=activation, actor_norm=norm, dropout=0.1, final_init=1.0
    )  # type: ignore[arg-type]
    actor = Actor(N_X, N_U, config=config, generator=seeded())
    for name, parameter in actor.named_parameters():
        if name.endswith(("gain", "shift")):
            parameter.data += 0.3 * torch.rand(parameter.shape, generator=seeded(9))
    for seed in range(20):
        actor(3 + 2 * numbers(64, N_X, seed=seed), training=True, generator=seeded())
    state = numbers(B, N_X)
    with torch.no_grad():
        wanted = actor(state).numpy()
    policy = Policy(actor.arrays(), {"activation": activation, "norm": norm})
    np.testing.assert_allclose(policy(state.numpy()), wanted, atol=2e-6)
