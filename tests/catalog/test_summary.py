import json

import numpy as np
import pytest

from coordlog.catalog.gather import gather
from coordlog.catalog.summary import summary as summed
from coordlog.errors import SpecError
from coordlog.record.writer import write_episode
from tests.record.test_reader import bad_files
from tests.synthetic import ATTACHMENTS, make_episode, make_header


@pytest.fixture
def folder(tmp_path, rng):
    for name, ending, scene in (
        ("a", "goal", "table"),
        ("b", "fall", "shelf"),
        ("c", "interrupted", "table"),
    ):
        episode = make_episode(
            rng, length=40, ending=ending, collisions=0, header=make_header(scene=scene)
        )
        write_episode(tmp_path / f"{name}.mcap", episode, attachments=ATTACHMENTS, display=False)
    (tmp_path / "d.mcap.part").write_bytes(b"")
    return tmp_path


def test_rows_and_totals(folder):
    summary = summed(gather([folder]))
    assert [
        (row.scene, row.policy, row.length, row.success, row.clean, row.aborted)
        for row in summary.rows
    ] == [
        ("table", "expert", 40, True, True, ""),
        ("shelf", "expert", 40, False, False, ""),
        ("table", "expert", 40, False, False, "interrupted"),
    ]
    first = summary.rows[0]
    assert list(first.returns) == ["right", "left"]
    assert (first.duration, first.robot, first.split, first.seed) == (
        40 * 0.04,
        "synthetic",
        "test",
        7,
    )
    assert first.size == (folder / "a.mcap").stat().st_size
    totals = summary.totals
    assert (totals.episodes, totals.steps, totals.success, totals.clean, totals.aborted) == (
        3,
        120,
        1,
        1,
        1,
    )
    assert (totals.scenes, totals.policies) == ({"table": 2, "shelf": 1}, {"expert": 3})
    assert totals.size == sum(path.stat().st_size for path in folder.glob("*.mcap"))
    assert summary.parts == (folder / "d.mcap.part",)


def test_lineage_is_told(tmp_path, rng):
    header = make_header()
    header.lineage.update(parents=["ab" * 32], transform="smooth", parameters={"method": "local"})
    write_episode(
        tmp_path / "a.mcap", make_episode(rng, header=header), attachments={}, display=False
    )
    (row,) = summed(gather([tmp_path])).rows
    assert (row.transform, row.parents) == ("smooth", ("ab" * 32,))


def test_it_is_plain_json(folder):
    summary = summed(gather([folder]))
    data = json.loads(json.dumps(summary.to_json()))
    assert [row["path"] for row in data["episodes"]] == [
        str(folder / f"{name}.mcap") for name in "abc"
    ]
    assert data["totals"]["episodes"] == 3
    assert data["parts"] == [str(folder / "d.mcap.part")]
    assert np.isclose(data["episodes"][0]["returns"]["right"], summary.rows[0].returns["right"])


def test_broken_files_are_named_with_their_reason(folder):
    bad = bad_files(folder, make_header())
    del bad["folder.mcap"]
    summary = summed(gather([folder]))
    assert len(summary.rows) == 3
    assert {skipped.path.name for skipped in summary.skipped} == bad.keys()
    assert all(bad[skipped.path.name] in skipped.reason for skipped in summary.skipped)


def test_an_empty_folder_is_said_to_be_one(tmp_path):
    with pytest.raises(SpecError, match="no episodes"):
        summed(gather([tmp_path]))
