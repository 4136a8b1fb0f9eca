"""Laws of every export: the same bytes twice, however it was cut up; all of it or nothing."""

import hashlib
import json
import signal
import subprocess
import sys

import pytest

import coordlog
from coordlog.errors import ConfigError, FormatError, StorageError
from coordlog.exchange import FORMATS, blocks
from coordlog.exchange.blocks import MARKER, Options, export
from coordlog.exchange.source import entries


def everything(folder):
    """Every file of a set by name, with its content."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.fixture
def chosen(logs):
    return entries([logs])[0]


@pytest.fixture
def small(monkeypatch):
    monkeypatch.setattr(blocks, "BLOCK", 3)


def killed(chosen, out, options, monkeypatch, *, at):
    """An export that dies when it comes to a block."""

    def write(block, *, name):
        if block.number == at:
            raise KeyboardInterrupt
        return original(block, name=name)

    original = blocks._write
    with monkeypatch.context() as patch:
        patch.setattr(blocks, "_write", write)
        with pytest.raises(KeyboardInterrupt):
            export(chosen, out, options)


@pytest.mark.parametrize("to", FORMATS)
@pytest.mark.usefixtures("small")
def test_an_interrupted_export_leaves_no_set_and_ends_as_one_that_was_not(
    to, chosen, tmp_path, monkeypatch
):
    options = Options(to)
    whole = export(chosen, tmp_path / "whole", options)
    assert (whole.episodes, whole.blocks, whole.resumed) == (7, 3, 0)
    killed(chosen, tmp_path / "cut", options, monkeypatch, at=2)
    assert not (tmp_path / "cut").exists()
    resumed = export(chosen, tmp_path / "cut", options)
    assert resumed.resumed == 2
    assert everything(tmp_path / "cut") == everything(tmp_path / "whole")
    assert {path.name for path in tmp_path.iterdir()} == {"whole", "cut"}


KILLED = """
import os, signal, sys
from pathlib import Path

from coordlog.exchange import blocks
from coordlog.exchange.source import Loaded, entries


class Fifth(Loaded):
    seen = 0

    def __init__(self, path):
        Fifth.seen += 1
        if Fifth.seen == 5:
            os.kill(os.getpid(), signal.SIGKILL)
        super().__init__(path)


blocks.BLOCK, blocks.Loaded = 3, Fifth
blocks.export(entries([Path(sys.argv[1])])[0], Path(sys.argv[2]), blocks.Options(sys.argv[3]))
"""


@pytest.mark.parametrize("to", ["lerobot", "rosbag2"])
@pytest.mark.usefixtures("small")
def test_an_export_that_is_killed_leaves_no_set_and_the_same_command_ends_it(
    to, chosen, logs, tmp_path
):
    command = [sys.executable, "-c", KILLED, str(logs), str(tmp_path / "cut"), to]
    assert subprocess.run(command, check=False).returncode == -signal.SIGKILL
    assert [path.name for path in tmp_path.iterdir()] == [".cut.part"]
    assert export(chosen, tmp_path / "cut", Options(to)).resumed == 1
    export(chosen, tmp_path / "whole", Options(to))
    assert everything(tmp_path / "cut") == everything(tmp_path / "whole")
    assert {path.name for path in tmp_path.iterdir()} == {"whole", "cut"}


def test_a_set_that_is_there_is_left_as_it_is(chosen, tmp_path):
    export(chosen, tmp_path / "set", Options("csv"))
    stamps = {path: path.stat().st_mtime_ns for path in (tmp_path / "set").rglob("*")}
    assert export(chosen, tmp_path / "set", Options("csv")).unchanged
    assert stamps == {path: path.stat().st_mtime_ns for path in (tmp_path / "set").rglob("*")}


def test_another_set_is_not_overwritten_without_force(chosen, tmp_path):
    export(chosen[:2], tmp_path / "set", Options("csv"))
    before = everything(tmp_path / "set")
    with pytest.raises(StorageError, match="not overwritten"):
        export(chosen, tmp_path / "set", Options("csv"))
    assert everything(tmp_path / "set") == before
    export(chosen, tmp_path / "set", Options("csv"), force=True)
    assert json.loads((tmp_path / "set" / MARKER).read_text())["episodes"] == 7
    assert [path.name for path in tmp_path.iterdir()] == ["set"]


def test_an_export_of_other_episodes_begins_anew(chosen, tmp_path, monkeypatch):
    monkeypatch.setattr(blocks, "BLOCK", 3)
    killed(chosen, tmp_path / "set", Options("csv"), monkeypatch, at=1)
    done = export(chosen[:4], tmp_path / "set", Options("csv"))
    assert done.resumed == 0
    export(chosen[:4], tmp_path / "other", Options("csv"))
    assert everything(tmp_path / "set") == everything(tmp_path / "other")


def test_a_foreign_folder_in_the_place_of_the_growing_one_is_not_touched(chosen, tmp_path):
    (tmp_path / ".set.part").mkdir()
    (tmp_path / ".set.part" / "thesis.tex").write_text("precious")
    with pytest.raises(StorageError, match="not left by an export"):
        export(chosen, tmp_path / "set", Options("csv"))
    assert (tmp_path / ".set.part" / "thesis.tex").read_text() == "precious"


def test_what_cannot_be_one_set_is_said_before_anything_is_written(chosen, tmp_path):
    with pytest.raises(ConfigError, match="unknown format 'rlds'; choose one of: csv, lerobot"):
        export(chosen, tmp_path / "set", Options("rlds"))
    with pytest.raises(ConfigError, match="would both become the bag 0"):
        export([chosen[0], *entries([chosen[0].path])[0]], tmp_path / "set", Options("rosbag2"))
    (tmp_path / "empty").mkdir()
    with pytest.raises(FormatError, match="nothing to export"):
        entries([tmp_path / "empty"])
    assert [path.name for path in tmp_path.iterdir()] == ["empty"]


def test_episodes_of_two_robots_are_refused(chosen, tmp_path, file):
    with pytest.raises(ConfigError, match="several robots"):
        export([*chosen, *entries([file])[0]], tmp_path / "set", Options("csv"))


def test_the_episodes_come_in_the_order_of_their_names(chosen, logs):
    assert [entry.path.name for entry in chosen] == [f"{i}.mcap" for i in range(7)]
    assert [len(episode) for episode in coordlog.open(logs)] == [5, 6, 7, 8, 9, 10, 11]
