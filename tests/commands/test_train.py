"""Tests for `coordlog train`, as a person runs it, on the planar arm."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest
import torch

from coordlog.api.judging import Judge, evaluation_envs
from coordlog.api.train_plan import TrainPlan, constants, preset_of
from coordlog.cli import app
from coordlog.errors import ConfigError, CoordlogError
from coordlog.policies.learned import Policy
from coordlog.record.dataset import open as open_logs
from coordlog.tasks.config import TRAINING_ONLY
from coordlog.train.config import NetworkConfig
from coordlog.train.metrics import TIMING
from coordlog.train.networks import Actor
from coordlog.train.run import require_same
from tests.spoken import Said, sound

FIXTURES = Path(__file__).parents[1] / "data" / "v1"
SMALL = [
    "--set",
    "network.hidden=[32,32]",
    "--set",
    "replay.batch=32",
    "--eval-episodes",
    "4",
    "--envs",
    "4",
]


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


def coordlog(cache: Path, *args: str | Path, wanted: int = 0) -> Said:
    return sound(*args, code=wanted, cache=cache)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory, cache: Path) -> Path:
    folder = tmp_path_factory.mktemp("logs")
    coordlog(
        cache, "record", "--scene", "planar", "--episodes", "12", "--noise", "0.2", "--out", folder
    )
    return folder


def rows(folder: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]


def test_a_run_from_logs_explains_itself_and_its_policy_acts(
    cache: Path, logs: Path, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    dearer = ["--set", "reward.n1=2.5", "--set", "env.max_steps=140"]
    done = coordlog(
        cache,
        "train",
        "--from",
        logs,
        "--updates",
        "60",
        "--eval-every",
        "30",
        *SMALL,
        *dearer,
        "--out",
        run,
    )
    assert "finished after 60 updates" in done.stdout
    said = json.loads((run / "run.json").read_text())
    assert (said["scene"], said["mode"], said["log_episodes"]) == ("planar", "logs", 12)
    assert said["versions"]["torch"]
    assert (said["env"]["reward"]["n1"], said["env"]["config"]["max_steps"]) == (2.5, 140), (
        "--set reaches [reward] and [env], too"
    )
    assert len((run / "data.lock").read_text().splitlines()) == 12
    assert [row["update"] for row in rows(run) if row["kind"] == "evaluation"] == [30, 60]
    evaluations = open_logs(run / "episodes")
    assert len(evaluations) == 8
    assert {episode.header.episode["split"] for episode in evaluations} == {"test"}
    coordlog(cache, "check", run / "episodes", "--jobs", "1")
    done = coordlog(
        cache,
        "record",
        "--policy",
        run,
        "--split",
        "test",
        "--episodes",
        "2",
        "--out",
        tmp_path / "again",
        "--json",
    )
    assert json.loads(done.stdout)["episodes"] == 2
    header = open_logs(tmp_path / "again")[0].header
    assert header.episode["scene"] == "planar"
    assert len(header.policy["checkpoint_sha256"]) == 64


def test_a_stopped_run_goes_on_as_if_it_had_not_been(
    cache: Path, logs: Path, tmp_path: Path
) -> None:
    """Logs and live steps together, resumed with a larger budget.

    That one resumed with its own is the same bit for bit, test_loop asks.
    """
    both = [
        "train",
        "--from",
        logs,
        "--live",
        *SMALL,
        "--set",
        "replay.warmup=64",
        "--set",
        "loop.metrics_every=20",
        "--eval-every",
        "0",
    ]
    both += ["--set", "loop.updates_per_step=0.25", "--set", "loop.checkpoint_every=20"]
    coordlog(
        cache, *both, "--steps", "400", "--out", tmp_path / "whole"
    )  # without a word on updates: as many as the steps earn
    coordlog(cache, *both, "--updates", "0", "--steps", "208", "--out", tmp_path / "parts")
    coordlog(
        cache, *both, "--updates", "0", "--steps", "400", "--out", tmp_path / "parts", "--resume"
    )

    def comparable(folder: Path) -> dict[object, dict[str, object]]:
        progress = {"noise", "behaviour_weight"}
        return {
            row["update"]: {
                key: value for key, value in row.items() if key not in {*TIMING, *progress}
            }
            for row in rows(folder)
        }

    whole, parts = comparable(tmp_path / "whole"), comparable(tmp_path / "parts")
    assert max(whole) == max(parts) > 60
    assert whole[max(whole)].keys() == parts[max(parts)].keys()
    names = sorted(path.name.rsplit("-", 1)[0] for path in (tmp_path / "parts").rglob("*.mcap"))
    assert [int(name.rsplit("-", 1)[1]) for name in names] == list(range(len(names))), (
        "every episode, none twice"
    )
    coordlog(cache, "check", tmp_path / "parts" / "episodes", "--jobs", "1", wanted=0)


def test_a_cluster_reads_what_streams_and_nothing_else() -> None:
    assert TrainPlan(source=["logs"], memory="1GB", jobs="ray").readers == "ray"
    assert TrainPlan(source=["logs"], memory="1GB", collectors=2, jobs="ray").readers == 0
    with pytest.raises(ConfigError, match="--jobs ray: expected --collectors or --memory"):
        constants(TrainPlan(source=["logs"], jobs="ray"))


def test_logs_stream_beside_the_steps_of_two_collectors(
    cache: Path, logs: Path, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    given = ["--live", "--collectors", "2", *SMALL, "--set", "replay.warmup=64", "--steps", "416"]
    given += ["--eval-every", "0", "--where", "length > 1"]
    coordlog(cache, "train", "--from", logs, "--memory", "2MB", *given, "--out", run)
    said = json.loads((run / "run.json").read_text())
    assert said["collectors"] == 2
    lengths = [len(episode) for episode in open_logs(logs)]
    assert said["window"]["of"] == sum(lengths)
    assert said["window"]["episodes"] == said["log_episodes"] == len(lengths)
    assert said["window"]["memory"] == 2_000_000
    digests = [line.split()[0] for line in (run / "data.lock").read_text().splitlines()]
    assert digests == sorted(
        hashlib.sha256(p.read_bytes()).hexdigest() for p in logs.glob("*.mcap")
    )
    indices = [episode.header.episode["index"] for episode in open_logs(run / "episodes" / "train")]
    assert len(indices) == len(set(indices)) >= 4
    before = json.loads((run / "run.json").read_text())
    for key, other in (("window", None), ("collectors", 1)):
        with pytest.raises(ConfigError, match=f"its {key}"):
            require_same(before, before | {key: other}, folder=run)


def test_an_evaluation_taken_again_is_recorded_once(tmp_path: Path) -> None:
    actor = Actor(
        35, 8, config=NetworkConfig(hidden=(4,)), generator=torch.Generator().manual_seed(0)
    )
    policy = Policy(actor.arrays(), {"activation": "relu", "norm": "none"})
    envs = evaluation_envs("planar", {"env": {"max_steps": 3}}, None, start="stand", envs=2)
    found = []
    for name, chosen in (("one", policy), ("one", policy), ("other", policy)):
        judge = Judge(envs, tmp_path, run=name, episodes=2, elsewhere=2)
        found.append(judge(chosen, 40))
    assert found[0] == found[1] == found[2]
    episodes = open_logs(tmp_path / "episodes" / "eval-0000040")
    assert len(episodes) == 4, "two of each run, however often it was resumed"
    assert len({episode.header.episode["id"] for episode in episodes}) == 4


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (("--from", "nowhere"), "no such file or folder"),
        (("--from", Path(__file__).parent), "no episodes (.mcap) under"),
        (("--from", FIXTURES), "layouts"),
        (
            ("--from", FIXTURES / "table", "--from", FIXTURES / "shelf"),
            "logs of several scenes (shelf, table)",
        ),
        (
            ("--from", FIXTURES / "table", "--scene", "planar"),
            "scene 'planar': its robot is not that of the other logs",
        ),
        (
            ("--from", FIXTURES / "table", "--where", "cleen"),
            "--where: expected an SQL condition over",
        ),
        (("--from", FIXTURES / "table", "--where", "length > 9999"), "no episode of 3 satisfies"),
        (("--scene", "planar", "--preset", "default"), "--steps: expected a budget of live steps"),
        (("--scene", "planar", "--steps", "64", "--set", "learner.gama=1"), "learner.gama"),
        (
            ("--scene", "planar", "--steps", "64", "--set", "reward.n3=1"),
            "unknown RewardConfig key 'n3'",
        ),
        (("--scene", "planar", "--steps", "64", "--preset", "papr"), "unknown preset 'papr'"),
        (("--scene", "planar", "--steps", "64", "--resume"), "holds no run"),
        (("--scene", "planar", "--steps", "64", "--memory", "5MB"), "--memory: expected logs"),
        (("--from", FIXTURES / "table", "--memory", "plenty"), "expected a size such as 500MB"),
        (
            ("--scene", "planar", "--steps", "64", "--envs", "1", "--collectors", "2"),
            "--collectors: expected at most one for each live simulation, got 2 for 1",
        ),
    ],
)
def test_bad_input_is_refused_with_a_sentence(
    cache: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    args: tuple[str | Path, ...],
    said: str,
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    with pytest.raises(
        CoordlogError
    ) as refusal:  # in this process: starting one takes longer than refusing
        app(
            ["train", *map(str, args), "--out", str(tmp_path / "run"), "--jobs", "1"],
            standalone_mode=False,
        )
    assert said in str(refusal.value)
    assert refusal.value.exit_code == 2
    assert not (tmp_path / "run" / "run.json").exists(), (
        "the folder is still free for the corrected command"
    )


def test_a_run_is_not_overwritten_and_not_resumed_as_another(
    cache: Path, logs: Path, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    small = ["--from", logs, "--updates", "10", "--eval-every", "0", *SMALL, "--out", run]
    coordlog(cache, "train", *small)
    assert "holds a run already" in coordlog(cache, "train", *small, wanted=2).stderr
    assert (
        "its seed was 0 and is now 1"
        in coordlog(cache, "train", *small, "--seed", "1", "--resume", wanted=2).stderr
    )
    other = {"scene": "planar", "env": {"config": {"speed": 1.0, "tilt": 1.2}}}
    with pytest.raises(CoordlogError, match=r"its env\.config\.tilt was 1\.2 and is now 1\.5"):
        require_same(
            other, {"scene": "planar", "env": {"config": {"speed": 1.0, "tilt": 1.5}}}, folder=run
        )


def test_a_run_killed_before_its_first_checkpoint_begins_again(
    cache: Path,
    logs: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    run = tmp_path / "run"
    small = [
        "train",
        "--from",
        str(logs),
        "--updates",
        "10",
        "--eval-every",
        "10",
        *SMALL,
        "--out",
        str(run),
    ]
    app(small, standalone_mode=False)
    first = [{key: value for key, value in row.items() if key not in TIMING} for row in rows(run)]
    episodes = sorted(run.rglob("*.mcap"))
    for name in ("checkpoint", "policy", "best"):
        (run / f"{name}.safetensors").unlink()
    with pytest.raises(CoordlogError, match=r"behaviour\.weight was .* and is now 1\.0"):
        app([*small, "--resume", "--set", "behaviour.weight=1.0"], standalone_mode=False)
    app([*small, "--resume"], standalone_mode=False)
    assert "begins again" in capsys.readouterr().err
    assert [
        {key: value for key, value in row.items() if key not in TIMING} for row in rows(run)
    ] == first
    assert sorted(run.rglob("*.mcap")) == episodes
    assert (run / "checkpoint.safetensors").exists()


def test_a_broken_log_is_named_and_left_out_when_asked(
    cache: Path, logs: Path, tmp_path: Path
) -> None:
    for path in list(logs.glob("*.mcap"))[:2]:
        (tmp_path / path.name).write_bytes(path.read_bytes())
    (tmp_path / "cut.mcap").write_bytes(path.read_bytes()[:9000])
    small = ["--from", tmp_path, "--updates", "10", "--eval-every", "0", *SMALL]
    assert "cut.mcap" in coordlog(cache, "train", *small, "--out", tmp_path / "a", wanted=2).stderr
    assert (
        "cut.mcap"
        in coordlog(
            cache, "train", *small, "--skip-broken", "--out", tmp_path / "b", wanted=3
        ).stderr
    )


def test_live_steps_are_practised_and_evaluations_are_not(cache: Path, tmp_path: Path) -> None:
    """The preset `live`: slow decisions, starts elsewhere, both judged and trained."""
    run = tmp_path / "run"
    live = [
        "train",
        "--scene",
        "planar",
        "--preset",
        "live",
        "--steps",
        "64",
        "--eval-every",
        "5",
        *SMALL,
    ]
    live += ["--set", "replay.warmup=32", "--set", "env.max_steps=4", "--set", "train.inflate=0.01"]
    coordlog(cache, *live, "--out", run)
    said = json.loads((run / "run.json").read_text())
    assert (said["preset"], said["env"]["config"]["control_period"]) == ("live", 0.12)
    trained, evaluated = open_logs(run / "episodes" / "train"), open_logs(run / "episodes")
    practised = trained[0].header.env["config"]
    assert (practised["inflate"], practised["start_random"]) == (0.01, 0.3)
    assert all(episode.header.env["config"]["control_period"] == 0.12 for episode in evaluated)
    judged = [each for each in evaluated if each.header.episode["split"] == "test"]
    easier = {each.header.env["config"][name] for each in judged for name in TRAINING_ONLY}
    assert easier == {0.0}
    coordlog(cache, "check", run / "episodes", "--jobs", "1")
    coordlog(cache, *live, "--out", run, "--resume")


@pytest.mark.parametrize(
    ("scene", "live", "preset"),
    [
        ("", True, "live"),
        ("table", True, "live"),
        ("shelf", True, "live"),
        ("free", True, "default"),
        ("spheres", True, "agile"),
        ("planar", True, "default"),
        ("table", False, "default"),
    ],
)
def test_the_preset_follows_what_stands_in_the_way(scene: str, live: bool, preset: str) -> None:
    assert preset_of(TrainPlan(source=None if live else ["logs"], scene=scene)) == preset


def test_logs_of_another_period_are_named(cache: Path, logs: Path, tmp_path: Path) -> None:
    slow = tmp_path / "slow.toml"
    slow.write_text("[env]\ncontrol_period = 0.12\n")
    folder = tmp_path / "slow"
    coordlog(
        cache, "record", "--scene", "planar", "--episodes", "2", "--config", slow, "--out", folder
    )
    both = ["train", "--from", logs, "--from", folder, "--updates", "5", *SMALL]
    done = coordlog(cache, *both, "--out", tmp_path / "run", wanted=2)
    assert "its control period is" in done.stderr
    one = ["train", "--from", logs, "--set", "env.control_period=0.12", "--updates", "5", *SMALL]
    done = coordlog(cache, *one, "--out", tmp_path / "run", wanted=2)
    assert "its control period is 0.12 s, that of the other logs 0.04 s" in done.stderr
