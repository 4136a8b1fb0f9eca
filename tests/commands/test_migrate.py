"""Episodes of version 1, written anew in version 2."""

import hashlib
from pathlib import Path

from typer.testing import CliRunner

from coordlog.cli import app
from coordlog.record.recording import Recording
from coordlog.verify.levels import check_files

V1 = Path(__file__).parents[1] / "data" / "v1"


def test_a_folder_becomes_new_files_that_name_the_old_ones(tmp_path):
    source = next(V1.glob("planar/*.mcap"))
    before = source.read_bytes()
    done = CliRunner().invoke(app, ["migrate", str(source.parent), "--out", str(tmp_path / "new")])
    assert done.exit_code == 0, done.output
    old, new = Recording(source), Recording(tmp_path / "new" / source.name)
    assert source.read_bytes() == before
    assert (old.header.version, new.header.version) == (1, 2)
    assert new.header.lineage["parents"] == [hashlib.sha256(before).hexdigest()]
    assert new.header.lineage["parameters"]["lineage"] == old.header.lineage
    for name, values in old.episode.columns.items():
        assert new.episode.columns[name].tobytes() == values.tobytes(), name
    filled = new.header.lineage["parameters"]["simulated_again"]
    assert new.episode.has("torque") == new.episode.has("ctrl") == filled
    assert sorted(new.attachments) == ["initial_state.f64", "model.xml.zst"]
    assert check_files([Path(new.source)], level="replay").findings == []
    made = Path(new.source).read_bytes()
    again = ["migrate", str(source.parent), str(tmp_path / "new"), "--out", str(tmp_path / "new")]
    done = CliRunner().invoke(app, again)
    assert done.exit_code == 0, done.output
    said = (
        "nothing to do for 2 episodes; 1 of the present schema version already; 1 migrated before"
    )
    assert said in " ".join(done.output.split())
    assert Path(new.source).read_bytes() == made


def test_what_cannot_be_read_is_named(tmp_path):
    source = next(V1.glob("planar/*.mcap"))
    logs = tmp_path / "logs"
    logs.mkdir()
    (logs / source.name).write_bytes(source.read_bytes())
    (logs / "gone.mcap").symlink_to(tmp_path / "nothing.mcap")
    done = CliRunner().invoke(app, ["migrate", str(logs), "--out", str(tmp_path / "new")])
    assert done.exit_code == 3
    assert "gone.mcap: cannot read: a link to nothing" in done.output
    assert (tmp_path / "new" / source.name).is_file()


def test_nothing_is_overwritten_and_what_was_not_migrated_is_named(tmp_path):
    source = next(V1.glob("planar/*.mcap"))
    (tmp_path / source.name).write_bytes(b"mine")
    done = CliRunner().invoke(app, ["migrate", str(source), "--out", str(tmp_path)])
    assert done.exit_code == 2
    assert (tmp_path / source.name).read_bytes() == b"mine"
    assert "0 of 1 episodes migrated" in done.output
    assert "exists and is not overwritten" in " ".join(done.output.split())
