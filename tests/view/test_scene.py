"""What stands in the recording is where MuJoCo puts it, at every step."""

import mujoco
import numpy as np
import pytest
import zstandard
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from coordlog.episode import INITIAL_STATE, MODEL_XML
from coordlog.view.recording import to_rerun
from tests.view.recordings import Recording, action_places, with_contacts

CENTRE = {
    "box": "Boxes3D:centers",
    "ellipsoid": "Ellipsoids3D:centers",
    "sphere": "Ellipsoids3D:centers",
    "capsule": "Capsules3D:translations",
}


def simulated(show):
    """The attached model with plain MuJoCo, and its state at every step: an oracle that shares no
    code with the package."""
    model = mujoco.MjModel.from_xml_string(
        zstandard.ZstdDecompressor().decompress(show.attachments[MODEL_XML]).decode()
    )
    data = mujoco.MjData(model)
    mujoco.mj_setState(
        model,
        data,
        np.frombuffer(show.attachments[INITIAL_STATE]),
        mujoco.mjtState.mjSTATE_INTEGRATION,
    )
    for qpos in show.episode.qpos:
        data.qpos[:] = qpos
        mujoco.mj_forward(model, data)
        yield model, data


def geoms(model, kind, robot):
    """Ids of the geoms of one kind, in model order: the robot's, or of bodies that never move."""
    wanted = getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}").value
    moves = [
        model.body_weldid[model.geom_bodyid[i]] != 0
        and model.body_mocapid[model.geom_bodyid[i]] < 0
        for i in range(model.ngeom)
    ]
    return [i for i in range(model.ngeom) if model.geom_type[i] == wanted and moves[i] == robot]


def pose(recording, entity, kind, row):
    """Centres and rotation matrices of the shapes of one entity, by the viewer's conventions."""
    place = recording.column(entity, CENTRE[kind])[row]
    prefix = CENTRE[kind].split(":")[0]
    turned = Rotation.from_quat(
        recording.column(entity, f"{prefix}:quaternions")[row]
    ).as_matrix()  # xyzw, as the viewer's
    if kind == "capsule":  # from its origin along +z
        place = (
            place + turned[:, :, 2] * recording.column(entity, "Capsules3D:lengths")[0][:, None] / 2
        )
    return place, turned


@pytest.mark.parametrize("scene", ["free", "spheres", "table", "shelf", "planar"])
def test_every_solid_of_the_robot_is_where_mujoco_has_it_at_every_step(shows, scene, tmp_path):
    show = shows[scene]
    recording = Recording(to_rerun([show]), tmp_path / "a.rrd")
    kinds = [kind for kind in CENTRE if f"/world/robot/{kind}" in recording.entities]
    drawn = {kind: recording.column(f"/world/robot/{kind}", CENTRE[kind]) for kind in kinds}
    assert kinds
    for t, (model, data) in enumerate(simulated(show)):
        for kind in kinds:
            ids = geoms(model, kind, robot=True)
            assert len(ids) == len(drawn[kind][t])
            if t % 8 == 0:  # reading a row back is slow
                place, turned = pose(recording, f"/world/robot/{kind}", kind, t)
                assert_allclose(place, data.geom_xpos[ids], atol=2e-6)
                assert_allclose(turned, data.geom_xmat[ids].reshape(-1, 3, 3), atol=2e-6)
    assert all(len(rows) == t + 1 for rows in drawn.values())
    moving = sum(len(geoms(model, kind, robot=True)) for kind in CENTRE)
    robot = [
        i
        for i in range(model.ngeom)
        if model.body_weldid[model.geom_bodyid[i]] and model.body_mocapid[model.geom_bodyid[i]] < 0
    ]
    assert moving == len(robot)  # no geom of the robot is of a kind that is not drawn


def test_sizes_and_colours_are_the_models(shows, tmp_path):
    recording = Recording(to_rerun([shows["free"]]), tmp_path / "a.rrd")
    model, _ = next(simulated(shows["free"]))
    capsules, boxes = geoms(model, "capsule", robot=True), geoms(model, "box", robot=True)
    entity = "/world/robot/capsule"
    assert_allclose(
        recording.column(entity, "Capsules3D:lengths")[0],
        2 * model.geom_size[capsules, 1],
        rtol=1e-6,
    )
    assert_allclose(
        recording.column(entity, "Capsules3D:radii")[0], model.geom_size[capsules, 0], rtol=1e-6
    )
    assert_allclose(
        recording.column("/world/robot/box", "Boxes3D:half_sizes")[0],
        model.geom_size[boxes],
        rtol=1e-6,
    )
    packed = recording.column("/world/robot/box", "Boxes3D:colors")[0]
    assert_array_equal(
        [packed >> 24 & 255, packed >> 16 & 255, packed >> 8 & 255, packed & 255],
        np.round(255 * model.geom_rgba[boxes].T),
    )


@pytest.mark.parametrize(("scene", "panels"), [("table", 1), ("shelf", 5)])
def test_panels_stand_where_the_model_has_them(shows, scene, panels, tmp_path):
    recording = Recording(to_rerun([shows[scene]]), tmp_path / "a.rrd")
    model, data = next(simulated(shows[scene]))
    ids = [i for i in geoms(model, "box", robot=False) if model.geom_bodyid[i] == 0]
    place, turned = pose(recording, "/world/world/box", "box", 0)
    assert len(place) == panels
    assert_allclose(place, data.geom_xpos[ids], atol=1e-6)
    assert_allclose(turned, data.geom_xmat[ids].reshape(-1, 3, 3), atol=1e-6)
    assert_allclose(
        recording.column("/world/world/box", "Boxes3D:half_sizes")[0],
        model.geom_size[ids],
        rtol=1e-6,
    )


@pytest.mark.parametrize(("scene", "clear"), [("table", {"table"}), ("shelf", {"shelf_left"})])
def test_panels_in_front_of_the_goals_are_see_through(shows, scene, clear, tmp_path):
    recording = Recording(to_rerun([shows[scene]]), tmp_path / "a.rrd")
    model, _ = next(simulated(shows[scene]))
    names = [
        model.geom(i).name for i in geoms(model, "box", robot=False) if model.geom_bodyid[i] == 0
    ]
    alpha = recording.column("/world/world/box", "Boxes3D:colors")[0] & 255
    assert clear <= {name for name, a in zip(names, alpha, strict=True) if a == 255}
    if scene == "shelf":
        assert {"shelf_back", "shelf_top"} <= {
            name for name, a in zip(names, alpha, strict=True) if a < 128
        }


def test_object_goals_and_spheres_are_those_of_the_episode(shows, tmp_path):
    show = shows["spheres"]
    recording = Recording(to_rerun([show]), tmp_path / "a.rrd")
    goals, obstacles = (
        np.array(show.episode.header.episode["goals"]),
        np.array(show.episode.header.episode["obstacles"]),
    )
    assert_allclose(
        recording.column("/world/goal/centre", "Points3D:positions")[0], goals, atol=1e-6
    )
    assert_allclose(
        recording.column("/world/goal/tolerance", "Ellipsoids3D:half_sizes")[0], 0.03, atol=1e-9
    )
    assert_allclose(
        recording.column("/world/object/box", "Boxes3D:centers")[0][0],
        goals.mean(axis=0),
        atol=1e-6,
    )
    assert_allclose(
        recording.column("/world/obstacle/sphere", "Ellipsoids3D:centers")[0],
        obstacles[:, :3],
        atol=1e-6,
    )
    assert_allclose(
        recording.column("/world/obstacle/sphere", "Ellipsoids3D:half_sizes")[0][:, 0],
        obstacles[:, 3],
        rtol=1e-6,
    )


@pytest.mark.parametrize("scene", ["table", "planar"])
def test_hand_paths_go_through_the_palms(shows, scene, tmp_path):
    show = shows[scene]
    recording = Recording(to_rerun([show]), tmp_path / "a.rrd")
    for arm in show.episode.header.env["robot"]["arms"]:
        palms = np.array([data.site(arm["palm"]).xpos.copy() for _, data in simulated(show)])
        drawn = recording.column(f"/world/path/{arm['name']}/executed", "LineStrips3D:strips")[0][0]
        assert_allclose(drawn, palms, atol=1e-6)
        dots = np.concatenate(recording.column(f"/world/palm/{arm['name']}", "Points3D:positions"))
        assert_allclose(dots, palms, atol=1e-6)


def test_knots_and_spline_lead_the_palms_where_the_joints_put_them(smoothed, tmp_path):
    recording = Recording(to_rerun([smoothed]), tmp_path / "a.rrd")
    episode, joints = smoothed.episode, action_places(smoothed.episode)
    model, data = next(simulated(smoothed))
    for arm in episode.header.env["robot"]["arms"]:
        wanted = {"knots": [], "spline": []}
        for t, qpos in enumerate(episode.qpos):
            for name, position in (
                ("knots", episode.path.knot_position),
                ("spline", episode.path.position),
            ):
                data.qpos[:] = qpos
                data.qpos[joints] = position[t]
                mujoco.mj_kinematics(model, data)
                wanted[name].append(data.site(arm["palm"]).xpos.copy())
        knots = recording.column(f"/world/path/{arm['name']}/knots", "Points3D:positions")[0]
        assert_allclose(knots, wanted["knots"], atol=1e-6)
        spline = recording.column(f"/world/path/{arm['name']}/spline", "LineStrips3D:strips")[0][0]
        assert_allclose(spline[::4], wanted["spline"], atol=1e-6)


def test_contacts_flash_when_they_happen_and_only_then(shows, tmp_path):
    show = with_contacts(shows["free"])
    recording = Recording(to_rerun([show]), tmp_path / "a.rrd")
    rows = recording.column("/world/contact/now", "Points3D:positions")
    times = recording.times("/world/contact/now", "Points3D:positions")
    counts = [len(row) for row in rows]
    assert counts == [
        2 if step == 5 else 1 if step == 7 else 0 for step in range(len(show.episode))
    ]
    assert times[5] == round(show.episode.time[6] * 1e9)  # what step 5 led to
    assert_allclose(rows[7], [[0.3, -0.1, 0.7]], atol=1e-7)
    names = show.episode.header.env["geoms"]
    labels = recording.column("/world/contact/now", "Points3D:labels")
    assert labels[7].tolist() == [f"{names[2]} – {names[5]}"]


def test_centre_of_mass_and_support_polygon(shows, tmp_path):
    show = shows["free"]
    recording = Recording(to_rerun([show]), tmp_path / "a.rrd")
    masses = recording.column("/world/balance/mass", "Points3D:positions")
    outlines = recording.column("/world/balance/support", "LineStrips3D:strips")
    for t, (model, data) in enumerate(simulated(show)):
        com = data.subtree_com[model.body("pelvis").id]
        assert_allclose(masses[t][0], com, atol=1e-6)
        assert_allclose(masses[t][1][:2], com[:2], atol=1e-6)
        soles = [model.site(i).name for i in range(model.nsite) if "_corner_" in model.site(i).name]
        corners = np.array([data.site(name).xpos for name in soles])
        low = corners[corners[:, 2] < 0.002, :2]
        outline = outlines[t][0][:, :2]
        assert_allclose(outline[0], outline[-1])
        edges = np.diff(outline, axis=0)
        for corner in low:  # on the left of every edge, or on it
            across = edges[:, 0] * (corner[1] - outline[:-1, 1]) - edges[:, 1] * (
                corner[0] - outline[:-1, 0]
            )
            assert (across > -1e-7).all()
        for point in outline:
            assert np.abs(low - point).sum(axis=1).min() < 1e-6
