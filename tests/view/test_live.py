"""A training run in the viewer as it goes."""

import time
from dataclasses import replace

import numpy as np
import pytest
import rerun as rr
from numpy.testing import assert_allclose, assert_array_equal

from coordlog.errors import ConfigError, SpecError, ViewerError
from coordlog.view.headless import Headless
from coordlog.view.live import Live
from tests.view.recordings import ReadBack, simulated_palms


@pytest.fixture
def episodes(shows):
    """Two evaluations of two episodes each: a fall and a success, then two successes.

    Only the first of each brings its model.
    """
    fell = replace(
        shows["table"],
        name="fell",
        episode=replace(shows["table"].episode, instability=np.ones(40, bool)),
    )
    good = replace(
        shows["table"],
        name="good",
        episode=shows["table"].episode.with_result(success=True, clean=True),
    )
    bare = replace(good, name="bare", attachments={})
    return [[fell, bare], [good, bare]]


def test_figures_and_evaluations_are_rows_over_updates(episodes, tmp_path):
    with Live("run", file=tmp_path / "a.rrd") as live:
        for update, loss in ((100, 0.5), (200, 0.25)):
            live.figures(update, {"loss/critic": loss, "held-out/clean": loss})
        live.figures(300, {"loss/actor": -1.0})
        live.evaluation(200, episodes[0])
        live.evaluation(400, episodes[1])
    recording = ReadBack(tmp_path / "a.rrd")
    losses = recording.column("/figure/loss/critic", "Scalars:scalars")
    assert_array_equal(np.concatenate(losses), [0.5, 0.25])
    assert_array_equal(
        recording.times("/figure/loss/critic", "Scalars:scalars", "update"), [100, 200]
    )
    fell = recording.column("/world/path/fell", "LineStrips3D:strips")
    assert [len(row) for row in fell] == [2, 0]  # both hands, and gone with the next evaluation
    assert_allclose(fell[0][1], simulated_palms(episodes[0][0])[:, 1], atol=1e-6)
    clean = recording.column("/world/path/clean\\ success", "LineStrips3D:strips")
    assert [len(row) for row in clean] == [2, 4]
    assert_array_equal(recording.times("/world/robot/box", "Boxes3D:centers", "update"), [200, 400])
    assert "2 episodes" in str(recording.column("/about", "TextDocument:text")[0][0])


def test_a_viewer_shows_it_without_complaint(episodes):
    try:
        with Headless(size=(900, 600)) as viewer:
            with Live("run", url=viewer.url) as live:
                live.figures(100, {"loss/critic": 0.5})
                live.evaluation(100, episodes[0])
                live.figures(200, {"loss/critic": 0.3, "held-out/clean": 0.5})
            wanted, deadline = {"loss", "held-out", "latest evaluation"}, time.monotonic() + 60.0
            while not wanted <= set(viewer.views()) and time.monotonic() < deadline:
                viewer.picture()  # what was sent is still on its way
            assert wanted <= set(viewer.views())
            assert viewer.complaints() == []
    except ViewerError as error:
        if "Vulkan" in str(error):
            pytest.skip(str(error))
        raise


def test_what_cannot_be_shown_is_said(tmp_path):
    with pytest.raises(ConfigError, match="got neither"):
        Live("run")
    with Live("run", file=tmp_path / "a.rrd") as live:
        for name in ("loss", "loss/", "/critic", "a/b/c"):
            with pytest.raises(SpecError, match="'panel/curve'"):
                live.figures(0, {name: 1.0})
        with pytest.raises(ConfigError, match="at least one episode"):
            live.evaluation(0, [])
    assert rr.chunk.RrdReader(str(tmp_path / "a.rrd")).blueprints()
