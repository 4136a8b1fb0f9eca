"""What a draft writes is what rerun's own conversion writes."""

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import Chunk

from coordlog.view.draft import Draft

RNG = np.random.default_rng(5)
PLACES, TURNS = RNG.standard_normal((6, 3)), RNG.standard_normal((6, 4))
COLOURS = [(1, 2, 3, 4), (250, 0, 128, 255)] * 3
SIZES = RNG.random(6).astype(np.float32)
TIME = rr.TimeColumn(
    "t", duration=np.array([0, 40, 80], dtype="timedelta64[ms]").astype("timedelta64[ns]")
)

FIELDS = {
    rr.Capsules3D: {
        "lengths": SIZES,
        "radii": SIZES,
        "colors": COLOURS,
        "translations": PLACES,
        "quaternions": TURNS,
    },
    rr.Ellipsoids3D: {
        "half_sizes": PLACES,
        "centers": PLACES,
        "colors": np.array(COLOURS, dtype=np.uint8),
    },
    rr.Points3D: {"positions": PLACES, "labels": list("abcdef"), "radii": SIZES},
    rr.LineStrips3D: {"strips": PLACES.reshape(3, 2, 3), "colors": COLOURS[:3]},
    rr.SeriesLines: {"names": ["a", "b"], "colors": COLOURS[:2], "widths": SIZES[:2]},
    rr.SeriesPoints: {
        "markers": [rr.components.MarkerShape.Diamond] * 2,
        "marker_sizes": SIZES[:2],
    },
    rr.StateConfiguration: {
        "values": ["up", "no"],
        "colors": COLOURS[:2],
        "visible": [True, False],
    },
    rr.Mesh3D: {
        "vertex_positions": PLACES,
        "triangle_indices": np.array([[0, 1, 2], [3, 4, 5]], dtype=np.uint32),
        "vertex_normals": PLACES,
    },
}
NUMBERS = {
    rr.Boxes3D: {"half_sizes": PLACES, "radii": 0.125},
    rr.LineStrips3D: {"radii": 0.25},
    rr.Points3D: {"show_labels": [True], "radii": 0.5},
}
CONSTANTS = {
    rr.Boxes3D: ("fill_mode", rr.components.FillMode.Solid),
    rr.SeriesLines: ("interpolation_mode", rr.components.InterpolationMode.StepAfter),
}


def written(draft):
    """The one chunk of a draft, its row and chunk ids aside: types, metadata and values of each
    column."""
    handed = []
    draft.send(type("Stream", (), {"send_chunks": lambda self, chunks: handed.extend(chunks)})())
    assert len(handed) == 1
    return content(handed[0])


def content(chunk):
    batch = chunk.to_record_batch()
    columns = {
        field.name: (field.type, field.metadata, batch[field.name].to_pylist())
        for field in batch.schema
    }
    columns.pop("rerun.controls.RowId")
    return chunk.entity_path, columns


def by_rerun(archetype, fields):
    batches = archetype.from_fields(**fields).as_component_batches()
    whole = [
        rr.ComponentColumn(
            batch.component_descriptor(), batch, lengths=[len(batch.as_arrow_array())]
        )
        for batch in batches
    ]
    return content(Chunk.from_columns("/a", [], whole))


@pytest.mark.parametrize("table", [FIELDS, NUMBERS])
def test_a_row_is_what_the_archetype_makes_of_it(table):
    for archetype, fields in table.items():
        draft = Draft()
        draft.log("/a", archetype, **fields)
        assert written(draft) == by_rerun(archetype, fields), archetype


def test_an_enumerated_constant_is_the_archetypes():
    for archetype, (field, constant) in CONSTANTS.items():
        draft = Draft()
        draft.log("/a", archetype, **{field: [constant]})
        assert written(draft) == by_rerun(archetype, {field: constant})


@pytest.mark.parametrize("counts", [2, np.array([1, 0, 5])])
def test_rows_are_what_the_archetype_partitions_them_into(counts):
    for archetype, fields in (
        (rr.Boxes3D, {"centers": PLACES, "quaternions": TURNS}),
        (rr.Points3D, {"positions": PLACES, "labels": list("abcdef"), "colors": COLOURS}),
        (rr.Scalars, {"scalars": RNG.standard_normal(6)}),
    ):
        draft = Draft()
        draft.columns("/a", TIME, archetype, counts, **fields)
        columns = archetype.columns(**fields).partition(np.broadcast_to(counts, 3))
        assert written(draft) == content(Chunk.from_columns("/a", [TIME], columns)), archetype


def test_a_draft_with_a_time_of_its_own_logs_at_that_time():
    draft = Draft(rr.TimeColumn("update", sequence=[7]))
    draft.log("/a", rr.Points3D, positions=PLACES)
    assert written(draft)[1]["update"][2] == [7]


def test_columns_of_another_length_than_their_time_are_refused():
    with pytest.raises(ValueError, match="length"):
        Draft().columns("/a", TIME, rr.Scalars, scalars=np.zeros(4))
