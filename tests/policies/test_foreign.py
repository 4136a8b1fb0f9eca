"""Policies of other people's: by name in a Python file, or as their library saved them."""

import zipfile

import numpy as np
import pytest

from coordlog.errors import ConfigError, FormatError
from coordlog.policies.foreign import as_act, load
from coordlog.policies.registry import pretrained


def test_a_policy_is_a_function_or_has_predict_or_act(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(
        "def double(o): return 2 * o\n"
        "class Acts:\n    def act(self, o): return -o\n"
        "class Predicts:\n    def predict(self, o, deterministic): return o + deterministic, None\n"
        "ready = Acts()\n"
    )
    for name, wanted in (("double", 6.0), ("Acts", -3.0), ("Predicts", 4.0), ("ready", -3.0)):
        act, about = load(f"{file}:{name}")
        assert act(np.array(3.0)) == wanted
        assert about["kind"] == "python"
        assert len(about["checkpoint_sha256"]) == 64
    with pytest.raises(ConfigError, match="doubel"):
        load(f"{file}:doubel")


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("p.pkl", b"\x80\x04abc", "a pickle, which would run anything"),
        ("p.py", b"x = 1", "write FILE.py:NAME"),
        ("p", b"\x7fELF", "a program"),
        ("p.txt", b"abc", "a file of another kind"),
    ],
)
def test_a_file_of_another_kind_is_named_for_what_it_is(name, content, said, tmp_path):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ConfigError, match=said):
        load(str(tmp_path / name))


def test_a_policy_of_a_scene_acts_in_no_environment_and_what_is_none_is_named(tmp_path):
    with pytest.raises(ConfigError, match="acts in coordlog's scenes alone, trained in 'table'"):
        load(str(pretrained("table")))
    (tmp_path / "p.safetensors").write_bytes(b"abc")
    with pytest.raises(FormatError, match="expected a coordlog policy"):
        load(str(tmp_path / "p.safetensors"))
    with pytest.raises(ConfigError, match=r"run folder with best\.safetensors, found none"):
        load(str(tmp_path))


def test_a_zip_that_is_no_model_is_named_by_what_is_in_it(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("photo.jpg", b"")
    with pytest.raises(ConfigError, match=r"a zip archive of photo\.jpg"):
        load(str(tmp_path / "a.zip"))
    with zipfile.ZipFile(tmp_path / "b.zip", "w") as archive:
        archive.writestr("data", "{}")
    with pytest.raises(ConfigError, match="of none of A2C"):
        load(str(tmp_path / "b.zip"))


def test_what_is_not_there_or_cannot_act_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="found no such file"):
        load(str(tmp_path / "none.zip"))
    with pytest.raises(ConfigError, match="found no such file"):
        load(f"{tmp_path}/none.py:NAME")
    with pytest.raises(ConfigError, match="got int"):
        as_act(3, "mine")
