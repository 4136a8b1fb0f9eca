"""What viewers and readers of ROS 2 bags see of a recorded episode."""

from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from coordlog.record.display import Shown
from coordlog.record.recording import Recording
from coordlog.record.writer import write_episode
from coordlog.sim.description import GRAIN, Description
from coordlog.spec import DESCRIPTION_TOPIC, STEP, TRANSFORMS_TOPIC

V1 = Path(__file__).parents[1] / "data" / "v1"
LINKS = """
<mujoco><worldbody>
  <body name="a" pos="0.1 0 1" euler="10 20 30"><freejoint/><geom size="0.1"/>
    <body name="b" pos="0 0.2 0"><joint type="hinge" axis="1 1 0" pos="0.05 0 0.1" ref="0.3"/>
      <geom type="capsule" size="0.02 0.1"/>
      <body pos="0 0 0.2" quat="1 1 0 0"><joint type="slide" axis="0 1 1"/>
        <joint type="hinge" axis="0 0 1"/><geom type="box" size="0.1 0.2 0.3" group="3"/>
        <body name="d" pos="0.3 0 0"><joint type="ball" pos="0 0.1 0"/>
          <geom type="ellipsoid" size="0.1 0.1 0.2"/></body></body></body></body>
  <body name="e" mocap="true" pos="1 2 3"><geom name="ball" size="0.05"/></body>
  <geom type="plane" size="0 0 1"/>
</worldbody></mujoco>"""


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """A fixture episode with everything that viewers show."""
    stored = Recording(next(V1.glob("table/*s12*.mcap")))
    path = tmp_path_factory.mktemp("shown") / "a.mcap"
    write_episode(path, stored.episode, attachments=stored.attachments, display=True)
    return Recording(path)


def world(links, parents, transforms):
    """Poses of links in the world, by name, from those in their parents; plain loops."""
    found = {"world": (np.zeros(3), np.array([1.0, 0, 0, 0]))}
    for link, parent, row in zip(links[1:], parents, transforms, strict=True):
        pos, quat = found[parent]
        moved, turned = np.zeros(3), np.zeros(4)
        mujoco.mju_rotVecQuat(moved, row[:3], quat)
        mujoco.mju_mulQuat(turned, quat, np.array([row[6], *row[3:6]]))
        found[link] = (pos + moved, turned / np.linalg.norm(turned))
    return found


@pytest.mark.parametrize("kind", ["joints of every kind", "recorded"])
def test_transforms_are_where_mujoco_puts_the_bodies(shown, rng, kind):
    if kind == "recorded":
        model, qpos = shown.model, shown.episode.qpos[::30]
        mocap = Description(model).mocap(shown.initial_state)
    else:
        model = mujoco.MjModel.from_xml_string(LINKS)
        qpos = rng.normal(size=(5, model.nq))
        mocap = np.hstack([rng.normal(size=3), [0.6, 0.8, 0, 0]])[None]
    description, data = Description(model), mujoco.MjData(model)
    transforms = description.transforms(qpos, np.repeat(mocap[None], len(qpos), axis=0))
    for row, angles in zip(transforms, qpos, strict=True):
        data.qpos, data.mocap_pos, data.mocap_quat = angles, mocap[:, :3], mocap[:, 3:]
        mujoco.mj_kinematics(model, data)
        found = world(description.links, description.parents, row)
        for body, link in enumerate(description.links):
            assert found[link][0] == pytest.approx(data.xpos[body], abs=40 * GRAIN)
            assert abs(found[link][1] @ data.xquat[body]) == pytest.approx(1.0, abs=1e-5)


def test_the_urdf_has_every_link_once_and_every_shape():
    description = Description(mujoco.MjModel.from_xml_string(LINKS))
    root = ElementTree.fromstring(description.urdf({"ball": 0.07}))
    names = [link.get("name") for link in root.iter("link")]
    assert names == ["world", "a", "b", "body_3", "d", "e"] == list(description.links)
    joints = {joint.find("child").get("link"): joint for joint in root.iter("joint")}
    assert {name: joint.get("type") for name, joint in joints.items()} == {
        "a": "floating",
        "b": "floating",
        "body_3": "floating",
        "d": "floating",
        "e": "floating",
    }
    shapes = [shape.tag for geometry in root.iter("geometry") for shape in geometry]
    assert sorted(shapes) == ["box", "box", "capsule", "sphere", "sphere", "sphere"]
    assert root.find("link[@name='e']/visual/geometry/sphere").get("radius") == "0.07"


def test_mcap_ros2_support_reads_every_transform(shown):
    description = Description(shown.model)
    with open(shown.source, "rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        found = [
            (channel.topic, message.log_time, decoded)
            for _, channel, message, decoded in reader.iter_decoded_messages(
                [TRANSFORMS_TOPIC, DESCRIPTION_TOPIC]
            )
        ]
    texts = [decoded.data for topic, _, decoded in found if topic == DESCRIPTION_TOPIC]
    assert texts == [description.urdf()]
    rows = [
        (time, decoded.transforms) for topic, time, decoded in found if topic == TRANSFORMS_TOPIC
    ]
    every = Shown.every(shown.header.episode["control_period"])
    assert every == 2, "12.5 poses a second are enough to look at"
    qpos = shown.episode.qpos[:-1:every]
    assert len(rows) == len(qpos)
    mocap = np.repeat(description.mocap(shown.initial_state)[None], len(rows), axis=0)
    wanted = description.transforms(qpos, mocap)
    for (time, transforms), values in zip(rows, wanted, strict=True):
        assert [item.child_frame_id for item in transforms] == list(description.links[1:])
        assert [item.header.frame_id for item in transforms] == list(description.parents)
        for item, row in zip(transforms, values, strict=True):
            assert item.header.stamp.sec * 10**9 + item.header.stamp.nanosec == time
            place, turn = item.transform.translation, item.transform.rotation
            assert [place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w] == row.tolist()


def test_rosbags_reads_every_message(shown):
    highlevel = pytest.importorskip("rosbags.highlevel")
    counts, last = {}, None
    with highlevel.AnyReader([Path(shown.source)]) as reader:
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            counts[connection.topic] = counts.get(connection.topic, 0) + 1
            last = message if connection.topic == STEP.topic else last
        assert sum(counts.values()) == reader.message_count
    with open(shown.source, "rb") as stream:
        summary = make_reader(stream).get_summary()
    assert counts == {
        summary.channels[number].topic: count
        for number, count in summary.statistics.channel_message_counts.items()
    }
    assert last.qpos.tolist() == shown.episode.qpos[-2].tolist()


def test_rerun_has_geometry_and_transforms_of_every_link(shown):
    rr = pytest.importorskip("rerun")
    shapes, frames = set(), set()
    for chunk in rr.chunk.McapReader(shown.source).stream().to_chunks():
        batch = chunk.to_record_batch()
        shapes |= {name.split(":")[0] for name in batch.schema.names}
        if "Transform3D:child_frame" in batch.schema.names:
            for frame in batch["Transform3D:child_frame"].to_pylist():
                frames |= set(frame or ())
    assert {"Capsules3D", "Boxes3D"} <= shapes
    assert set(Description(shown.model).links[1:]) <= frames
