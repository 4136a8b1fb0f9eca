"""Tests for `coordlog smooth` as a person runs it: outputs that are episodes, resumed batches,
inputs that are left alone."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from coordlog.episode import Json
from coordlog.record.reader import read_attachments, read_episode, read_header
from coordlog.record.writer import write_episode
from coordlog.smooth import batch
from tests import spoken
from tests.spoken import Said, sound

COORDLOG = [sys.executable, "-m", "coordlog.cli"]


def run(*args: str | Path, wanted: int = 0) -> Said:
    return sound(*args, code=wanted)


def said(done: Said) -> str:
    return " ".join(done.stderr.split())


def digests(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*.mcap"))
    }


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("logs")
    run("record", "--scene", "table", "--episodes", "2", "--noise", "0.15", "--out", folder)
    run(
        "record",
        "--scene",
        "planar",
        "--episodes",
        "2",
        "--noise",
        "0.15",
        "--out",
        folder / "deeper" / "still",
    )
    return folder


@pytest.fixture(scope="module")
def smoothed(logs: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    out = tmp_path_factory.mktemp("smoothed") / "new"
    before = digests(logs)
    report = out.parent / "report.json"
    run("smooth", logs, "--out", out, "--report", report, "--jobs", "1")
    assert digests(logs) == before, "logs are never touched"
    return out, json.loads(report.read_text())


def test_every_input_gives_one_output_in_the_same_place(
    logs: Path, smoothed: tuple[Path, dict]
) -> None:
    out, report = smoothed
    assert list(digests(out)) == list(digests(logs))
    assert set(report["statuses"]) <= {"smoothed", "partly"}, (
        "partly: a log that comes closer than the clearance itself"
    )
    assert sum(report["statuses"].values()) == 4
    assert report["certified"] == 4
    assert report["median"]["jerk"] < 0.2
    assert not list(out.rglob("*.part"))


def test_outputs_replay_and_are_read_like_any_episode(smoothed: tuple[Path, dict]) -> None:
    out, _ = smoothed
    checked = json.loads(run("check", out, "--level", "replay", "--json", "--jobs", "1").stdout)
    assert (checked["files"], checked["findings"]) == (4, [])
    assert json.loads(run("info", out, "--json").stdout)["totals"]["success"] == 4


def test_an_output_says_where_it_comes_from_and_carries_its_path(
    logs: Path, smoothed: tuple[Path, dict]
) -> None:
    out, _ = smoothed
    source = next(logs.glob("table*.mcap"))
    raw, episode = read_episode(source), read_episode(out / source.name)
    lineage = episode.header.lineage
    assert lineage["parents"] == [hashlib.sha256(source.read_bytes()).hexdigest()]
    assert lineage["transform"] == "smooth"
    parameters = lineage["parameters"]
    assert parameters["settings"] == {
        "method": "local",
        "cutoff": "max",
        "max_deviation": None,
        "clearance": 0.005,
    }
    assert [joint["name"] for joint in parameters["joints"]] == raw.header.env["action_joints"]
    assert all(0 < joint["p"] < 1 for joint in parameters["joints"])
    assert parameters["after"]["jerk"] < parameters["before"]["jerk"]
    assert parameters["torque"]["after"]["rate"] < parameters["torque"]["before"]["rate"]
    before, after = (parameters["path_torque"][at] for at in ("before", "after"))
    assert after["floor"] < after["rate"] < before["rate"]
    assert after["floor"] == pytest.approx(before["floor"], rel=0.05)
    assert parameters["zero_moment_margin"]["after"] > 0.01
    assert parameters["clearance"]["after"] >= 0.005
    assert parameters["tracking_error"] < 0.02
    assert episode.header.policy["kind"] == "scripted, smoothed"
    assert episode.header.episode["id"] != raw.header.episode["id"]
    path = episode.path
    assert path is not None
    places = [
        raw.header.env["joints"][[joint["name"] for joint in raw.header.env["joints"]].index(name)][
            "qpos"
        ]
        for name in raw.header.env["action_joints"]
    ]
    assert (path.knot_position == raw.qpos[:, places]).all()
    assert (path.position[[0, -1]] == raw.qpos[[0, -1]][:, places]).all()
    assert (path.velocity[[0, -1]] == 0).all()


def test_a_second_run_makes_nothing_again(logs: Path, smoothed: tuple[Path, dict]) -> None:
    out, first = smoothed
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*.mcap")}
    again = json.loads(run("smooth", logs, "--out", out, "--json").stdout)
    assert again["resumed"] == 4
    assert again["statuses"] == first["statuses"]
    assert again["median"]["jerk"] == first["median"]["jerk"]
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*.mcap")} == before


def test_other_settings_do_not_replace_what_is_there_unless_forced(
    logs: Path, smoothed: tuple[Path, dict], tmp_path: Path
) -> None:
    source = next(logs.glob("table*.mcap"))
    run("smooth", source, "--out", tmp_path)
    before = digests(tmp_path)
    done = run("smooth", source, "--out", tmp_path, "--cutoff", "2", wanted=2)
    assert "--force" in said(done)
    assert digests(tmp_path) == before
    run("smooth", source, "--out", tmp_path, "--cutoff", "2", "--force")
    assert list(digests(tmp_path)) == list(before)
    assert read_header(tmp_path / source.name).lineage["parameters"]["settings"]["cutoff"] == 2
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / source.name).write_bytes(b"somebody's notes")
    done = run("smooth", source, "--out", foreign, "--force", wanted=2)
    assert "not made by coordlog smooth" in said(done)
    assert (foreign / source.name).read_bytes() == b"somebody's notes"


def test_equal_input_gives_equal_bytes(
    logs: Path, smoothed: tuple[Path, dict], tmp_path: Path
) -> None:
    source = next(logs.glob("table*.mcap"))
    run("smooth", source, "--out", tmp_path)
    assert (tmp_path / source.name).read_bytes() == (smoothed[0] / source.name).read_bytes()


def test_a_dry_run_writes_nothing(logs: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = run("smooth", next(logs.glob("table*.mcap")), "--out", out, "--dry-run")
    assert "nothing written" in done.stdout
    assert not out.exists()


def test_a_smoothed_episode_can_be_smoothed_again(
    smoothed: tuple[Path, dict], tmp_path: Path
) -> None:
    source = next(smoothed[0].glob("table*.mcap"))
    run("smooth", source, "--out", tmp_path)
    again = read_episode(tmp_path / source.name)
    assert again.header.lineage["parents"] == [hashlib.sha256(source.read_bytes()).hexdigest()]
    run("check", tmp_path, "--jobs", "1")


@pytest.mark.parametrize("method", ["shared", "paper"])
def test_other_methods_write_episodes_too(logs: Path, tmp_path: Path, method: str) -> None:
    done = json.loads(
        run("smooth", logs / "deeper", "--out", tmp_path, "--method", method, "--json").stdout
    )
    assert sum(done["statuses"].values()) == 2
    run("check", tmp_path, "--jobs", "1")


@pytest.mark.parametrize("out", [".", "inside", ".."])
def test_an_output_folder_among_the_inputs_is_refused(logs: Path, out: str) -> None:
    before = digests(logs)
    assert "never changed in place" in said(run("smooth", logs, "--out", logs / out, wanted=2))
    assert digests(logs) == before


def test_an_output_folder_that_holds_the_input_file_is_refused(logs: Path) -> None:
    source = next(logs.glob("table*.mcap"))
    assert "never changed in place" in said(run("smooth", source, "--out", source.parent, wanted=2))


def test_two_inputs_for_one_output_are_refused(logs: Path, tmp_path: Path) -> None:
    source = next(logs.glob("table*.mcap"))
    twin = tmp_path / source.name
    twin.write_bytes(source.read_bytes())
    assert "would both become" in said(
        run("smooth", source, twin, "--out", tmp_path / "out", wanted=2)
    )


def test_inputs_that_are_no_use_are_named_and_the_rest_is_done(logs: Path, tmp_path: Path) -> None:
    source = next(logs.glob("table*.mcap"))
    folder, out = tmp_path / "in", tmp_path / "out"
    folder.mkdir()
    (folder / "good.mcap").write_bytes(source.read_bytes())
    (folder / "empty.mcap").write_bytes(b"")
    (folder / "cut.mcap").write_bytes(source.read_bytes()[:5000])
    (folder / "live.mcap.part").write_bytes(source.read_bytes()[:5000])
    aborted = read_episode(source).with_result(aborted="interrupted")
    write_episode(
        folder / "aborted.mcap", aborted, attachments=read_attachments(source), display=False
    )
    bare = read_episode(source)
    write_episode(folder / "bare.mcap", bare, attachments={}, display=False)
    lost = bare.qpos.copy()
    lost[-1] = float("nan")
    write_episode(
        folder / "lost.mcap",
        replace(bare, qpos=lost),
        attachments=read_attachments(source),
        display=False,
    )
    done = run("smooth", folder, "--out", out, wanted=3)
    for name in (
        "empty.mcap",
        "cut.mcap",
        "aborted.mcap",
        "live.mcap.part",
        "bare.mcap",
        "lost.mcap",
    ):
        assert name in said(done), name
    assert "no model attached" in said(done)
    assert [path.name for path in out.glob("*.mcap")] == ["good.mcap"]


def test_a_log_that_cannot_be_made_smoother_keeps_its_steps_and_says_why(
    logs: Path, tmp_path: Path
) -> None:
    """Held to within a hundred-millionth of a radian, nothing smoother is left: the output is the
    log, with the reason."""
    source = next(logs.glob("table*.mcap"))
    done = run(
        "smooth",
        source,
        "--out",
        tmp_path,
        "--max-deviation",
        "1e-8",
        "--cutoff",
        "0.2",
        "--method",
        "shared",
        wanted=3,
    )
    assert "kept_raw" in said(done)
    raw, kept = read_episode(source), read_episode(tmp_path / source.name)
    assert (kept.action == raw.action).all()
    assert kept.result.digest == raw.result.digest
    assert kept.header.lineage["parameters"]["status"] == "kept_raw"
    assert kept.header.lineage["parameters"]["reason"]
    assert not kept.header.lineage["parameters"]["certified"]
    assert kept.path is None
    run("check", tmp_path, "--jobs", "1")


def test_a_falling_log_is_called_infeasible(tmp_path: Path) -> None:
    (tmp_path / "wild.toml").write_text("[env]\nshared_speed = 2.0\nsmoothing = 0.0\n")
    run(
        "record",
        "--scene",
        "free",
        "--policy",
        "random",
        "--episodes",
        "1",
        "--config",
        tmp_path / "wild.toml",
        "--out",
        tmp_path / "in",
    )
    (source,) = (tmp_path / "in").glob("*.mcap")
    assert read_episode(source).instability.any(), "it must fall, or the test shows nothing"
    done = spoken.said("smooth", source, "--out", tmp_path / "out", "--json")
    report = json.loads(done.stdout)
    (row,) = report["rows"]
    assert row["status"] == "raw_infeasible", (
        "whether or not its execution is a better fall, it is not safe"
    )
    assert row["reason"]
    assert done.exit_code == (3 if row["parameters"]["steps_of"] == "log" else 0)
    assert "Infinity" not in json.dumps(report)
    run("check", tmp_path / "out", "--jobs", "1")


@pytest.mark.parametrize(
    ("args", "wanted"),
    [
        (("--method", "magic"), "unknown method 'magic'; choose one of: local, paper, shared"),
        (("--cutoff", "-1"), "cutoff"),
        (("--cutoff", "0"), "cutoff"),
        (("--max-deviation", "0"), "max_deviation"),
        (("--clearance", "-0.1"), "clearance"),
    ],
)
def test_bad_options_are_refused_with_a_sentence(
    logs: Path, tmp_path: Path, args: tuple[str, ...], wanted: str
) -> None:
    assert wanted in said(run("smooth", logs, "--out", tmp_path / "out", *args, wanted=2))
    assert not (tmp_path / "out").exists()


def test_a_missing_input_and_a_taken_report_are_refused(logs: Path, tmp_path: Path) -> None:
    assert "no such file" in said(
        run("smooth", tmp_path / "none", "--out", tmp_path / "out", wanted=2)
    )
    (tmp_path / "report.json").write_text("{}")
    assert "not overwritten" in said(
        run(
            "smooth",
            logs,
            "--out",
            tmp_path / "out",
            "--report",
            tmp_path / "report.json",
            wanted=2,
        )
    )


def many(logs: Path, folder: Path, count: int) -> Path:
    """The same log under many names, each its own file."""
    source = next(logs.rglob("planar*.mcap"))
    episode, attachments = read_episode(source), read_attachments(source)
    folder.mkdir()
    for i in range(count):
        header = replace(episode.header, episode=episode.header.episode | {"index": i})
        write_episode(
            folder / f"{i:02d}.mcap",
            replace(episode, header=header),
            attachments=attachments,
            display=False,
        )
    return folder


def test_ctrl_c_ends_between_two_episodes_and_the_next_run_goes_on(
    logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, out = many(logs, tmp_path / "in", 4), tmp_path / "out"

    def interrupted(job: batch.Job) -> Json:
        row = batch_smooth_file(job)
        if job.source.stem == "01":
            signal.raise_signal(signal.SIGINT)
        return row

    batch_smooth_file = batch.smooth_file
    monkeypatch.setattr(batch, "smooth_file", interrupted)
    done = spoken.said("smooth", folder, "--out", out, "--jobs", "1")
    assert (done.exit_code, done.unforeseen) == (130, None), done.stderr
    assert sorted(path.name for path in out.iterdir() if path.suffix) == ["00.mcap", "01.mcap"]
    monkeypatch.setattr(batch, "smooth_file", batch_smooth_file)
    again = json.loads(run("smooth", folder, "--out", out, "--jobs", "1", "--json").stdout)
    assert (again["resumed"], again["episodes"]) == (2, 4)


def test_ctrl_c_reaches_the_workers_too_and_the_next_run_goes_on(
    logs: Path, tmp_path: Path
) -> None:
    folder, out = many(logs, tmp_path / "in", 12), tmp_path / "out"
    process = subprocess.Popen(
        [*COORDLOG, "smooth", str(folder), "--out", str(out), "--jobs", "2"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    deadline = time.monotonic() + 300
    while len(list(out.glob("*.mcap"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to every process of the group
    _, err = process.communicate(timeout=300)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    finished = sorted(out.glob("*.mcap"))
    assert 2 <= len(finished) < 12
    assert not list(out.glob("*.part"))
    here = tmp_path / "here"
    run("smooth", folder / finished[0].name, "--out", here, "--jobs", "1")
    assert (here / finished[0].name).read_bytes() == finished[0].read_bytes(), "whoever made it"


def test_a_killed_batch_goes_on_where_it_stopped(logs: Path, tmp_path: Path) -> None:
    folder, out = many(logs, tmp_path / "in", 6), tmp_path / "out"
    process = subprocess.Popen(
        [*COORDLOG, "smooth", str(folder), "--out", str(out), "--jobs", "1"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    deadline = time.monotonic() + 300
    while len(list(out.glob("*.mcap"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.01)
    process.kill()
    process.wait()
    (out / "05.mcap.part").write_bytes(b"half of it")
    report = json.loads(run("smooth", folder, "--out", out, "--jobs", "1", "--json").stdout)
    assert report["resumed"] >= 2
    assert sum(report["statuses"].values()) == 6
    assert not list(out.glob("*.part"))
    run("check", out, "--jobs", "1")
