"""Actor μ(s) and critic Q(s, a) with one head per task.

All members of an ensemble of critics are evaluated as one batched product: parameters carry a
leading member axis E, activations are (E, B, width). Whether dropout and batch statistics are on is
an argument of each call, because one update needs both: off in targets and in the critic of the
actor's step, on in the network that is being updated.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812 - the name everybody uses

from coordlog.episode import Array
from coordlog.train.config import NetworkConfig, Norm

BATCH_NORM_MOMENTUM = 0.01
NORM_EPSILON = 1e-5


class Dense(nn.Module):
    """E affine maps (E, B, n_in) → (E, B, n_out), each followed by a normalisation over its units
    or over the batch.

    A layer normalisation has no gain and shift of its own: the bias before it and the weights after
    it do their work in less time. A batch normalisation cancels the bias before it, so it has both.
    """

    ones: Tensor
    mean: Tensor
    variance: Tensor

    def __init__(
        self,
        n_in: int,
        n_out: int,
        *,
        members: int,
        norm: Norm,
        bound: float,
        generator: torch.Generator,
    ) -> None:
        super().__init__()
        self.members, self.norm = members, norm
        self.weight = nn.Parameter(
            torch.empty(members, n_in, n_out).uniform_(-bound, bound, generator=generator)
        )
        self.bias = nn.Parameter(
            torch.empty(members, 1, n_out).uniform_(-bound, bound, generator=generator)
        )
        if norm == "layer":
            self.register_buffer(
                "ones", torch.ones(n_out), persistent=False
            )  # torch is slower without than with a gain of one
        if norm == "batch":
            self.gain = nn.Parameter(torch.ones(members, 1, n_out))
            self.shift = nn.Parameter(torch.zeros(members, 1, n_out))
            self.register_buffer("mean", torch.zeros(members, 1, n_out))
            self.register_buffer("variance", torch.ones(members, 1, n_out))

    def forward(self, x: Tensor, *, training: bool, count: int) -> Tensor:
        """The first `count` members' outputs."""
        whole = (
            count == self.members
        )  # a slice of everything would still cost a backward pass of its own
        weight, bias = (
            (self.weight, self.bias) if whole else (self.weight[:count], self.bias[:count])
        )
        h = torch.baddbmm(bias, x, weight)
        if self.norm == "layer":
            return F.layer_norm(h, h.shape[-1:], self.ones, eps=NORM_EPSILON)
        if self.norm == "batch":
            return torch.addcmul(
                self.shift[:count],
                self._standardised(h, training=training, count=count),
                self.gain[:count],
            )
        return h

    def _standardised(self, h: Tensor, *, training: bool, count: int) -> Tensor:
        """Each unit over the batch.

        In training the running moments move towards those of the batch.
        """
        flat = h.transpose(0, 1).reshape(h.shape[1], -1)  # (B, count * n_out)
        mean, variance = self.mean[:count].view(-1), self.variance[:count].view(-1)
        flat = F.batch_norm(
            flat, mean, variance, training=training, momentum=BATCH_NORM_MOMENTUM, eps=NORM_EPSILON
        )
        return flat.view(h.shape[1], count, -1).transpose(0, 1)

    def folded(self) -> tuple[Tensor, Tensor]:
        """Weight (n_in, n_out) and bias (n_out,) of the first member, a batch normalisation
        multiplied in.
        """
        weight, bias = self.weight[0], self.bias[0, 0]
        if self.norm != "batch":
            return weight, bias
        factor = self.gain[0, 0] * torch.rsqrt(self.variance[0, 0] + NORM_EPSILON)
        return weight * factor, (bias - self.mean[0, 0]) * factor + self.shift[0, 0]


class Shape(NamedTuple):
    """Widths around the hidden layers: inputs, inputs that join at the second hidden layer,
    outputs, members.
    """

    n_in: int
    n_late: int
    n_out: int
    members: int


class Mlp(nn.Module):
    """E multilayer perceptrons of one shape: dense, normalise, activate, drop out.

    A linear output layer.
    """

    def __init__(
        self,
        shape: Shape,
        norms: tuple[Norm, ...],
        *,
        config: NetworkConfig,
        generator: torch.Generator,
    ) -> None:
        super().__init__()
        self.members, self.crelu, self.dropout = (
            shape.members,
            config.activation == "crelu",
            config.dropout,
        )
        self.layers = nn.ModuleList()
        width = shape.n_in
        for index, (units, norm) in enumerate(zip(config.hidden, norms, strict=True)):
            width += shape.n_late if index == 1 else 0
            bound = 1 / math.sqrt(width)
            self.layers.append(
                Dense(
                    width, units, members=shape.members, norm=norm, bound=bound, generator=generator
                )
            )
            width = units * (1 + self.crelu)
        self.output = Dense(
            width,
            shape.n_out,
            members=shape.members,
            norm="none",
            bound=config.final_init,
            generator=generator,
        )

    def forward(
        self,
        x: Tensor,
        late: Tensor | None = None,
        *,
        training: bool = False,
        generator: torch.Generator | None = None,
        count: int | None = None,
    ) -> Tensor:
        """Outputs (count, B, n_out) of the first `count` members (all by default) for inputs (B,
        n_in) and late inputs (B, n_late).
        """
        count = self.members if count is None else count
        h = x.expand(count, *x.shape)
        for index, layer in enumerate(self.layers):
            if index == 1 and late is not None:
                h = torch.cat((h, late.expand(count, *late.shape)), dim=-1)
            h = layer(h, training=training, count=count)
            h = torch.cat((F.relu(h), F.relu(-h)), dim=-1) if self.crelu else F.relu_(h)
            if training and self.dropout > 0:
                h = h * torch.empty_like(h).bernoulli_(1 - self.dropout, generator=generator).div_(
                    1 - self.dropout
                )
        return self.output(h, training=training, count=count)  # type: ignore[no-any-return]


def hidden_norms(norm: Norm, layers: int, *, free: int) -> tuple[Norm, ...]:
    """The normalisation of each hidden layer.

    "layer" is on all but the first, which would otherwise lose how far away a goal is and keep only
    in which direction; "batch" is on the first `free` ones.
    """
    having = range(1, layers) if norm == "layer" else range(free)
    return tuple(norm if index in having else "none" for index in range(layers))


class Actor(nn.Module):
    """The compound policy μ: states (B, n_x) to actions (B, n_u) in [-1, 1]."""

    def __init__(
        self, n_x: int, n_u: int, *, config: NetworkConfig, generator: torch.Generator
    ) -> None:
        super().__init__()
        norms = hidden_norms(config.actor_norm, len(config.hidden), free=len(config.hidden))
        self.mlp = Mlp(Shape(n_x, 0, n_u, 1), norms, config=config, generator=generator)

    def forward(
        self, state: Tensor, *, training: bool = False, generator: torch.Generator | None = None
    ) -> Tensor:
        """Actions; dropout and batch statistics only in training."""
        return torch.tanh(self.mlp(state, training=training, generator=generator)[0])

    def arrays(self) -> dict[str, Array]:
        """Weights and biases that acting needs, float32 copies, batch normalisation folded in (see
        policy.py).
        """
        named: dict[str, Array] = {}
        with torch.no_grad():
            for index, layer in enumerate((*self.mlp.layers, self.mlp.output)):
                assert isinstance(layer, Dense)
                for name, tensor in zip(("weight", "bias"), layer.folded(), strict=True):
                    named[f"{name}.{index}"] = np.array(
                        tensor.cpu().numpy(), dtype=np.float32, order="C"
                    )
        return named


class Critic(nn.Module):
    """Q: states and full actions to one value per task and member, (E, B, k).

    Head i sees every joint: r_i depends on all of them.
    """

    def __init__(
        self, n_x: int, n_u: int, k: int, *, config: NetworkConfig, generator: torch.Generator
    ) -> None:
        super().__init__()
        self.late = config.action_layer == 2
        norms = hidden_norms(config.critic_norm, len(config.hidden), free=config.action_layer - 1)
        shape = (
            Shape(n_x, n_u, k, config.critics)
            if self.late
            else Shape(n_x + n_u, 0, k, config.critics)
        )
        self.mlp = Mlp(shape, norms, config=config, generator=generator)

    def forward(
        self,
        state: Tensor,
        action: Tensor,
        *,
        training: bool = False,
        generator: torch.Generator | None = None,
        count: int | None = None,
    ) -> Tensor:
        """Values of the first `count` members (all by default), (count, B, k)."""
        if self.late:
            return self.mlp(state, action, training=training, generator=generator, count=count)  # type: ignore[no-any-return]
        return self.mlp(  # type: ignore[no-any-return]
            torch.cat((state, action), dim=-1), training=training, generator=generator, count=count
        )
