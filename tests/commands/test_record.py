"""Tests for the commands that make, judge and mend logs, as a person runs them."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from mcap.writer import Writer

from tests import spoken
from tests.spoken import Said, sound

COORDLOG = [sys.executable, "-m", "coordlog.cli"]


def run(*args: str | Path, wanted: int = 0) -> Said:
    return sound(*args, code=wanted)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("logs")
    run(
        "record",
        "--scene",
        "planar",
        "--episodes",
        "4",
        "--envs",
        "2",
        "--seed",
        "5",
        "--out",
        folder,
    )
    run(
        "record",
        "--scene",
        "spheres",
        "--policy",
        "random",
        "--episodes",
        "2",
        "--out",
        folder / "deeper",
    )
    return folder


def test_record_sums_up_what_it_did(tmp_path: Path) -> None:
    done = run(
        "record",
        "--scene",
        "planar",
        "--policy",
        "still",
        "--episodes",
        "3",
        "--out",
        tmp_path,
        "--json",
    )
    summary = json.loads(done.stdout)
    assert summary["episodes"] == 3
    assert summary["success"] == 0.0
    assert summary["steps"] == 3 * 150
    assert summary["recording_us_per_step"] > 0
    assert sorted(summary["files"]) == sorted(map(str, tmp_path.glob("*.mcap")))


def test_record_says_its_doubts_about_a_reward(tmp_path: Path) -> None:
    config = tmp_path / "easy.toml"
    config.write_text("[reward]\nkappa = 1.0\n[env]\nmax_steps = 5\n")
    done = run(
        "record",
        "--scene",
        "planar",
        "--episodes",
        "1",
        "--config",
        config,
        "--out",
        tmp_path / "logs",
    )
    assert "loitering" in done.stderr


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (
            ("--scene", "tabel"),
            "unknown scene 'tabel'; choose one of: a FILE.py:NAME of your own, free, hold, planar, shelf, spheres, table",
        ),
        (
            ("--policy", "exprt"),
            "unknown policy 'exprt'; choose one of: a run folder or policy file, expert, pretrained, random, still",
        ),
        (
            ("--scene", "planar", "--policy", "pretrained"),
            "no policy ships for scene 'planar'; one does for: ",
        ),
        (("--split", "val"), "unknown split 'val'; choose one of: test, train"),
        (("--start", "sit"), "unknown start pose 'sit'; choose one of: home, neutral, stand"),
        (("--noise-correlation", "1", "--noise", "1"), "correlation in [0, 1)"),
        (("--config", "none.toml"), "none.toml: cannot read the configuration"),
        (("--episodes", "0"), "greater than or equal to 1"),
    ],
)
def test_record_refuses_bad_input_with_a_sentence(
    tmp_path: Path, args: tuple[str, ...], said: str
) -> None:
    done = run("record", *args, "--out", tmp_path / "logs", wanted=2)
    assert said in " ".join(done.stderr.split())
    assert not list(tmp_path.glob("logs/*"))


@pytest.mark.parametrize(
    ("content", "said"),
    [("[env]\nspeeed = 1", "speeed"), ("[envs]", "unknown table"), ("[env", "expected TOML")],
)
def test_record_refuses_a_bad_configuration(tmp_path: Path, content: str, said: str) -> None:
    (tmp_path / "bad.toml").write_text(content)
    done = run("record", "--config", tmp_path / "bad.toml", "--out", tmp_path / "logs", wanted=2)
    assert said in done.stderr


def test_ctrl_c_closes_open_episodes_and_exits_130(tmp_path: Path) -> None:
    args = [
        "record",
        "--scene",
        "planar",
        "--policy",
        "still",
        "--episodes",
        "100000",
        "--envs",
        "4",
        "--out",
        str(tmp_path),
        "--json",
    ]
    process = subprocess.Popen(
        [*COORDLOG, *args], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + 300
    while len(list(tmp_path.glob("*.mcap"))) < 4 and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=300)
    assert process.returncode == 130, err
    assert "interrupted" in err
    summary = json.loads(out)
    assert not list(tmp_path.glob("*.part"))
    assert summary["episodes"] + summary["aborted"] == len(list(tmp_path.glob("*.mcap")))
    run("check", tmp_path, "--jobs", "1")


def test_killed_runs_leave_finished_and_recoverable_episodes(tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    args = [
        "record",
        "--scene",
        "planar",
        "--policy",
        "random",
        "--episodes",
        "100000",
        "--envs",
        "4",
        "--out",
        str(folder),
    ]
    process = subprocess.Popen(
        [*COORDLOG, *args], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    deadline = time.monotonic() + 300
    while len(list(folder.glob("*.mcap"))) < 3 and time.monotonic() < deadline:
        time.sleep(0.02)
    time.sleep(0.14)
    process.kill()
    process.wait()
    finished, parts = list(folder.glob("*.mcap")), list(folder.glob("*.mcap.part"))
    assert finished
    assert len(finished) + len(parts) == len(list(folder.iterdir()))
    for part in parts:
        done = spoken.said("recover", part)
        assert done.unforeseen is None
        assert done.exit_code in (0, 2, 3), done.stderr
        recovered = part.with_suffix("")
        if (
            done.exit_code == 2
        ):  # nothing in it yet, or killed between giving the file its name and dropping the other
            empty = "nothing to recover" in done.stderr or "(0 bytes)" in done.stderr
            assert empty or recovered in finished, done.stderr
        else:
            finished.append(recovered)
    run("check", *finished, "--jobs", "1")


def test_a_full_disk_is_said_and_leaves_nothing_half_renamed(tmp_path: Path) -> None:
    few = ("--scene", "planar", "--policy", "random", "--episodes", "4", "--out", tmp_path)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))  # Python ignores its signal
    try:
        done = spoken.said("record", *few)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert (done.exit_code, done.unforeseen) == (2, None), done.stderr
    assert "cannot write" in done.stderr
    assert not list(tmp_path.glob("*.mcap"))


def test_two_runs_into_one_folder_at_once_do_not_collide(tmp_path: Path) -> None:
    args = [
        "record",
        "--scene",
        "planar",
        "--episodes",
        "3",
        "--envs",
        "3",
        "--epoch",
        "0",
        "--out",
        str(tmp_path),
    ]
    both = [
        subprocess.Popen(
            [*COORDLOG, *args], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        for _ in range(2)
    ]
    for process in both:
        assert process.communicate(timeout=300)[1] == ""
    assert [process.returncode for process in both] == [0, 0]
    assert len(list(tmp_path.glob("*.mcap"))) == 6
    run("check", tmp_path, "--jobs", "1")


def test_check_finds_everything_sound(logs: Path) -> None:
    report = json.loads(run("check", logs, "--json").stdout)
    assert report["files"] == 6
    assert report["findings"] == []
    assert report["steps"] > 200


def test_check_names_a_foreign_file_in_a_folder_and_refuses_it_alone(
    logs: Path, tmp_path: Path
) -> None:
    for path in logs.glob("*.mcap"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    with (tmp_path / "foreign.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        writer.finish()
    (tmp_path / "empty.mcap").write_bytes(b"")
    done = run("check", tmp_path, "--level", "file", wanted=3)
    assert "foreign.mcap" in done.stderr
    assert "empty.mcap" in done.stderr
    assert "foreign.mcap" in run("check", tmp_path / "foreign.mcap", wanted=2).stderr
    assert "empty.mcap" in run("info", tmp_path / "empty.mcap", wanted=2).stderr
    assert "foreign.mcap" in run("info", tmp_path, wanted=3).stderr


def test_check_notices_a_log_whose_physics_was_changed(logs: Path, tmp_path: Path) -> None:
    """A file that is whole and consistent, with one action altered: only the replay can tell."""
    from dataclasses import replace

    from coordlog.record.reader import read_attachments, read_episode
    from coordlog.record.writer import write_episode

    source = next(logs.glob("planar*.mcap"))
    episode = read_episode(source)
    action = episode.action.copy()
    action[7, 2] *= 0.5
    forged = replace(episode, action=action)
    write_episode(
        tmp_path / "forged.mcap", forged, attachments=read_attachments(source), display=True
    )
    run("check", tmp_path / "forged.mcap", "--level", "content")
    done = run("check", tmp_path / "forged.mcap", "--json", wanted=1)
    finding = json.loads(done.stdout)["findings"][0]
    assert (finding["level"], finding["step"]) == ("replay", 7), (
        "the altered action first shows in what step 7 led to"
    )
    assert finding["path"].endswith("forged.mcap")


def test_info_shows_rows_and_totals(logs: Path) -> None:
    rows = json.loads(run("info", logs, "--json").stdout)
    assert rows["totals"]["episodes"] == 6
    assert rows["totals"]["scenes"] == {"planar": 4, "spheres": 2}
    shown = run("info", logs).stdout
    assert "6 episodes" in shown
    assert "spheres-train-s0-000001" in shown


@pytest.mark.parametrize("command", ["record", "check", "info", "recover", "scenes"])
def test_every_command_and_every_option_has_help(command: str) -> None:
    import typer

    from coordlog.cli import app

    found = typer.main.get_command(app).commands[command]  # type: ignore[attr-defined]
    assert found.help
    assert all(parameter.help for parameter in found.params if parameter.name != "help")


def test_scenes_lists_the_numbers() -> None:
    rows = {row["scene"]: row for row in json.loads(run("scenes", "--json").stdout)}
    assert rows["free"]["joints"] == 13
    assert len(rows["spheres"]["obstacles"]) == 1
    assert rows["planar"]["arms"] == ["left", "middle", "right"]
    assert os.linesep in run("scenes").stdout
