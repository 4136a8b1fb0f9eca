"""Episodes as a table of rerun's catalogue server, on this machine alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from coordlog.errors import ViewerError
from coordlog.record.reader import read_summary
from coordlog.view.serving import BLUEPRINT, DATASET, prepare, serving

LOGS = Path(__file__).parents[1] / "data" / "v2" / "planar"


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_an_episode_is_a_row_with_its_properties_and_the_layout_of_view(tmp_path: Path) -> None:
    from rerun.catalog import CatalogClient

    (path,) = sorted(LOGS.glob("*.mcap"))[:1]
    assert prepare((0, path), tmp_path).reason == ""
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(path.read_bytes()[:-9])
    assert "commit marker" in prepare((1, broken), tmp_path).reason
    assert (tmp_path / BLUEPRINT).exists()
    with serving(tmp_path) as address:
        assert address.startswith("rerun+http://127.0.0.1:")
        entry = CatalogClient(address).get_dataset(DATASET)
        assert entry.default_blueprint() is not None
        table = entry.segment_table().to_arrow_table()
        _, result, _ = read_summary(path)
        assert table.num_rows == 1
        for name in ("success", "clean", "length"):
            assert table.column(f"property:coordlog:{name}").to_pylist() == [
                [getattr(result, name)]
            ]
        port = int(address.rsplit(":", 1)[1])
        with pytest.raises(ViewerError), serving(tmp_path, port=port):
            pass
