"""What an update, a batch and a decision cost, as ratios measured in one run.

    python experiments/speed/bench_train.py [--threads N] [--rows 1500000] [--json FILE]

Updates are compared with stable-baselines3's TD3: twin critics of 256/256, the same widths and
batch, on a batch drawn beforehand, so that replay and simulation are in neither. Batches are
compared with `index_select` on tensors that are already in memory. The variants of one measurement
take turns, and the median turn counts.
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import torch
from stable_baselines3 import TD3
from stable_baselines3.common.logger import configure

from coordlog.episode import Array
from coordlog.policies.learned import Policy
from coordlog.tasks.config import RewardConfig
from coordlog.tasks.reach.reward import Flags, rewards
from coordlog.train.columns import Columns
from coordlog.train.digrad import Batch, Learner
from coordlog.train.gradients import gradient_mask
from coordlog.train.networks import Actor
from coordlog.train.replay import Arrays, Horizon, MixedReplay, transitions
from coordlog.train.settings import PRESETS, Settings
from coordlog.train.task import Task
from coordlog.train.transitions import Transitions

N_X, N_U, EPISODE = 39, 13, 150
ARMS = {"left": list(range(9)), "right": [0, 1, 2, 3, 4, 9, 10, 11, 12]}
ROUNDS = 9

Row = dict[str, float | str]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--rows", type=int, default=1_500_000)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    found: list[Row] = []
    for row in (*updates(256), *updates(128), *decisions(), *batches(options.rows)):
        print(f"{row['what']:72} {row['value']:9.3f} {row['unit']:5} {row['target']}", flush=True)
        found.append(row)
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))


def taking_turns(variants: dict[str, Callable[[], object]], *, repeat: int) -> dict[str, float]:
    """Seconds of one call of each variant, the median of turns of `repeat` calls."""
    seconds: dict[str, list[float]] = {name: [] for name in variants}
    for turn in range(ROUNDS + 1):
        for name, call in variants.items():
            began = time.perf_counter()
            for _ in range(repeat):
                call()
            if turn > 0:
                seconds[name].append((time.perf_counter() - began) / repeat)
    return {name: statistics.median(values) for name, values in seconds.items()}


def row(what: str, value: float, unit: str, target: str = "") -> Row:
    return {"what": what, "value": value, "unit": unit, "target": target}


# updates


def updates(size: int) -> Iterator[Row]:
    default = PRESETS["default"]
    delayed = replace(default, learner=replace(default.learner, actor_delay=2))  # as TD3
    plain = replace(delayed, network=replace(default.network, critic_norm="none"))
    variants: dict[str, Callable[[], object]] = {
        "TD3": td3(size),
        "1 task, same networks": digrad(plain, size, tasks=1),
        "2 tasks, same networks": digrad(plain, size),
        "2 tasks, same networks, pcgrad": digrad(
            replace(plain, learner=replace(plain.learner, gradient="pcgrad")), size
        ),
        "2 tasks, with LayerNorm": digrad(delayed, size),
        "2 tasks, default (LayerNorm, no delay)": digrad(default, size),
    }
    if size == 256:
        variants["paper, batch 64"] = digrad(PRESETS["paper"], 64)
    seconds = taking_turns(variants, repeat=20)
    yield row(f"stable-baselines3 TD3 update, batch {size}", seconds["TD3"] * 1e3, "ms")
    for name, value in seconds.items():
        if name != "TD3":
            batch = "" if "batch" in name else f", batch {size}"
            yield row(f"update, {name}{batch}", value * 1e3, "ms")
            if not batch:
                continue
            yield row(
                f"update, {name}{batch}: time against TD3",
                value / seconds["TD3"],
                "x",
                "≤ 1.25" if "same networks" in name else "",
            )


def digrad(settings: Settings, size: int, *, tasks: int = 2) -> Callable[[], object]:
    arms = ARMS if tasks == 2 else {"both": list(range(N_U))}
    learner = Learner(
        N_X,
        gradient_mask(arms, N_U),
        network=settings.network,
        config=settings.learner,
        bounds=(-60.0, 30.0),
        seed=0,
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


# decisions


def decisions() -> Iterator[Row]:
    state = np.random.default_rng(0).normal(size=(32, N_X)).astype(np.float32)
    for name, settings in PRESETS.items():
        network = settings.network
        actor = Actor(N_X, N_U, config=network, generator=torch.Generator().manual_seed(0))
        policy = Policy(
            actor.arrays(), {"activation": network.activation, "norm": network.actor_norm}
        )
        seconds = taking_turns(
            {"one": lambda p=policy: p(state[0]), "many": lambda p=policy: p(state)}, repeat=200
        )
        yield row(
            f"one decision, {name} network",
            seconds["one"] * 1e3,
            "ms",
            "≤ 2.0, 1/20 of the control period",
        )
        yield row(f"32 decisions at once, {name} network", seconds["many"] * 1e3, "ms")


# batches


def batches(rows: int) -> Iterator[Row]:
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
        resident = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        seconds = taking_turns(
            {
                "ours": lambda: epoch(store, shuffled),
                "memory": lambda: torch_epoch(tensors, shuffled),
            },
            repeat=1,
        )
        count = len(shuffled) / 256
        yield row(
            f"batch of 256 from memory-mapped columns of {rows:,} steps",
            seconds["ours"] / count * 1e6,
            "us",
        )
        yield row("batch of 256 from tensors in memory", seconds["memory"] / count * 1e6, "us")
        yield row(
            "shuffled batches: speed against tensors in memory",
            seconds["memory"] / seconds["ours"],
            "x",
            "≥ 0.9",
        )
        replay, rng = (
            MixedReplay(
                replace(PRESETS["default"].replay, hindsight=0.0),
                Task(N_X, N_U, ARMS, reward, farthest=0.8),
                gamma=0.98,
                logs=store,
            ),
            np.random.default_rng(0),
        )
        drawn = taking_turns({"sample": lambda: replay.sample(rng)}, repeat=500)
        yield row(
            "a drawn batch of 256 as tensors, rewards and marks included",
            drawn["sample"] * 1e6,
            "us",
        )
        yield row(
            f"peak resident memory with {rows:,} steps, once mapped and once in memory",
            resident,
            "GB",
            "< 4",
        )


def mapped(folder: Path, rows: int) -> Columns:
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
    for start in range(0, len(shuffled), 256):
        out = Arrays.empty(256, (N_X, N_U, 2))
        transitions(store, shuffled[start : start + 256], out, Horizon(1, 0.98))
        for array in out:
            torch.from_numpy(array)


def torch_epoch(tensors: list[torch.Tensor], shuffled: Array) -> None:
    order = torch.from_numpy(shuffled)
    for start in range(0, len(order), 256):
        rows = order[start : start + 256]
        for tensor in tensors:
            tensor.index_select(0, rows)


if __name__ == "__main__":
    main()
