"""Whole runs on the toy: learning, the pipeline, resuming, stopping, diverging."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from coordlog.errors import ConfigError, SpecError, StorageError
from coordlog.policies.checkpoint import load_arrays
from coordlog.policies.learned import Policy
from coordlog.train.columns import Block, Columns
from coordlog.train.exploration import Exploring
from coordlog.train.loop import KIND, Trainer
from coordlog.train.metrics import TIMING, read_metrics
from coordlog.train.settings import Settings, load_settings
from coordlog.train.task import Hooks, Outcome
from tests.train import toy_arms as toy

SMALL = (
    "network.hidden=[24,24]",
    "replay.batch=32",
    "replay.warmup=64",
    "replay.capacity=200",
    "replay.hindsight=0.25",
)
SHORT = (
    *SMALL,
    "loop.metrics_every=10",
    "loop.evaluate_every=20",
    "loop.checkpoint_every=15",
    "loop.block=4",
    "noise.correlation=0.5",
)
LOGS = (*SHORT, "loop.updates=50")
LIVE = (*SHORT, "loop.updates=0", "loop.steps=256", "loop.updates_per_step=0.3")
BOTH = (*LIVE, "loop.pretrain=15")


def settings(*assignments: str, preset: str = "default") -> Settings:
    return load_settings(preset=preset, assignments=assignments)


def evaluate(policy: Policy, updates: int) -> dict[str, float]:
    return {"clean": toy.success(policy, lanes=16), "score": float(policy(np.ones(toy.N_X)).sum())}


def trainer(
    folder: Path,
    wanted: Settings,
    *,
    logs: bool = False,
    live: bool = False,
    hooks: Hooks | None = None,
) -> Trainer:
    source = toy.ToySource(8, seed=4) if live else None
    return Trainer(
        toy.task(),
        wanted,
        folder=folder,
        logs=toy.logs(6) if logs else None,
        source=source,
        hooks=replace(hooks or Hooks(evaluate=evaluate), about={"run": "toy"}),
    )


def metrics(folder: Path) -> list[dict[str, object]]:
    return [
        {name: value for name, value in row.items() if name not in TIMING}
        for row in read_metrics(folder / "metrics.jsonl")
    ]


def weights(folder: Path) -> dict[str, bytes]:
    arrays = load_arrays(folder / "checkpoint.safetensors", kind=KIND).arrays
    return {name: array.tobytes() for name, array in arrays.items()}


def stop_after(rows: int) -> Callable[[], bool]:
    asked = iter(range(10**6))
    return lambda: next(asked) >= rows


KINDS = {
    "logs": ((*LOGS, "behaviour.extra=2"), True, False),
    "live": (LIVE, False, True),
    "both": (BOTH, True, True),
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], tuple[Path, Outcome]]:
    """The run of a kind that nothing stopped, made once: its folder, and how it ended."""

    @functools.cache
    def made(kind: str) -> tuple[Path, Outcome]:
        assignments, logs, live = KINDS[kind]
        folder = tmp_path_factory.mktemp(kind)
        return folder, trainer(folder, settings(*assignments), logs=logs, live=live).run()

    return made


def the_same(found: Path, wanted: Path) -> None:
    assert metrics(found) == metrics(wanted)
    assert weights(found) == weights(wanted)


@pytest.mark.parametrize("kind", KINDS)
def test_a_run_that_is_stopped_again_and_again_continues_as_if_it_had_not_been(
    kind: str, whole: Callable[[str], tuple[Path, Outcome]], tmp_path: Path
) -> None:
    assignments, logs, live = KINDS[kind]
    wanted, (folder, through) = settings(*assignments), whole(kind)
    assert through.ending == "finished"
    for rounds in (1, 2, 1):
        stopping = Hooks(evaluate=evaluate, should_stop=stop_after(rounds))
        begun = (tmp_path / "checkpoint.safetensors").exists()
        stopped = trainer(tmp_path, wanted, logs=logs, live=live, hooks=stopping).run(resume=begun)
        assert stopped.ending == "stopped"
        assert stopped.updates + stopped.steps < through.updates + through.steps
    resumed = trainer(tmp_path, wanted, logs=logs, live=live).run(resume=True)
    assert resumed == through
    the_same(tmp_path, folder)
    best = [Policy.load(each / "best.safetensors").arrays for each in (tmp_path, folder)]
    assert all(np.array_equal(best[0][name], best[1][name]) for name in best[1])


@pytest.mark.parametrize("kind", KINDS)
def test_a_finished_run_has_nothing_left_to_do(kind: str, tmp_path: Path) -> None:
    assignments, logs, live = KINDS[kind]
    wanted = settings(*assignments, "loop.evaluate_every=9")
    first = trainer(tmp_path, wanted, logs=logs, live=live).run()
    rows, saved = metrics(tmp_path), weights(tmp_path)
    assert trainer(tmp_path, wanted, logs=logs, live=live).run(resume=True) == first
    assert (metrics(tmp_path), weights(tmp_path)) == (rows, saved)
    evaluated = [row["update"] for row in rows if row["kind"] == "evaluation"]
    assert evaluated == sorted(set(evaluated)), "the last one once, whether or not it was due"


class KilledError(Exception):
    """Stands for kill -9: nothing is cleaned up."""


@pytest.mark.parametrize("kind", KINDS)
def test_a_killed_run_continues_from_its_last_checkpoint(
    kind: str, whole: Callable[[str], tuple[Path, Outcome]], tmp_path: Path
) -> None:
    assignments, logs, live = KINDS[kind]
    wanted = settings(*assignments)

    def kill(row: dict[str, object]) -> None:
        if int(str(row["update"])) >= 38:
            raise KilledError

    killed = Hooks(evaluate=evaluate, on_row=kill)
    with pytest.raises(KilledError):
        trainer(tmp_path, wanted, logs=logs, live=live, hooks=killed).run()
    trainer(tmp_path, wanted, logs=logs, live=live).run(resume=True)
    the_same(tmp_path, whole(kind)[0])


@pytest.mark.parametrize("kind", ["live", "both"])
def test_simulating_beside_the_updates_changes_nothing(
    kind: str, whole: Callable[[str], tuple[Path, Outcome]], tmp_path: Path
) -> None:
    assignments, logs, live = KINDS[kind]
    assert settings(*assignments).loop.overlap
    wanted = settings(*assignments, "loop.overlap=false")
    trainer(tmp_path, wanted, logs=logs, live=live).run()
    the_same(tmp_path, whole(kind)[0])


@pytest.mark.parametrize("overlap", ["true", "false"])
def test_a_block_is_collected_by_the_actor_before_the_updates_beside_it(
    overlap: str, tmp_path: Path
) -> None:
    ages = []

    class Watched(toy.ToySource):
        def collect(self, steps: int, policy: Exploring) -> Block:  # type: ignore[override]
            ages.append(policy.policy.about["updates"])  # type: ignore[attr-defined]
            return super().collect(steps, policy)

    Trainer(
        toy.task(), settings(*LIVE, f"loop.overlap={overlap}"), folder=tmp_path, source=Watched(8)
    ).run()
    steps = np.arange(0, 256, 32)
    assert ages == [int(0.3 * max(0, before - 64)) for before in steps - 32]


def test_another_seed_is_another_run(
    whole: Callable[[str], tuple[Path, Outcome]], tmp_path: Path
) -> None:
    assert settings(*LIVE).loop.seed == 0
    trainer(tmp_path, settings(*LIVE, "loop.seed=1"), live=True).run()
    assert metrics(tmp_path) != metrics(whole("live")[0])


def test_live_steps_earn_updates_and_budgets_are_kept(
    whole: Callable[[str], tuple[Path, Outcome]], tmp_path: Path
) -> None:
    outcome = whole("live")[1]
    assert (outcome.steps, outcome.updates) == (256, int(0.3 * (256 - 64)))
    outcome = trainer(tmp_path, settings(*LIVE, "loop.updates=25"), live=True).run()
    assert outcome.updates == 25
    assert outcome.steps < 256
    folder, outcome = whole("both")
    assert outcome.updates == 15 + int(0.3 * (256 - 64))
    rows = metrics(folder)
    assert rows[0]["step"] == 0
    assert {row["kind"] for row in rows} == {"training", "evaluation"}
    assert sum(float(str(row["episodes"])) for row in rows if row["kind"] == "training") >= 8


def test_the_papers_loop_makes_one_update_per_step(tmp_path: Path) -> None:
    wanted = settings(
        "network.hidden=[12,8]",
        "replay.capacity=200",
        "loop.steps=120",
        "loop.evaluate_every=0",
        preset="paper",
    )
    made = Trainer(toy.task(), wanted, folder=tmp_path, source=toy.ToySource(1))
    outcome = made.run()
    assert (outcome.steps, outcome.updates) == (120, 120 - 64)
    assert outcome.best is None


def test_a_policy_learns_from_logs_alone(tmp_path: Path) -> None:
    wanted = settings(
        "network.hidden=[64,64]",
        "replay.batch=64",
        "replay.warmup=64",
        "learner.tau=0.02",
        "loop.updates=400",
        "loop.evaluate_every=200",
    )
    outcome = Trainer(
        toy.task(), wanted, folder=tmp_path, logs=toy.logs(60), hooks=Hooks(evaluate=evaluate)
    ).run()
    assert outcome.best is not None
    assert outcome.best["clean"] >= 0.9
    best = Policy.load(tmp_path / "best.safetensors")
    assert toy.success(best, lanes=16) == outcome.best["clean"]
    assert best.about["settings"] == wanted.asdict()
    assert best.about["updates"] <= outcome.updates


def test_the_first_of_the_best_policies_is_kept_not_the_last(tmp_path: Path) -> None:
    figures = iter([(0.1, 5.0), (0.9, 1.0), (0.9, 1.0), (0.9, 0.5), (0.2, 9.0)])
    seen = []

    def judge(policy: Policy, updates: int) -> dict[str, float]:
        seen.append(policy.arrays["bias.0"])
        return dict(zip(("clean", "score"), next(figures), strict=True))

    wanted = settings(*SHORT, "loop.updates=50", "loop.evaluate_every=10")
    outcome = trainer(tmp_path, wanted, logs=True, hooks=Hooks(evaluate=judge)).run()
    assert outcome.best == {"clean": 0.9, "score": 1.0}
    np.testing.assert_array_equal(
        Policy.load(tmp_path / "best.safetensors").arrays["bias.0"], seen[1]
    )
    np.testing.assert_array_equal(
        Policy.load(tmp_path / "policy.safetensors").arrays["bias.0"], seen[4]
    )


@pytest.mark.parametrize(("average", "network"), [(0.2, "average_actor"), (0, "actor")])
def test_the_actor_or_its_average_is_kept(average: float, network: str, tmp_path: Path) -> None:
    made = trainer(tmp_path, settings(*LOGS, f"loop.average={average}"), logs=True)
    made.run()
    wanted = getattr(made.learner, network).arrays()
    found = Policy.load(tmp_path / "policy.safetensors").arrays
    assert all(np.array_equal(found[name], array) for name, array in wanted.items())
    alike = np.array_equal(found["weight.0"], made.learner.actor.arrays()["weight.0"])
    assert alike == (average == 0)


def poisoned() -> Columns:
    columns = toy.logs(6)
    distance = columns.steps["distance"].copy()
    distance[5] = np.nan
    return replace(columns, steps={**columns.steps, "distance": distance})


def test_a_divergence_is_named_saved_and_stopped(tmp_path: Path) -> None:
    made = Trainer(
        toy.task(),
        settings(*LOGS, "loop.metrics_every=45"),
        folder=tmp_path,
        logs=poisoned(),
        hooks=Hooks(evaluate=evaluate),
    )
    outcome = made.run()
    assert outcome.ending == "diverged"
    assert outcome.event is not None
    assert outcome.event.name == "not_finite"
    assert outcome.updates < 45, "it is noticed before the row that was due"
    last = metrics(tmp_path)[-1]
    assert (last["kind"], last["name"]) == ("event", "not_finite")
    assert (tmp_path / "diverged.safetensors").exists()
    assert not (tmp_path / "policy.safetensors").exists()


def test_a_run_is_never_overwritten_nor_resumed_from_nothing_nor_changed(tmp_path: Path) -> None:
    trainer(tmp_path, settings(*LOGS), logs=True).run()
    with pytest.raises(
        StorageError, match="already holds a run; resume it or choose another folder"
    ):
        trainer(tmp_path, settings(*LOGS), logs=True).run()
    with pytest.raises(StorageError, match="cannot be read"):
        trainer(tmp_path / "none", settings(*LOGS), logs=True).run(resume=True)
    with pytest.raises(ConfigError, match=r"resume: learner\.gamma was 0\.98 and is now 0\.5"):
        trainer(tmp_path, settings(*LOGS, "learner.gamma=0.5"), logs=True).run(resume=True)
    fewer = Trainer(toy.task(), settings(*LOGS), folder=tmp_path, logs=toy.logs(3))
    with pytest.raises(
        ConfigError, match=r"resume: expected the \d+ log transitions of before, got \d+"
    ):
        fewer.run(resume=True)
    assert (
        trainer(tmp_path, settings(*LOGS, "loop.updates=60"), logs=True).run(resume=True).updates
        == 60
    )


def test_what_does_not_fit_together_is_said_before_anything_is_written(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with pytest.raises(ConfigError, match="got neither"):
        Trainer(toy.task(), settings(*LOGS), folder=folder)
    with pytest.raises(ConfigError, match=r"loop\.steps: expected a budget of live steps"):
        trainer(folder, settings(*LOGS), live=True)
    with pytest.raises(ConfigError, match=r"loop\.updates: expected a budget of updates"):
        trainer(folder, settings(*LIVE), logs=True)
    with pytest.raises(ConfigError, match=r"loop\.pretrain: expected logs for 15 updates"):
        trainer(folder, settings(*BOTH), live=True)
    with pytest.raises(
        SpecError, match=r"expected widths \(n_x, n_u, k\) = \(19, 9, 2\), got \(18, 9, 2\)"
    ):
        Trainer(replace(toy.task(), n_x=19), settings(*LOGS), folder=folder, logs=toy.logs(3))
    with pytest.raises(ConfigError, match=r"device: expected cpu, .* got 'tpu0'"):
        Trainer(toy.task(), settings(*LOGS), folder=folder, logs=toy.logs(3), device="tpu0")
    assert not folder.exists()


def test_an_error_in_the_simulation_comes_through(tmp_path: Path) -> None:
    class Broken(toy.ToySource):
        def collect(self, steps: int, policy: object) -> object:  # type: ignore[override]
            raise KilledError

    with pytest.raises(KilledError):
        Trainer(toy.task(), settings(*LIVE), folder=tmp_path, source=Broken(8)).run()


def test_an_outcome_says_how_a_run_ended(tmp_path: Path) -> None:
    rows: list[dict[str, object]] = []
    outcome = trainer(
        tmp_path, settings(*LOGS), logs=True, hooks=Hooks(evaluate=evaluate, on_row=rows.append)
    ).run()
    assert outcome == Outcome("finished", 50, 0, outcome.best, None)
    assert [row["update"] for row in rows if row["kind"] == "training"] == [10, 20, 30, 40, 50]
    assert [row["update"] for row in rows if row["kind"] == "evaluation"] == [20, 40, 50]
    first = rows[0]
    wanted = {
        "kind",
        "update",
        "step",
        "bound_low",
        "bound_high",
        "critic_loss",
        "q_left",
        "value_right",
        "q_low",
        "q_high",
        "behaviour",
        "saturation",
    }
    assert wanted | {"behaviour_weight", *TIMING} <= set(first)
