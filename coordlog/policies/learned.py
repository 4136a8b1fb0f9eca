"""A trained policy as a small file and a NumPy function: states in, actions out, no torch.

The action for a state has the same bits whatever other states are asked about with it, so an
episode does not depend on how many run beside it. Matrix products do not promise that: a row's sum
may be ordered by its place among the rows. So rows go through in blocks of a fixed size, one for
which a row's place is found not to matter, and row by row where there is none.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from coordlog.episode import Array, Json
from coordlog.errors import FormatError, SpecError
from coordlog.policies.checkpoint import load_arrays, save_arrays

KIND = "coordlog policy"
BLOCKS = (8, 4)
NORM_EPSILON = np.float32(1e-5)
MOST = 256 << 20
"""Largest policy file that is read [bytes]; those that ship have 0.3 MB."""
CHOICES = {"activation": ("relu", "crelu"), "norm": ("none", "layer", "batch")}
"""What a file may say of its hidden layers; a batch normalisation is part of the weights."""


class Origin(NamedTuple):
    """Where a policy was trained."""

    scene: str
    env: Json
    """The `coordlog.env` record."""


class Policy:
    """μ(s) without noise: float32 states (n_x,) or (B, n_x) to actions in [-1, 1] of the same
    leading shape.
    """

    def __init__(self, arrays: dict[str, Array], about: Json) -> None:
        """Act with these weights.

        Args:
            arrays: "weight.0" (n_x, units), "bias.0", … of each layer, float32, as `Actor.arrays`
                gives them.
            about: JSON-able: "activation" and "norm" of the hidden layers, and whatever a reader
                should know (layout, names of the state's entries, arms, constants, digests of what
                it was trained on).

        Raises:
            FormatError: if layers are missing, do not fit together, or hold values that are not
                finite.
        """
        self._layers = _layers(arrays, about)
        self._crelu, self._norm = about["activation"] == "crelu", about["norm"] == "layer"
        self.arrays, self.about = arrays, about
        self.n_x, self.n_u = self._layers[0][0].shape[0], self._layers[-1][0].shape[1]
        self._block = _safe_block(
            tuple(weight.shape for weight, _ in self._layers), self._crelu, self._norm
        )

    def __call__(self, state: Array) -> Array:
        """Actions for states.

        Raises:
            SpecError: if the states are not n_x wide.
        """
        if state.shape[-1] != self.n_x or state.ndim > 2:
            raise SpecError(
                f"state: expected {self.n_x} entries per row, got shape {state.shape}; this policy "
                "is of another layout"
            )
        rows = state.reshape(-1, self.n_x)
        padded = np.zeros((-(-len(rows) // self._block) * self._block, self.n_x), np.float32)
        padded[: len(rows)] = rows
        blocks = [
            _forward(padded[start : start + self._block], self._layers, self._crelu, self._norm)
            for start in range(0, len(padded), self._block)
        ]
        actions = np.concatenate(blocks) if blocks else np.zeros((0, self.n_u), np.float32)
        return np.asarray(actions[: len(rows)].reshape(*state.shape[:-1], self.n_u))

    def begin(self, ids: Array, state: Array, rngs: list[np.random.Generator]) -> None:
        """Episodes start; there is nothing to prepare. With `act`, this is a `rollout.Policy`."""

    def act(self, ids: Array, state: Array) -> Array:
        """Actions (n, n_u) for the states (n, n_x) of these slots."""
        return self(state)

    def save(self, path: Path) -> None:
        """Write the policy file, at once or not at all.

        Raises:
            StorageError: if the file system refuses.
        """
        save_arrays(path, self.arrays, kind=KIND, meta=self.about)

    @classmethod
    def load(cls, path: Path) -> Policy:
        """Read a policy file.

        Raises:
            StorageError: if it cannot be read.
            FormatError: if it is not a policy file.
        """
        try:
            return cls(*load_arrays(path, kind=KIND, most=MOST))
        except FormatError as error:
            text = str(error)
            raise FormatError(text if str(path) in text else f"{path}: {text}") from None

    def origin(self) -> Origin:
        """The scene and the environment that the policy was trained in.

        Raises:
            FormatError: if the file does not say, or says it in another shape.
        """
        scene, env = self.about.get("scene"), self.about.get("env")
        if not isinstance(scene, str) or not isinstance(env, dict):
            raise FormatError(
                "policy: expected the scene's name and the env record that it was trained in,"
                f" got {str(scene)[:40]!r} and {str(env)[:40]!r}"
            )
        kinds = {"config": dict, "reward": dict, "state": list, "action_joints": list}
        for key, kind in kinds.items():
            if not isinstance(env.get(key), kind):
                raise FormatError(
                    f"policy: env '{key}': expected {kind.__name__}, got {str(env.get(key))[:40]!r}"
                )
        return Origin(scene, env)


def _layers(arrays: dict[str, Array], about: Json) -> list[tuple[Array, Array]]:
    """Weight and bias of each layer, if they make a network.

    Raises:
        FormatError: naming the first array that does not.
    """
    count, width = len(arrays) // 2, 0
    names = [name for index in range(count) for name in (f"weight.{index}", f"bias.{index}")]
    missing = sorted({*names} - {*arrays}) or [key for key in CHOICES if key not in about]
    if missing or len(arrays) % 2:
        raise FormatError(f"policy: {(missing or ['a bias'])[0]} is missing")
    for key, choices in CHOICES.items():
        if about[key] not in choices:
            raise FormatError(
                f"policy: {key}: expected {' or '.join(choices)}, got {str(about[key])[:40]!r}"
            )
    for name in names:
        array, matrix = arrays[name], name.startswith("weight")
        fits = array.ndim == 2 and array.shape[0] in (width, array.shape[0] * (not width))
        fits = fits and min(array.shape) > 0 if matrix else array.shape == (width,)
        if array.dtype != np.float32 or not fits:
            wanted = f"({width or 'n_x'}, units)" if matrix else f"({width},)"
            raise FormatError(
                f"policy: {name}: expected float32 of shape {wanted}, got {array.dtype} of shape"
                f" {array.shape}"
            )
        if matrix:
            width = array.shape[1]
        elif about["activation"] == "crelu":
            width *= 2
    if count == 0 or not all(np.isfinite(array).all() for array in arrays.values()):
        raise FormatError(
            "policy: expected layers of finite weights; this one is empty or comes from a run that "
            "diverged"
        )
    return [(arrays[f"weight.{index}"], arrays[f"bias.{index}"]) for index in range(count)]


def _forward(h: Array, layers: list[tuple[Array, Array]], crelu: bool, norm: bool) -> Array:
    for index, (weight, bias) in enumerate(layers[:-1]):
        h = h @ weight + bias
        if norm and index > 0:
            h = h - h.mean(axis=1, keepdims=True)
            h = h / np.sqrt(np.square(h).mean(axis=1, keepdims=True) + NORM_EPSILON)
        h = (
            np.concatenate((np.maximum(h, 0), np.maximum(-h, 0)), axis=1)
            if crelu
            else np.maximum(h, 0)
        )
    weight, bias = layers[-1]
    return np.asarray(np.tanh(h @ weight + bias))


@lru_cache(maxsize=32)
def _safe_block(shapes: tuple[tuple[int, int], ...], crelu: bool, norm: bool) -> int:
    """The first block size for which a row gives the same bits at every place in the block, tried
    on random weights and rows.
    """
    rng = np.random.default_rng(0)
    layers = [
        (
            rng.normal(size=shape).astype(np.float32) / np.float32(np.sqrt(shape[0])),
            np.zeros(shape[1], np.float32),
        )
        for shape in shapes
    ]
    for block in BLOCKS:
        rows = rng.normal(size=(block, shapes[0][0])).astype(np.float32)
        turned = [
            np.roll(_forward(np.roll(rows, shift, axis=0), layers, crelu, norm), -shift, axis=0)
            for shift in range(block)
        ]
        if all(np.array_equal(turned[0], other) for other in turned):
            return block
    return 1
