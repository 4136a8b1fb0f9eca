from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from coordlog.errors import FormatError, SpecError, StorageError
from coordlog.policies.checkpoint import save_arrays
from coordlog.policies.learned import Policy, _safe_block
from coordlog.train.exploration import Exploring, Noise

N_X, N_U = 31, 13


def policy(
    rng: np.random.Generator,
    *,
    hidden: tuple[int, ...] = (256, 256),
    activation: str = "relu",
    norm: str = "none",
) -> Policy:
    arrays, width = {}, N_X
    for index, units in enumerate((*hidden, N_U)):
        arrays[f"weight.{index}"] = rng.normal(size=(width, units), scale=width**-0.5).astype(
            np.float32
        )
        arrays[f"bias.{index}"] = rng.normal(size=units).astype(np.float32)
        width = units * (2 if activation == "crelu" else 1)
    return Policy(arrays, {"activation": activation, "norm": norm, "arms": {"left": [0, 1]}})


@pytest.mark.parametrize(
    ("hidden", "activation", "norm"),
    [
        ((256, 256), "relu", "none"),
        ((70, 40), "crelu", "layer"),
        ((33,), "relu", "layer"),
        ((), "relu", "none"),
    ],
)
def test_an_action_has_the_same_bits_in_whatever_company(
    hidden: tuple[int, ...], activation: str, norm: str, rng: np.random.Generator
) -> None:
    act = policy(rng, hidden=hidden, activation=activation, norm=norm)
    states = rng.normal(size=(70, N_X)).astype(np.float32)
    alone = np.stack([act(state) for state in states])
    for size in (1, 2, 3, 5, 7, 8, 9, 16, 31, 64, 70):
        for start in range(0, 70 - size + 1, 11):
            np.testing.assert_array_equal(
                act(states[start : start + size]), alone[start : start + size]
            )
    order = rng.permutation(70)
    np.testing.assert_array_equal(act(states[order]), alone[order])
    assert np.abs(alone).max() <= 1
    assert len({row.tobytes() for row in alone}) == 70


def test_a_block_size_is_only_used_where_places_do_not_matter(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shapes = ((5, 8), (8, 3))
    assert _safe_block(shapes, False, False) in (1, 4, 8)

    def ordered_by_place(rows: np.ndarray, *_: object) -> np.ndarray:
        return rows.sum(axis=1, keepdims=True) + np.arange(len(rows))[:, None] * 1e-7

    monkeypatch.setattr("coordlog.policies.learned._forward", ordered_by_place)
    _safe_block.cache_clear()
    assert _safe_block(shapes, False, False) == 1
    _safe_block.cache_clear()


def test_no_states_give_no_actions_and_one_gives_one(rng: np.random.Generator) -> None:
    act = policy(rng)
    assert act(np.zeros((0, N_X), np.float32)).shape == (0, N_U)
    assert act(np.zeros(N_X, np.float32)).shape == (N_U,)
    assert act(np.zeros((3, N_X))).dtype == np.float32
    with pytest.raises(SpecError, match=r"expected 31 entries per row, got shape \(3, 30\)"):
        act(np.zeros((3, 30), np.float32))


def test_a_policy_file_carries_what_it_says_and_acts_alike(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    act = policy(rng, norm="layer")
    path = tmp_path / "best.safetensors"
    act.save(path)
    found = Policy.load(path)
    assert found.about == act.about
    assert (found.n_x, found.n_u) == (N_X, N_U)
    states = rng.normal(size=(9, N_X)).astype(np.float32)
    np.testing.assert_array_equal(found(states), act(states))
    np.testing.assert_array_equal(found.act(np.arange(9), states), act(states))


def test_a_broken_policy_is_refused(tmp_path: Path, rng: np.random.Generator) -> None:
    act = policy(rng)
    with pytest.raises(FormatError, match="finite weights"):
        Policy({**act.arrays, "bias.0": np.full(256, np.nan, np.float32)}, act.about)
    with pytest.raises(FormatError, match="finite weights"):
        Policy({}, act.about)
    with pytest.raises(FormatError, match=r"policy: bias\.1 is missing"):
        Policy(
            {name: array for name, array in act.arrays.items() if name != "bias.1"}
            | {"other": np.zeros(1)},
            act.about,
        )
    save_arrays(tmp_path / "file", act.arrays, kind="checkpoint", meta={})
    with pytest.raises(FormatError, match="expected a coordlog policy file"):
        Policy.load(tmp_path / "file")
    with pytest.raises(StorageError, match="cannot be read"):
        Policy.load(tmp_path / "none")


def test_exploration_adds_normal_noise_of_its_deviation_and_clips() -> None:
    noise = Noise(50, 4, correlation=0.0, seed=[0])
    explore = Exploring(lambda state: np.full((50, 4), 0.1, np.float32), noise, deviation=0.2)
    actions = np.stack([explore(np.zeros((50, 3))) for _ in range(200)])
    assert actions.dtype == np.float32
    assert actions.mean() == pytest.approx(0.1, abs=0.01)
    assert actions.std() == pytest.approx(0.2, abs=0.01)
    wild = Exploring(lambda state: np.zeros((50, 4), np.float32), noise, deviation=9.0)(
        np.zeros((50, 3))
    )
    assert np.abs(wild).max() == 1


@pytest.mark.parametrize("correlation", [0.0, 0.8])
def test_noise_keeps_its_deviation_whatever_its_memory_and_continues_exactly(
    correlation: float,
) -> None:
    noise = Noise(40, 5, correlation=correlation, seed=[1])
    drawn = np.stack([noise.draw() for _ in range(400)])
    assert drawn.std() == pytest.approx(1, abs=0.02)
    assert np.mean(drawn[1:] * drawn[:-1]) == pytest.approx(correlation, abs=0.03)
    generator, arrays = noise.state()
    other = Noise(40, 5, correlation=correlation, seed=[2])
    other.load_state(generator, {name: array.copy() for name, array in arrays.items()})
    for _ in range(3):
        np.testing.assert_array_equal(noise.draw(), other.draw())
