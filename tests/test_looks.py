"""What a robot looks like: kept once beside the logs, drawn where it is there, and never needed."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import zstandard

from coordlog.api import check, record
from coordlog.episode import VISUALS
from coordlog.mjcf import load_attached, load_dressed, looks_of, pack_source, robot_looks, worn_by
from coordlog.mjcf.source import whole
from coordlog.record.beside import Beside, copy_beside, keep
from coordlog.record.recording import Recording
from coordlog.view.files import draw_files
from tests.robots.outside import robot, scene, text

SHELL = """<asset><mesh name="shell" vertex="0 0 0  .1 0 0  0 .1 0  0 0 .3"/>
  <mesh name="flat" vertex="0 0 0  .1 0 0  .1 .1 0  0 .1 0" face="0 1 2  0 2 3" inertia="shell"/>
  <material name="paint" rgba=".1 .2 .3 1"/></asset>"""
DRAWN = (
    '<geom type="mesh" mesh="shell" pos=".01 0 0" euler="0 0 1" material="paint" contype="0" '
    'conaffinity="0" mass="0"/><geom type="mesh" mesh="flat" rgba="1 0 0 1" contype="0" '
    'conaffinity="0" mass="0"/>'
)
CARD = 'name="upper"'


def dressed_text(**changes):
    plain = text(asset=SHELL, **changes)
    geom = f'<geom {CARD} fromto="0 0 0.05 0 0 0.22"/>'
    assert geom in plain
    return plain.replace(geom, geom + DRAWN)


@pytest.fixture
def worn():
    return robot(dressed_text())


def attached(worn):
    return {**pack_source(whole(worn)), **robot_looks(worn).attached}


def corners(model, body):
    """Corners of the meshes of a body in the world, at rest."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    found = []
    for geom in np.flatnonzero(model.geom_bodyid == model.body(body).id):
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.geom_dataid[geom]
            first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            turn = data.geom_xmat[geom].reshape(3, 3)
            found.append(data.geom_xpos[geom] + model.mesh_vert[first : first + count] @ turn.T)
    return np.round(np.concatenate(found), 5)


def test_a_robot_is_drawn_where_and_as_its_own_model_has_it(worn):
    looks = robot_looks(worn)
    model = load_dressed(attached(worn), looks.meshes.get)
    own = mujoco.MjModel.from_xml_string(dressed_text())
    assert len(looks.meshes) == 2
    assert sorted(map(tuple, corners(model, "upper"))) == sorted(map(tuple, corners(own, "upper")))
    drawn = model.geom_type == mujoco.mjtGeom.mjGEOM_MESH
    assert sorted(map(tuple, np.round(model.geom_rgba[drawn], 3))) == [
        (0.1, 0.2, 0.3, 1.0),
        (1.0, 0.0, 0.0, 1.0),
    ]


def test_what_is_worn_hides_what_collides_and_changes_nothing_else(worn):
    bare = load_attached(attached(worn))
    model = load_dressed(attached(worn), robot_looks(worn).meshes.get)
    assert model.geom("upper").group[0] >= 3
    assert model.geom("fore").group[0] < 3
    assert (model.nq, model.nv, model.nbody) == (bare.nq, bare.nv, bare.nbody)
    np.testing.assert_array_equal(model.body_mass, bare.body_mass)
    assert not bare.nmesh


def test_a_model_of_somebody_elses_has_the_same_looks(worn):
    own = mujoco.MjModel.from_xml_string(dressed_text())
    theirs = looks_of(own)
    model = load_dressed(attached(worn) | theirs.attached, theirs.meshes.get)
    assert sorted(map(tuple, corners(model, "upper"))) == sorted(map(tuple, corners(own, "upper")))
    assert not looks_of(mujoco.MjModel.from_xml_string(robot().mjcf)).meshes


def test_a_mesh_that_cannot_be_read_is_not_drawn_and_all_else_is(tmp_path):
    asset = SHELL.replace("<asset>", '<asset><mesh name="gone" file="gone.stl"/>')
    gone = '<geom type="mesh" mesh="gone" contype="0" conaffinity="0" mass="0"/>'
    path = tmp_path / "arm.xml"
    path.write_text(dressed_text().replace(SHELL, asset).replace(DRAWN, DRAWN + gone))
    found = robot_looks(robot(path))
    assert found.meshes.keys() == robot_looks(robot(dressed_text())).meshes.keys()


@pytest.mark.parametrize(
    "said",
    [
        b"no json",
        b"{}",
        b'[{"body": 99, "mesh": "a"}]',
        b'[{"mesh": 3}]',
        b'[{"body": 1, "mesh": "../logs/a"}]',
        b"[" + b"{}," * 10_001 + b"{}]",
    ],
)
def test_looks_that_are_none_are_not_drawn(worn, said):
    frame = zstandard.ZstdCompressor().compress(said)
    model = load_dressed(attached(worn) | {VISUALS: frame}, robot_looks(worn).meshes.get)
    assert not model.nmesh


@pytest.mark.parametrize("change", [lambda data: data[:-4], lambda data: data[:40] + b"\0" * 12])
def test_a_mesh_that_is_not_what_its_name_says_is_not_drawn(worn, change):
    def find(name):
        data = zstandard.ZstdDecompressor().decompress(robot_looks(worn).meshes[name])
        return zstandard.ZstdCompressor().compress(change(data))

    assert not load_dressed(attached(worn), find).nmesh


def test_a_mesh_with_corners_it_does_not_have_is_not_drawn(worn):
    import hashlib
    import struct

    data = struct.pack("<4i9f3i", 3, 0, 0, 1, *range(9), 0, 1, 7)
    name = hashlib.sha256(data).hexdigest() + ".msh"
    said = {"body": 1, "mesh": name, "pos": [0, 0, 0], "quat": [1, 0, 0, 0], "rgba": [1, 1, 1, 1]}
    frame = zstandard.ZstdCompressor().compress(json.dumps([said]).encode())
    kept = zstandard.ZstdCompressor().compress(data)
    assert not load_dressed(attached(worn) | {VISUALS: frame}, lambda _: kept).nmesh


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    place = replace(scene(), robot=robot(dressed_text()))
    out = tmp_path_factory.mktemp("looks") / "logs"
    record(place, episodes=2, out=out, seed=0)
    return out


def test_a_folder_has_every_mesh_once_and_its_logs_are_sound_without(logs, tmp_path):
    files = sorted(path.name for path in (logs / "assets").iterdir())
    log = next(logs.glob("*.mcap"))
    recording = Recording(log)
    assert files == worn_by(recording.attachments)
    assert len(files) == 2
    shutil.copy(log, tmp_path)
    assert not check([tmp_path]).findings


def test_a_viewer_draws_it_and_says_what_is_missing(logs, tmp_path):
    from coordlog.monitor import Monitor

    class Notes(Monitor):
        heard: list[str] = []  # noqa: RUF012

        def note(self, text):
            self.heard.append(text)

    notes = Notes()
    log = next(logs.glob("*.mcap"))
    draw_files([log], alone=True, monitor=notes).stream.disconnect()
    assert not notes.heard
    bare = Path(shutil.copy(log, tmp_path))
    draw_files([bare], alone=True, monitor=notes).stream.disconnect()
    assert "2 of its meshes are not in" in notes.heard[0]


def test_files_beside_logs_go_where_logs_go(logs, tmp_path):
    from coordlog.catalog.packing import pack_files, unpack_files
    from coordlog.record.files import find_files

    names = Beside(logs / "a.mcap").names()
    pack, back = tmp_path / "pack", tmp_path / "back"
    pack_files([(path, path.name) for path in find_files([logs]).paths], pack)
    unpack_files([(path, path.name) for path in find_files([pack]).paths], back)
    for folder in (pack, back):
        assert sorted(path.name for path in (folder / "assets").iterdir()) == names


def test_what_lies_above_is_found_and_not_kept_again(tmp_path):
    one, other, none = (f"{letter * 64}.msh.zst" for letter in "abc")
    keep(tmp_path, {one: b"a"})
    (tmp_path / "episodes").mkdir()
    (tmp_path / "episodes" / "assets").write_text("a file of somebody else's")
    (tmp_path / "assets" / "of somebody else's").touch()
    inner = tmp_path / "episodes" / "eval"
    keep(inner, {one: b"a", other: b"b"})
    assert [path.name for path in (inner / "assets").iterdir()] == [other]
    assert Beside(inner / "log.mcap")(one) == b"a"
    copy_beside(inner / "log.mcap", tmp_path.parent / "else", [one, none])
    assert Beside(tmp_path.parent / "else" / "log.mcap").names() == [one]
    keep(tmp_path, {one: b"a"})
