"""What the peers' own libraries read out of our sets is the log, bit for bit."""

import json

import h5py
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from robovet.checks import run_doctor
from robovet.dataset import LeRobotDataset
from rosbags.highlevel import AnyReader

import coordlog
from coordlog.errors import FormatError
from coordlog.exchange.blocks import Options, export
from coordlog.exchange.source import entries
from coordlog.record.files import find_files
from coordlog.record.reader import read_episode


@pytest.fixture(scope="module")
def episodes(logs):
    return list(coordlog.open(logs))


@pytest.fixture(scope="module")
def sets(logs, tmp_path_factory):
    """The logs in a format; each written once."""
    made = {}

    def get(to, **options):
        key = (to, *options.values())
        if key not in made:
            made[key] = tmp_path_factory.mktemp("sets") / to
            export(entries([logs])[0], made[key], Options(to, **options))
        return made[key]

    return get


def same(got, wanted):
    got = np.asarray(got)
    assert got.dtype == wanted.dtype
    assert got.tobytes() == wanted.tobytes()


@pytest.mark.parametrize("to", ["lerobot", "lerobot2.1"])
def test_robovet_finds_a_lerobot_set_clean(sets, to):
    report = run_doctor(LeRobotDataset(sets(to)))
    assert (report.counts["FAIL"], report.counts["WARN"]) == (0, 0)
    assert report.counts["PASS"] > 20


def test_the_rows_of_a_lerobot_set_are_the_logs_and_its_final_states_are_kept(sets, episodes):
    folder = sets("lerobot")
    rows = pq.read_table(folder / "data/chunk-000/file-000.parquet")
    about = pq.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    for i, episode in enumerate(episodes):
        table = rows.filter(np.asarray(rows["episode_index"]) == i).to_pydict()
        for name in ("state", "qpos", "qvel", "time"):
            wanted = getattr(episode, name)
            same(np.array(table[f"observation.{name}"], wanted.dtype), wanted[:-1])
            same(np.array(about[i][f"coordlog/final.{name}"], wanted.dtype), wanted[-1])
        same(np.array(table["action"], np.float32), episode.action)
        same(np.array(table["next.rewards"]), episode.reward)
        same(np.array(table["next.reward"]), episode.reward.sum(axis=1))
        same(np.array(table["next.done"]), episode.terminated | episode.truncated)
        assert about[i]["coordlog/scene"] == episode.header.episode["scene"]
        assert about[i]["coordlog/clean"] == episode.result.clean
        assert len(about[i]["coordlog/sha256"]) == 64


def test_a_task_is_found_by_its_place_and_its_name(sets, episodes):
    tasks = pd.read_parquet(sets("lerobot") / "meta/tasks.parquet")
    assert list(tasks.index) == ["reach the goals (shelf)", "reach the goals (table)"]
    assert list(tasks["task_index"]) == [0, 1]


def test_statistics_are_numpys(sets, episodes):
    stats = json.loads((sets("lerobot") / "meta/stats.json").read_text())
    actions = np.concatenate([episode.action for episode in episodes]).astype(float)
    for name, wanted in (
        ("min", actions.min(axis=0)),
        ("max", actions.max(axis=0)),
        ("mean", actions.mean(axis=0)),
        ("std", actions.std(axis=0)),
    ):
        np.testing.assert_allclose(stats["action"][name], wanted, rtol=1e-12)
    assert stats["action"]["count"] == [len(actions)]
    rows = pq.read_table(sets("lerobot") / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    for row, episode in zip(rows, episodes, strict=True):
        wanted = np.quantile(episode.qpos[:-1], 0.9, axis=0)
        np.testing.assert_allclose(row["stats/observation.qpos/q90"], wanted, rtol=1e-12)


def test_minari_reads_states_actions_and_what_they_led_to(sets, episodes, monkeypatch):
    import minari

    monkeypatch.setenv("MINARI_DATASETS_PATH", str(sets("minari")))
    dataset = minari.load_dataset("coordlog/shelf-v0")
    assert (dataset.total_episodes, dataset.total_steps) == (7, sum(map(len, episodes)))
    for read, episode in zip(dataset.iterate_episodes(), episodes, strict=True):
        same(read.observations, episode.state)
        same(read.actions, episode.action)
        same(read.rewards, episode.reward.sum(axis=1))
        same(read.terminations, episode.terminated)
        same(read.infos["qpos"], episode.qpos)
        same(read.infos["distance"][1:], episode.distance)
        assert np.isnan(read.infos["distance"][0]).all()
        assert read.observations.dtype == dataset.observation_space.dtype
    origin = next(iter(dataset.storage.get_episode_metadata([6])))
    assert json.loads(origin["coordlog.origin"])["file"] == "6.mcap"


def test_robomimic_has_every_state_and_the_final_one(sets, episodes):
    with h5py.File(sets("robomimic") / "data.hdf5") as file:
        data = file["data"]
        assert list(data) == [f"demo_{i}" for i in range(7)]
        assert data.attrs["total"] == sum(map(len, episodes))
        assert json.loads(data.attrs["env_args"])["type"] == 2
        for demo, episode in zip(data.values(), episodes, strict=True):
            same(demo["obs/state"], episode.state[:-1])
            same(demo["next_obs/qpos"], episode.qpos[1:])
            same(demo["actions"], episode.action)
            whole = np.hstack([episode.time[:, None], episode.qpos, episode.qvel])
            same(demo["states"], whole[:-1])
            same(demo.attrs["final_state"], whole[-1])
            assert demo.attrs["num_samples"] == len(episode)
        assert list(file["mask/test"]) == [f"demo_{i}".encode() for i in range(7)]


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_rosbags_reads_a_bag_with_every_step(sets, episodes, storage):
    for i in (0, 6):
        with AnyReader([sets("rosbag2", storage=storage) / str(i)]) as bag:
            steps = [
                bag.deserialize(raw, connection.msgtype)
                for connection, _, raw in bag.messages()
                if connection.topic == "/coordlog/step"
            ]
            same(np.array([step.qpos for step in steps]), episodes[i].qpos[:-1])
            same(np.array([step.action for step in steps]), episodes[i].action)
            topics = {connection.topic for connection in bag.connections}
            assert ("/joint_trajectory" in topics) == (i == 6)
            assert ("/joint_states" in topics) == (i == 0)


def test_a_bag_of_a_smoothed_episode_has_its_spline_as_a_trajectory(sets, episodes):
    path = episodes[6].path
    with AnyReader([sets("rosbag2") / "6"]) as bag:
        (chosen,) = [item for item in bag.connections if item.topic == "/joint_trajectory"]
        ((_, time, raw),) = bag.messages([chosen])
        message = bag.deserialize(raw, chosen.msgtype)
    assert chosen.msgtype == "trajectory_msgs/msg/JointTrajectory"
    assert message.joint_names == episodes[6].header.env["action_joints"]
    same(np.array([point.positions for point in message.points]), path.position)
    same(np.array([point.velocities for point in message.points]), path.velocity)
    after = [p.time_from_start.sec + p.time_from_start.nanosec / 1e9 for p in message.points]
    np.testing.assert_allclose(after, path.time - path.time[0], atol=1e-9)
    assert time == episodes[6].header.episode["start_time"]


def test_a_bag_of_a_log_is_still_an_episode(sets, episodes):
    again = read_episode(sets("rosbag2") / "3" / "3.mcap")
    assert again.header == episodes[3].header
    same(again.qpos, episodes[3].qpos)


def test_a_folder_of_bags_holds_the_episodes_and_a_path_says_what_it_is(sets, tmp_path):
    found = find_files(sets("rosbag2"))
    assert [path.stem for path in found.paths] == [str(i) for i in range(7)]
    assert not found.left_out()
    moves = sets("rosbag2") / "6" / "6_trajectory.mcap"
    with pytest.raises(FormatError, match="path of a smoothed episode as a JointTrajectory"):
        read_episode(moves)
    alone = tmp_path / "6" / moves.name  # no bag around it: then it is looked at
    alone.parent.mkdir()
    alone.write_bytes(moves.read_bytes())
    assert find_files(tmp_path).paths == (alone,)


def test_pandas_reads_parquet_and_csv_to_the_last_bit(sets, episodes):
    rows = pd.read_parquet(sets("parquet") / "steps")
    table = pd.read_csv(sets("csv") / "steps.csv")
    qpos = np.concatenate([episode.qpos[:-1] for episode in episodes])
    same(np.stack(rows["qpos"]), qpos)
    same(table[["qpos.joint_0", "qpos.joint_1"]].to_numpy(), qpos)
    same(
        table["action.joint_0"].to_numpy(np.float32),
        np.concatenate([episode.action[:, 0] for episode in episodes]),
    )
    finals = pd.read_parquet(sets("parquet") / "episodes")
    ends = np.stack([episode.qpos[-1] for episode in episodes])
    same(np.stack(finals["final.qpos"]), ends)
    lines = pd.read_csv(sets("csv") / "episodes.csv")
    same(lines[["final.qpos.joint_0", "final.qpos.joint_1"]].to_numpy(), ends)
    assert list(lines["digest"]) == [episode.result.digest for episode in episodes]
