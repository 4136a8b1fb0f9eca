"""A few harms of every kind, drawn from a seed: no command ends in a traceback, and `check` lets no
changed value pass."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from coordlog.record.reader import read_episode
from experiments.trust import (
    BEGIN,
    END,
    EVERY,
    PAGE,
    ROOT,
    Count,
    cut,
    flipped,
    harm_bytes,
    harm_configurations,
    harm_metadata,
    harm_policies,
    harm_runs,
    recorded,
    same,
    smeared,
)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("trust"))


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def assert_foreseen(found: Count) -> None:
    assert found.unforeseen == []
    assert found.noticed > 0


@pytest.mark.parametrize("level", ["file", "content"])
@pytest.mark.parametrize("how", [flipped, cut, smeared])
def test_no_changed_value_passes_check(how, level: str, file: Path, tmp_path: Path) -> None:
    found = harm_bytes(file, tmp_path, how, count=20, seed=11, level=level)
    assert_foreseen(found)
    assert found.silent == 0


def test_a_changed_value_is_seen(file: Path) -> None:
    episode = read_episode(file)
    assert same(episode, read_episode(file))
    for name, values in episode.columns.items():
        other = np.frombuffer(bytes(values.nbytes), values.dtype).reshape(values.shape)
        if values.any():
            assert not same(episode, replace(episode, columns={**episode.columns, name: other}))


@pytest.mark.parametrize("how", [flipped, cut, smeared])
def test_harmed_bytes_are_read_or_refused(how, file: Path, tmp_path: Path) -> None:
    found = harm_bytes(file, tmp_path, how, count=30, seed=12)
    assert_foreseen(found)
    assert found.silent == 0


def test_odd_metadata_ends_no_command_in_a_traceback(file: Path, tmp_path: Path) -> None:
    found = harm_metadata(file, tmp_path, count=10, seed=13, commands=EVERY[:5])
    assert found.unforeseen == []


def test_odd_policies_configurations_and_runs_end_in_a_sentence(tmp_path: Path) -> None:
    policy = ROOT / "coordlog" / "policies" / "free.safetensors"
    assert_foreseen(harm_policies(policy, tmp_path, count=8, seed=14))
    assert_foreseen(harm_configurations(tmp_path))
    assert_foreseen(harm_runs(tmp_path, count=3, seed=15))


def test_the_page_has_the_figures() -> None:
    table = PAGE.read_text(encoding="utf-8").split(BEGIN)[1].split(END)[0]
    rows = [line.split("|")[1:-1] for line in table.strip().splitlines()[2:]]
    assert len(rows) >= 10
    for what, tried, _, silent, tracebacks in rows:
        assert int(tried) > 0
        assert int(tracebacks) == 0, what
        assert int(silent) == 0, what
