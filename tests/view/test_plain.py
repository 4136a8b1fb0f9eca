"""What other viewers need to show a file without coordlog."""

import json
import subprocess
from pathlib import Path

import pytest
import rerun as rr

from coordlog.errors import ViewerError
from coordlog.record.writer import write_episode
from coordlog.spec import ARM, JOINT_STATE_TOPIC, REACH, STEP, TASK_TOPIC
from coordlog.view import viewer
from coordlog.view.headless import Headless
from coordlog.view.plain import APPLICATION, foxglove_layout, plain_blueprint
from coordlog.view.viewer import BINARY

DOCS = Path(__file__).parents[2] / "docs" / "viewers"


@pytest.mark.parametrize("scene", ["free", "planar"])
def test_plain_rerun_plots_a_converted_file_by_the_blueprint(shows, scene, tmp_path):
    episode = shows[scene].episode
    write_episode(tmp_path / "a.mcap", episode, attachments={}, display=True)
    command = [
        BINARY,
        "mcap",
        "convert",
        tmp_path / "a.mcap",
        "-o",
        tmp_path / "a.rrd",
        "--application-id",
        APPLICATION,
    ]
    subprocess.run(command, check=True, capture_output=True, env=viewer.environment(tmp_path))
    plain_blueprint(episode.header.arms).save(APPLICATION, str(tmp_path / "a.rbl"))
    try:
        with Headless(size=(800, 600)) as headless:
            headless.open(tmp_path / "a.rbl", tmp_path / "a.rrd")
            headless.picture()
            assert headless.complaints() == []
            assert set(headless.views()) == {
                "joint angles [rad]",
                "joint speeds [rad/s]",
                "palm to goal [m]",
                "reward per step",
            }
    except ViewerError as error:
        if "Vulkan" in str(error):
            pytest.skip(str(error))
        raise


def test_joint_states_decode_natively_by_name(shows, tmp_path):
    episode = shows["free"].episode
    write_episode(tmp_path / "a.mcap", episode, attachments={}, display=True)
    command = [BINARY, "mcap", "convert", tmp_path / "a.mcap", "-o", tmp_path / "a.rrd"]
    subprocess.run(command, check=True, capture_output=True, env=viewer.environment(tmp_path))
    chunks = (
        rr.chunk.RrdReader(str(tmp_path / "a.rrd"))
        .stream()
        .filter(content=f"{JOINT_STATE_TOPIC}/position")
        .to_chunks()
    )
    names = {
        name for chunk in chunks for name in chunk.to_record_batch()["SeriesLines:names"][0].as_py()
    }
    assert names == {joint["name"] for joint in episode.header.env["joints"]}


@pytest.mark.parametrize("scene", ["table", "planar"])
def test_every_path_of_the_foxglove_layout_is_a_field_of_a_message(shows, scene):
    header = shows[scene].episode.header
    joints = [joint["name"] for joint in header.env["joints"]]
    layout = foxglove_layout(header.arms, joints, header.env["action_joints"])
    fields = {ARM.topic + arm: {item.name for item in ARM.fields} for arm in header.arms}
    fields |= {
        STEP.topic: {item.name for item in STEP.fields},
        f"{TASK_TOPIC}reach": {item.name for item in REACH},
        JOINT_STATE_TOPIC: {f"position[{i}]" for i in range(len(joints))},
    }
    paths = [path for panel in layout["configById"].values() for path in panel.get("paths", [])]
    for path in paths:
        topic, field = path["value"].split(".")
        assert field in fields[topic], path["value"]
    assert sum(path["enabled"] for path in paths if JOINT_STATE_TOPIC in path["value"]) == len(
        header.env["action_joints"]
    )


def test_the_foxglove_layout_is_a_tree_of_its_panels():
    layout = foxglove_layout(["left", "right"], ["a", "b"], ["a"])
    assert set(layout) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}

    def leaves(node):
        if isinstance(node, str):
            return [node]
        assert set(node) == {"first", "second", "direction", "splitPercentage"}
        assert node["direction"] in ("row", "column")
        assert 0 < node["splitPercentage"] < 100
        return leaves(node["first"]) + leaves(node["second"])

    assert sorted(leaves(layout["layout"])) == sorted(layout["configById"])
    settings = {
        "Plot": {"title", "paths", "showLegend", "legendDisplay", "xAxisVal", "isSynced"},
        "StateTransitions": {"paths", "isSynced"},
        "RawMessages": {"topicPath"},
    }
    for name, panel in layout["configById"].items():
        assert set(panel) == settings[name.split("!")[0]]
        for path in panel.get("paths", []):
            assert (
                {"value", "label", "enabled", "timestampMethod"}
                <= set(path)
                <= {"value", "label", "enabled", "timestampMethod", "color"}
            )
            assert path["timestampMethod"] in ("receiveTime", "headerStamp")


def test_the_documentation_carries_what_the_generator_writes(shows):
    header = shows["table"].episode.header
    joints = [joint["name"] for joint in header.env["joints"]]
    written = json.loads((DOCS / "humanoid.foxglove.json").read_text(encoding="utf-8"))
    assert written == foxglove_layout(header.arms, joints, header.env["action_joints"])
    blueprints = rr.chunk.RrdReader(str(DOCS / "humanoid.rbl")).blueprints()
    assert [entry.application_id for entry in blueprints] == [APPLICATION]
