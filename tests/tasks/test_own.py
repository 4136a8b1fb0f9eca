"""A scene of one's own is run from its file when a person names it, and never because a log or a
policy does."""

from __future__ import annotations

from pathlib import Path

import pytest

from coordlog.errors import ConfigError
from coordlog.tasks.own import scene_of
from coordlog.tasks.scene import SCENES, find

OWN = """
from dataclasses import replace
from coordlog.tasks.scene import find

PLAIN = replace(find("planar"), name="plain")
"""


def test_a_scene_of_a_file_is_the_object_of_that_name(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(OWN)
    scene = scene_of(f"{tmp_path}/own.py:PLAIN")
    assert scene.name == "plain"
    assert scene.robot == SCENES["planar"].robot


@pytest.mark.parametrize("said", ['file="m.stl"', "file = 'm.stl'", 'filename="package://m.stl"'])
def test_files_of_a_scenes_robot_lie_beside_it(said: str, tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(
        OWN + f"robot = replace(PLAIN.robot, mjcf={said!r})\nMESH = replace(PLAIN, robot=robot)\n"
    )
    assert scene_of(f"{tmp_path}/own.py:MESH").robot.assets == tmp_path.resolve()


def test_a_scene_that_ships_is_found_by_its_name() -> None:
    assert scene_of("table") is SCENES["table"]


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("own.py:FANCY", "unknown scene of own.py 'FANCY'; choose one of: PLAIN"),
        ("own.py:find", "unknown scene of own.py 'find'; choose one of: PLAIN"),
        ("none.py:PLAIN", "none.py: cannot be run for its scenes: FileNotFoundError"),
        (
            "broken.py:PLAIN",
            "broken.py: cannot be run for its scenes: ZeroDivisionError: division by zero",
        ),
    ],
)
def test_what_is_no_scene_is_refused_with_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("own.py").write_text(OWN)
    Path("broken.py").write_text("1 / 0")
    with pytest.raises(ConfigError, match=said):
        scene_of(name)


def test_a_name_out_of_a_log_runs_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("own.py").write_text("open('ran', 'w').close()\n" + OWN)
    with pytest.raises(ConfigError, match=r"unknown scene 'own.py:PLAIN'"):
        find("own.py:PLAIN")
    assert not Path("ran").exists()
