"""What an update and a batch cost, as ratios measured in one run.

    python -m experiments.speed.bench_train [--rows 1500000] [--json FILE]

Updates are compared with stable-baselines3's TD3: twin critics of 256/256, the same widths and
batch, on a batch drawn beforehand, so that replay and simulation are in neither. Batches are
compared with `index_select` on tensors that are already in memory. All on one thread.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import chain
from pathlib import Path

import gymnasium
import numpy as np
import torch
from stable_baselines3 import TD3
from stable_baselines3.common.logger import configure

from coordlog.episode import Array
from coordlog.tasks.config import RewardConfig
from coordlog.tasks.reach.reward import Flags, rewards
from coordlog.train.columns import Columns
from coordlog.train.digrad import Batch, Learner
from coordlog.train.gradients import gradient_mask
from coordlog.train.replay import Arrays, Horizon, transitions
from coordlog.train.settings import PRESETS, Settings
from coordlog.train.transitions import Transitions
from experiments.speed.clock import Row, medians, options, show, turns

N_X, N_U, EPISODE = 39, 13, 150
ARMS = {"left": list(range(9)), "right": [0, 1, 2, 3, 4, 9, 10, 11, 12]}
ROUNDS = 9


def main() -> None:
    """Measure both."""
    given = options(__doc__, rows=1_500_000)
    torch.set_num_threads(1)
    show(chain(updates(256), updates(128), batches(given.rows)), given.json)


def updates(size: int) -> Iterator[Row]:
    """Updates of ours, in milliseconds and against the peer's."""
    default = PRESETS["default"]
    delayed = replace(default, learner=replace(default.learner, actor_delay=2))  # as TD3
    plain = replace(delayed, network=replace(default.network, critic_norm="none"))
    surgery = replace(plain, learner=replace(plain.learner, gradient="pcgrad"))
    variants: dict[str, Callable[[], object]] = {
        "TD3 of stable-baselines3": td3(size),
        "1 task, same networks": digrad(plain, size, tasks=1),
        "2 tasks, same networks": digrad(plain, size),
        "2 tasks, same networks, pcgrad": digrad(surgery, size),
        "2 tasks, default (LayerNorm, no delay)": digrad(default, size),
    }
    seconds = medians(turns(variants, rounds=ROUNDS, repeat=20))
    peer, *ours = variants
    for name, taken in seconds.items():
        yield Row(f"update, {name}, batch {size}", taken * 1e3, "ms")
    for name in ours:
        target = "≤ 0.9" if name.endswith("same networks") else ""
        yield Row(
            f"update, {name}, batch {size}: time against TD3",
            seconds[name] / seconds[peer],
            target=target,
        )


def digrad(settings: Settings, size: int, *, tasks: int = 2) -> Callable[[], object]:
    """An update of ours."""
    arms = ARMS if tasks == 2 else {"both": list(range(N_U))}
    learner = Learner(
        N_X,
        gradient_mask(arms, N_U),
        settings,
        bounds=(-60.0, 30.0),
    )
    generator = torch.Generator().manual_seed(0)

    def numbers(width: int) -> torch.Tensor:
        return torch.randn(size, width, generator=generator)

    ones = torch.ones(size, 1)
    action = numbers(N_U).clamp(-1, 1)
    batch = Batch(numbers(N_X), action, numbers(tasks), numbers(N_X), 0.98 * ones, ones, action)
    return lambda: learner.update(batch, behaviour_weight=1.0)


class Nothing(gymnasium.Env[Array, Array]):
    """An environment of the right widths that is never stepped."""

    observation_space = gymnasium.spaces.Box(-1, 1, (N_X,))
    action_space = gymnasium.spaces.Box(-1, 1, (N_U,))


def td3(size: int) -> Callable[[], object]:
    """An update of the peer's."""
    model = TD3(
        "MlpPolicy",
        Nothing(),
        policy_kwargs={"net_arch": [256, 256]},
        batch_size=size,
        buffer_size=10_000,
        device="cpu",
        seed=0,
    )
    model.set_logger(configure(None, []))
    buffer, rng = model.replay_buffer, np.random.default_rng(0)
    assert buffer is not None
    for name in ("observations", "next_observations", "actions"):
        getattr(buffer, name)[:] = rng.uniform(-1, 1, getattr(buffer, name).shape)
    buffer.full = True
    drawn = buffer.sample(size)
    buffer.sample = lambda *_, **__: drawn  # type: ignore[method-assign]
    return lambda: model.train(1, size)


def batches(rows: int) -> Iterator[Row]:
    """Shuffled batches out of memory-mapped columns, against tensors in memory."""
    rows -= rows % EPISODE
    config = RewardConfig()

    def reward(
        distance: Array, boundary: Array, goal: Array, collision: Array, instability: Array
    ) -> Array:
        return rewards(distance, Flags(boundary, goal, collision, instability), config)

    with tempfile.TemporaryDirectory() as folder:
        columns = mapped(Path(folder), rows)
        store = Transitions.of_logs(columns, reward)
        shuffled = np.random.default_rng(0).permutation(rows)[: min(rows // 256, 2000) * 256]
        tensors = in_memory(columns)
        variants = {
            f"memory-mapped columns of {rows:,} steps": lambda: epoch(store, shuffled),
            "tensors in memory": lambda: torch_epoch(tensors, shuffled),
        }
        ours, memory = seconds = list(medians(turns(variants, rounds=ROUNDS)).values())
        for name, taken in zip(variants, seconds, strict=True):
            yield Row(f"batch of 256 from {name}", taken / (len(shuffled) // 256) * 1e6, "µs")
        yield Row("batches: speed against tensors in memory", memory / ours, target="≥ 1.0")


def mapped(folder: Path, rows: int) -> Columns:
    """Random columns in files."""
    rng = np.random.default_rng(0)

    def column(name: str, width: int) -> Array:
        array = np.memmap(folder / name, np.float32, "w+", shape=(rows, width))
        for start in range(0, rows, 100_000):
            part = array[start : start + 100_000]
            part[:] = rng.random(part.shape, dtype=np.float32)
        array.flush()
        return np.memmap(folder / name, np.float32, "r", shape=(rows, width))

    nothing = np.zeros(rows, bool)
    flags = np.zeros((rows, 2), bool)
    episodes = rows // EPISODE
    steps = {
        "state": column("state", N_X),
        "action": column("action", N_U),
        "distance": column("distance", 2),
        **dict.fromkeys(("boundary", "goal"), flags),
        **dict.fromkeys(("collision", "instability", "terminated"), nothing),
    }
    return Columns(
        steps,
        final=rng.random((episodes, N_X), dtype=np.float32),
        length=np.full(episodes, EPISODE),
    )


def in_memory(columns: Columns) -> list[torch.Tensor]:
    """What a training loop without logs would hold: states, actions, rewards, next states, ends."""
    state, action = (
        torch.tensor(np.asarray(columns.steps["state"])),
        torch.tensor(np.asarray(columns.steps["action"])),
    )
    return [
        state,
        action,
        torch.tensor(np.asarray(columns.steps["distance"])),
        state.roll(-1, 0),
        torch.zeros(len(state), 1),
    ]


def epoch(store: Transitions, shuffled: Array) -> None:
    """All batches of ours."""
    for start in range(0, len(shuffled), 256):
        out = Arrays.empty(256, (N_X, N_U, 2))
        transitions(store, shuffled[start : start + 256], out, Horizon(1, 0.98))
        for array in out:
            torch.from_numpy(array)


def torch_epoch(tensors: list[torch.Tensor], shuffled: Array) -> None:
    """All batches of tensors."""
    order = torch.from_numpy(shuffled)
    for start in range(0, len(order), 256):
        rows = order[start : start + 256]
        for tensor in tensors:
            tensor.index_select(0, rows)


if __name__ == "__main__":
    main()
