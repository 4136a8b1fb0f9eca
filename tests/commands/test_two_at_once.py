"""Tests that two processes do not train into one run folder, nor recover one recording."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from coordlog.episode import Episode
from coordlog.errors import StorageError
from coordlog.record.writer import EpisodeWriter
from coordlog.train.run import HELD, held
from tests.spoken import said

HOLD = """
import sys, time
from pathlib import Path
from coordlog.train.run import held
with held(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


def test_a_run_that_is_being_trained_says_by_whom_and_is_free_when_its_holder_dies(
    tmp_path: Path,
) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path / "run")], stdout=subprocess.PIPE, text=True
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        by = f"trained by another process, pid {holder.pid} on"
        with pytest.raises(StorageError, match=by), held(tmp_path / "run"):
            pass
        holder.kill()  # no clean end: the kernel lets go all the same
        holder.wait()
    with held(tmp_path / "run"):
        assert (tmp_path / "run" / HELD).read_text().startswith("pid ")


def test_a_run_can_be_held_again_by_the_same_process_only_after_it_let_go(tmp_path: Path) -> None:
    with held(tmp_path), pytest.raises(StorageError, match="wait for its end"), held(tmp_path):
        pass
    with held(tmp_path):
        pass


def test_of_two_trainings_into_one_folder_one_is_refused(tmp_path: Path) -> None:
    run = tmp_path / "run"
    with held(run):  # locks are between open files: another opening in this process counts too
        done = said("train", "--scene", "planar", "--steps", "1", "--out", run)
    assert done.exit_code == 2
    assert "trained by another process" in done.stderr
    assert [path.name for path in run.iterdir()] == [HELD]


def test_a_recording_in_progress_is_not_recovered(tmp_path: Path, episode: Episode) -> None:
    with EpisodeWriter(
        tmp_path / "a.mcap", episode.header, attachments={}, display=False
    ) as writer:
        done = said("recover", tmp_path)
        assert done.exit_code == 2
        assert "is being written" in done.stdout
        done = said("recover", "--discard-empty", writer.part, tmp_path)
        assert writer.part.exists()
    done = said("recover", "--discard-empty", tmp_path)
    assert done.exit_code == 0
    assert "nothing in it; deleted" in done.stdout
    assert list(tmp_path.iterdir()) == []
