"""Loading a model out of a log: the same model, and nothing else is ever opened."""

import mujoco
import numpy as np
import pytest
import zstandard

from coordlog.errors import FormatError
from coordlog.mjcf import attached, compile_model, compose, load_attached, load_model, pack_source
from coordlog.tasks.config import EnvConfig
from coordlog.tasks.scene import SCENES


def packed(content):
    return zstandard.ZstdCompressor().compress(
        content if isinstance(content, bytes) else content.encode()
    )


def binary(model):
    """A compiled model as MuJoCo's own bytes."""
    buffer = np.zeros(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer.tobytes()


@pytest.mark.parametrize("name", SCENES)
def test_the_text_gives_the_model_that_was_simulated_and_no_mjb_is_loaded(name):
    source = compose(SCENES[name], EnvConfig())
    wanted = compile_model(source)
    text = packed(source.text)
    assert binary(load_attached(pack_source(source))) == binary(wanted)
    for mjb in (None, packed(b"what would crash MuJoCo")):
        assert binary(load_model(text, mjb)) == binary(wanted)
    with pytest.raises(FormatError, match="MJB, which is not loaded"):
        load_model(None, packed(binary(wanted)))


@pytest.mark.parametrize(
    ("inside", "said"),
    [
        ('<include file="/etc/hosts"/>', "include"),
        ('<asset><mesh name="a" file="/etc/a.obj"/></asset>', "file="),
        ('<asset><texture name="a" type="cube" fileright="a.png"/></asset>', "fileright="),
        ('<asset><hfield name="a" file="a.png"/></asset>', "file="),
        ('<asset><model name="m" file="m.xml"/></asset>', "<model>"),
        ('<worldbody><attach model="m" prefix="p"/></worldbody>', "<attach>"),
        ('<compiler meshdir="/etc"/>', "meshdir="),
        ('<compiler assetdir="/etc"/>', "assetdir="),
        ('<extension><plugin plugin="x"/></extension>', "<extension>"),
    ],
)
def test_text_that_reaches_outside_is_refused(inside, said):
    with pytest.raises(FormatError, match=said):
        load_model(packed(f"<mujoco>{inside}</mujoco>"), None)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ('<!DOCTYPE mujoco [<!ENTITY a SYSTEM "file:///etc/hosts">]><mujoco/>', "document type"),
        ('<robot name="urdf"/>', "<robot>"),
        ("not xml", "expected XML"),
        ("", "expected XML"),
        (
            "<mujoco><worldbody><geom type='sphere'/></worldbody></mujoco>",
            "does not load in MuJoCo",
        ),
    ],
)
def test_what_is_no_plain_mjcf_is_refused(content, said):
    with pytest.raises(FormatError, match=said):
        load_model(packed(content), None)


def test_bytes_that_two_parsers_read_differently_cannot_hide_a_file():
    # expat reads UTF-16; MuJoCo's own parser never sees these bytes, only the text that was judged.
    text = '<?xml version="1.0" encoding="utf-16"?><mujoco model="wide"/>'.encode("utf-16")
    assert attached.self_contained(text) == '<mujoco model="wide" />'
    with pytest.raises(FormatError, match="include"):
        attached.self_contained(
            '<?xml version="1.0" encoding="utf-16"?><mujoco><include file="a"/></mujoco>'.encode(
                "utf-16"
            )
        )


def test_damage_and_absence_are_said(monkeypatch):
    with pytest.raises(FormatError, match="no model attached"):
        load_model(None, None)
    with pytest.raises(FormatError, match="MJCF text is damaged"):
        load_model(b"junk", None)
    with pytest.raises(FormatError, match="does not load in MuJoCo"):
        load_model(packed(b"<mujoco><nonsense/></mujoco>"), None)
    monkeypatch.setattr(attached, "MAX_BYTES", 1 << 20)
    with pytest.raises(FormatError, match="more than 1 MiB"):
        load_model(packed(b"\0" * (2 << 20)), None)


def test_a_damaged_model_leaves_nothing_on_the_console_or_in_the_folder(
    tmp_path, monkeypatch, capfd
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FormatError):
        load_model(zstandard.compress(b"<mujoco><nonsense/></mujoco>"), None)
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")
