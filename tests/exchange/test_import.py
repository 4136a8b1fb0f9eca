"""Imported motion is an episode: whole, seen by every command, and back where it came from."""

import json
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from typer.testing import CliRunner

import coordlog
from coordlog.cli import app
from coordlog.errors import CoordlogError
from coordlog.exchange.blocks import Options, export
from coordlog.exchange.importing import Plan, import_source
from coordlog.exchange.joints import JointMap
from coordlog.exchange.robot_model import read_model
from coordlog.exchange.source import entries
from coordlog.exchange.sources import Reading, digest_of
from coordlog.record.reader import read_episode
from tests.exchange.bags import NAMES, START, recorded, write_bag

ARM = """<mujoco model="arm"><worldbody><geom type="plane" size="2 2 .1"/>
<body name="upper" pos="0 0 .4"><joint name="shoulder" axis="0 1 0" range="-170 170"/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".04"/>
<body name="lower" pos=".3 0 0"><joint name="elbow" axis="0 1 0" range="-150 150"/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".04"/>
<body name="hand" pos=".3 0 0"><joint name="wrist" range="-150 150"/>
<geom type="sphere" size=".05"/></body></body></body></worldbody></mujoco>"""


@pytest.fixture
def arm(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    return path


@pytest.fixture
def bag(tmp_path, rng):
    stamps, position = recorded(rng)
    write_bag(tmp_path / "bag", stamps, position, rng=rng)
    return tmp_path / "bag", stamps, position


def run(*args, wanted=0):
    done = CliRunner().invoke(app, list(map(str, args)))
    assert done.exit_code == wanted, (done.output, done.exception)
    return done


def refused(*args):
    done = CliRunner().invoke(app, list(map(str, args)))
    assert isinstance(done.exception, CoordlogError), done.output
    return str(done.exception)


def test_a_bag_becomes_episodes_with_its_own_times(bag, arm, tmp_path):
    path, stamps, position = bag
    run("import", path, "--out", tmp_path / "logs", "--robot", arm, "--gap", "0.3")
    first, second = coordlog.open(tmp_path / "logs")
    assert (len(first), len(second)) == (99, 99)
    assert first.header.kind == "observed"
    columns = [NAMES.index(name) for name in ("shoulder", "elbow", "wrist")]
    np.testing.assert_array_equal(first.qpos, position[:100, columns])
    np.testing.assert_array_equal(second.qpos, position[100:, columns])
    for episode, own in ((first, stamps[:100]), (second, stamps[100:])):
        assert episode.header.episode["start_time"] == own[0]
        np.testing.assert_array_equal(np.rint(episode.time * 1e9).astype(int), own - own[0])
    about = first.header.lineage
    assert about["parents"] == [digest_of(path)]
    assert about["transform"] == "import"
    assert about["parameters"]["clock"] == "header stamps"
    assert about["parameters"]["velocity"].startswith("differences")
    assert not first.result.success


def test_the_same_import_again_changes_nothing(bag, tmp_path):
    args = ("import", bag[0], "--out", tmp_path / "logs")
    run(*args)
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "logs").iterdir()}
    assert "1 were there already" in run(*args).stdout
    assert before == {path: path.stat().st_mtime_ns for path in (tmp_path / "logs").iterdir()}
    run(*args, "--gap", "0.3")
    assert len(list((tmp_path / "logs").glob("*.mcap"))) == 3


def test_inspect_shows_what_is_understood_and_writes_nothing(bag, arm, tmp_path):
    args = ("import", bag[0], "--inspect", "--robot", arm)
    shown = run(*args).stdout
    assert "1 gaps (longest 0.41 s)" in shown or "1 gaps (longest 0.4" in shown
    (said,) = json.loads(run(*args, "--json").stdout)
    assert sorted(said["joints"]) == sorted(NAMES)
    assert not (tmp_path / "logs").exists()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time,shoulder,elbow,hand\n0,1.5,1,1\n1,1.5,1,1\n", "hand (nearest:"),
        ("time,shoulder\n0,1.5\n1,nan\n", "sample 1: joint shoulder: expected a number, got nan"),
        ("time,shoulder\n0,1.5\n-1,1\n", "expected time to go on, got a step back of 1 s"),
        ("time,shoulder\n0,1.5\n", "expected two samples of different stamps"),
    ],
)
def test_a_source_that_cannot_be_used_leaves_nothing_behind(tmp_path, arm, text, said):
    (tmp_path / "x.csv").write_text(text)
    args = ("import", tmp_path / "x.csv", "--robot", arm, "--out", tmp_path / "logs")
    assert said in refused(*args)
    assert not (tmp_path / "logs").exists()


def test_pieces_of_a_single_sample_are_named(tmp_path):
    (tmp_path / "x.csv").write_text("time,a\n0,0.5\n0.1,0.5\n0.2,0.5\n9,0.25\n")
    args = ("import", tmp_path / "x.csv", "--out", tmp_path / "logs", "--gap", "1")
    done = run(*args, wanted=3)
    assert "a single sample, at 9000000000 ns: not an episode" in done.stderr
    assert len(coordlog.open(tmp_path / "logs")) == 1


def test_a_model_of_ours_holds_what_the_source_does_not_name(tmp_path):
    robot = read_model("planar")
    name = robot.model.joint(0).name
    (tmp_path / "x.csv").write_text(f"time,{name}\n0,0.5\n0.1,0.25\n")
    done = import_source(tmp_path / "x.csv", tmp_path / "logs", Plan(), robot)
    episode = read_episode(done.paths[0])
    assert episode.qpos[:, 0].tolist() == [0.5, 0.25]
    np.testing.assert_array_equal(episode.qpos[0, 1:], robot.rest[1:])
    assert any("held at rest" in note for note in done.understood[0].motion.notes)


def test_the_other_commands_take_observed_episodes(bag, arm, tmp_path):
    run("import", bag[0], "--out", tmp_path / "logs", "--robot", arm, "--gap", "0.3")
    assert "2 episodes (2 observed)" in run("info", tmp_path / "logs").stdout
    run("export", tmp_path / "logs", "--to", "rosbag2", "--out", tmp_path / "bags")
    again = sorted((tmp_path / "bags").iterdir())
    (motion,) = list(_motions(next(path for path in again if path.is_dir())))
    episode = coordlog.open(tmp_path / "logs")[0]
    names = [joint["name"] for joint in episode.header.env["joints"]]
    columns = [motion.names.index(name) for name in names]
    np.testing.assert_array_equal(motion.position[:, columns], episode.qpos[:-1])
    assert motion.stamps[0] == START + (bag[1][0] - START)


def _motions(path):
    from coordlog.exchange.sources import motions

    return motions(path, Reading())


def lerobot(logs, folder, to):
    export(entries([logs])[0], folder, Options(to))
    return folder


@pytest.mark.parametrize("to", ["lerobot", "lerobot2.1"])
def test_a_lerobot_set_comes_back_with_its_joints_alone_moved(logs, tmp_path, to):
    import pyarrow.parquet as pq
    from robovet.checks import run_doctor
    from robovet.dataset import LeRobotDataset

    source = lerobot(logs, tmp_path / "set", to)
    plan = Plan(
        Reading(state="observation.qpos"), JointMap(joints={"joint_1": ""}, scale={"joint_0": 2.0})
    )
    done = import_source(source, tmp_path / "in", plan, None)
    assert len(done.paths) == 7
    shifted = _shifted(done.paths, tmp_path / "moved", by=0.5)
    args = ("export", shifted, "--to", to, "--like", source, "--out", tmp_path / "out")
    run(*args)
    for name in sorted(path.relative_to(source) for path in source.rglob("*.parquet")):
        if name.parts[0] != "data":
            continue
        before, after = pq.read_table(source / name), pq.read_table(tmp_path / "out" / name)
        assert before.schema.equals(after.schema, check_metadata=True)
        for column in before.column_names:
            same = before.column(column).equals(after.column(column))
            assert same == (column != "observation.qpos"), column
        old = np.array(before["observation.qpos"].to_pylist())
        new = np.array(after["observation.qpos"].to_pylist())
        np.testing.assert_array_equal(old[:, 1], new[:, 1])
        np.testing.assert_allclose(new[:, 0], old[:, 0] + 0.25, atol=1e-12)
    report = run_doctor(LeRobotDataset(tmp_path / "out"))
    assert (report.counts["FAIL"], report.counts["WARN"]) == (0, 0)
    (source / "extra").write_text("changed")
    args = ("export", shifted, "--to", to, "--like", source, "--out", tmp_path / "no")
    assert "--like wants the very set it came from" in refused(*args)


def _shifted(paths, folder, *, by):
    """The episodes again, joint_0 moved: what a smoother would have written."""
    from dataclasses import replace

    from coordlog.episode import Episode
    from coordlog.record.writer import write_episode

    folder.mkdir()
    for path in paths:
        episode = read_episode(path)
        columns = dict(episode.columns) | {"qpos": episode.qpos + by}
        header = replace(episode.header, lineage=episode.header.lineage | {"transform": "test"})
        moved = Episode(header, episode.result, contacts=episode.contacts, columns=columns)
        write_episode(folder / Path(path).name, moved, attachments={}, display=False)
    return folder


def test_rosbags_reads_what_went_in_and_out(bag, arm, tmp_path):
    """The whole round: bag, episodes, bag."""
    run("import", bag[0], "--out", tmp_path / "logs", "--robot", arm)
    run(
        "export",
        tmp_path / "logs",
        "--to",
        "rosbag2",
        "--storage",
        "sqlite3",
        "--out",
        tmp_path / "b",
    )
    (folder,) = [path for path in (tmp_path / "b").iterdir() if path.is_dir()]
    with AnyReader([folder]) as read:
        (channel,) = [item for item in read.connections if item.topic == "/joint_states"]
        rows = [read.deserialize(raw, channel.msgtype) for _, _, raw in read.messages([channel])]
    columns = [list(rows[0].name).index(name) for name in NAMES]
    np.testing.assert_array_equal(np.array([row.position for row in rows])[:, columns], bag[2][:-1])


def test_a_bag_is_smoothed_and_goes_back_as_a_bag_with_a_trajectory(bag, arm, tmp_path):
    run("import", bag[0], "--out", tmp_path / "logs", "--robot", arm, "--gap", "0.3")
    args = ("smooth", tmp_path / "logs", "--out", tmp_path / "smooth", "--max-deviation", "0.05")
    said = json.loads(run(*args, "--jobs", "1", "--json").stdout)
    assert said["statuses"] == {"smoothed": 2}
    assert said["certified"] == 2
    assert said["median"]["jerk"] < 0.1
    for raw, smoothed in zip(
        coordlog.open(tmp_path / "logs"), coordlog.open(tmp_path / "smooth"), strict=True
    ):
        assert smoothed.header.kind == "observed"
        assert smoothed.header.lineage["parameters"]["steps_of"] == "path"
        assert smoothed.header.episode["source"] == raw.header.episode["source"]
        np.testing.assert_array_equal(smoothed.time, raw.time)
        np.testing.assert_array_equal(smoothed.qpos[[0, -1]], raw.qpos[[0, -1]])
        assert 0 < np.abs(smoothed.qpos - raw.qpos).max() <= 0.05
    run("export", tmp_path / "smooth", "--to", "rosbag2", "--out", tmp_path / "bags")
    first = min(path for path in (tmp_path / "bags").iterdir() if path.is_dir())
    episode = coordlog.open(tmp_path / "smooth")[0]
    with AnyReader([first]) as read:
        (channel,) = [item for item in read.connections if item.topic == "/joint_trajectory"]
        ((_, _, raw),) = read.messages([channel])
        message = read.deserialize(raw, channel.msgtype)
    assert sorted(message.joint_names) == sorted(NAMES)
    np.testing.assert_array_equal(message.points[0].positions, episode.path.position[0])


def test_a_lerobot_set_is_smoothed_and_goes_back_as_one(arm, tmp_path, rng):
    from robovet.checks import run_doctor
    from robovet.dataset import LeRobotDataset

    rows = ["time,episode,shoulder,elbow,wrist"]
    for episode in range(2):
        for i in range(60):
            noisy = 0.3 * np.sin(i / 15 + np.arange(3)) + rng.normal(0, 2e-3, 3)
            rows.append(f"{i / 30},{episode},{','.join(map(repr, noisy.tolist()))}")
    (tmp_path / "x.csv").write_text("\n".join(rows) + "\n")
    model = read_model(str(arm))
    import_source(tmp_path / "x.csv", tmp_path / "logs", Plan(), model)
    run("export", tmp_path / "logs", "--to", "lerobot", "--out", tmp_path / "set")
    import_source(tmp_path / "set", tmp_path / "in", Plan(), model)
    args = ("smooth", tmp_path / "in", "--out", tmp_path / "smooth", "--max-deviation", "0.02")
    run(*args, "--jobs", "1")
    run(
        *("export", tmp_path / "smooth", "--to", "lerobot", "--like", tmp_path / "set"),
        *("--out", tmp_path / "out"),
    )
    import pyarrow.parquet as pq

    name = "data/chunk-000/file-000.parquet"
    before, after = pq.read_table(tmp_path / "set" / name), pq.read_table(tmp_path / "out" / name)
    changed = [c for c in before.column_names if not before[c].equals(after[c])]
    assert changed == ["observation.state", "action"]
    states = np.array(after["observation.state"].to_pylist())
    wanted = np.concatenate([each.qpos for each in coordlog.open(tmp_path / "smooth")])
    np.testing.assert_allclose(states, wanted, atol=1e-6)
    for folder in ("set", "out"):
        report = run_doctor(LeRobotDataset(tmp_path / folder))
        assert (report.counts["FAIL"], report.counts["WARN"]) == (0, 0)
