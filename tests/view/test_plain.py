"""What other viewers need to show a file without coordlog."""

import json
import subprocess
from pathlib import Path

import mujoco
import numpy as np
import pytest
import rerun as rr

from coordlog.errors import ViewerError
from coordlog.record.recording import Recording
from coordlog.record.writer import write_episode
from coordlog.sim.description import GRAIN
from coordlog.spec import ARM, JOINT_STATE_TOPIC, REACH, STEP, TASK_TOPIC, TRANSFORMS_TOPIC
from coordlog.view import viewer
from coordlog.view.headless import Headless
from coordlog.view.plain import APPLICATION, foxglove_layout, plain_blueprint
from coordlog.view.viewer import BINARY

DOCS = Path(__file__).parents[2] / "docs" / "viewers"
LOG = next((Path(__file__).parents[1] / "data" / "v2" / "table").glob("*.mcap"))


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


@pytest.fixture(scope="module")
def converted(tmp_path_factory):
    """A recording with everything for viewers, and what `rerun mcap convert` makes of its file."""
    folder, stored = tmp_path_factory.mktemp("converted"), Recording(LOG)
    write_episode(folder / "a.mcap", stored.episode, attachments=stored.attachments, display=True)
    command = [BINARY, "mcap", "convert", folder / "a.mcap", "-o", folder / "a.rrd"]
    subprocess.run(command, check=True, capture_output=True, env=viewer.environment(folder))
    return stored, rr.chunk.RrdReader(str(folder / "a.rrd"))


def values(reader, content, name):
    """One component of some entities as plain rows, and the paths that have it."""
    chunks = reader.stream().filter(content=content).to_chunks()
    named = [(chunk.entity_path, chunk.to_record_batch()) for chunk in chunks]
    named = [(path, batch) for path, batch in named if name in batch.schema.names]
    return [row for _, batch in named for row in batch[name].to_pylist()], {
        path for path, _ in named
    }


def test_joint_states_decode_natively_by_name(converted):
    stored, reader = converted
    rows, _ = values(reader, f"{JOINT_STATE_TOPIC}/position", "SeriesLines:names")
    assert set(rows[0]) == {joint["name"] for joint in stored.header.env["joints"]}


def test_every_link_has_its_geometry_and_moves_as_mujoco_says(converted):
    stored, reader = converted
    model, data = stored.model, mujoco.MjData(stored.model)
    solid = {model.body(int(model.geom_bodyid[i])).name for i in range(model.ngeom)} - {"world"}
    _, paths = values(reader, "/scene/**", "CoordinateFrame:frame")
    assert solid <= {path.split("/")[3] for path in paths if path.count("/") == 4}

    names = ("child_frame", "parent_frame", "translation", "quaternion")
    columns = [
        values(reader, TRANSFORMS_TOPIC, name)[0]
        for name in ("message_log_time", *(f"Transform3D:{name}" for name in names))
    ]
    rows = sorted(zip(*columns, strict=True), key=lambda row: row[0], reverse=True)
    first = {child: (parent, at, quat) for _, (child,), (parent,), (at,), (quat,) in rows}
    assert solid <= set(first)
    data.qpos[:] = stored.episode.qpos[0]
    mujoco.mj_kinematics(model, data)
    for link in solid:
        frame, place = link, np.zeros(3)
        while frame in first:
            frame, at, quat = first[frame]
            turned = np.zeros(3)
            mujoco.mju_rotVecQuat(turned, place, np.roll(quat, 1).astype(float))
            place = turned + at
        if model.body(link).mocapid[0] < 0:
            np.testing.assert_allclose(place, data.body(link).xpos, atol=12 * GRAIN)


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
