"""Processes that are killed, disks that are full, and two recordings at once."""

import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from coordlog.errors import FormatError, StorageError
from coordlog.record.reader import read_episode
from coordlog.record.storage import PART
from coordlog.record.writer import BLOCK, EpisodeWriter, write_episode
from coordlog.spec import FINAL, REACH, STEP
from coordlog.verify.file import check
from coordlog.verify.repair import recover
from tests.synthetic import ATTACHMENTS, COLUMNS, assert_same, make_episode, outcome
from tests.verify.test_repair import assert_prefix

HERE = Path(__file__).parents[2]

RECORDING = """
import sys
sys.path.insert(0, sys.argv[1])
from pathlib import Path
import numpy as np
from tests.synthetic import make_episode, make_header
from coordlog.errors import StorageError
from coordlog.record.tally import task_here
from coordlog.record.writer import BLOCK, EpisodeWriter

task_here(make_header())  # loads what the first episode would
folder, seed, pause = Path(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4])
import time
print("ready", flush=True)
for index in range(10_000):
    episode = make_episode(np.random.default_rng([seed, index]), length=100)
    path = folder / f"{seed}-{index:04}.mcap"
    with EpisodeWriter(path, episode.header, attachments={"a.zst": b"model"}, display=index % 2 == 0) as writer:
        for first in range(0, 100, BLOCK):
            columns = {name: values[first : first + BLOCK] for name, values in episode.columns.items()}
            low, high = np.searchsorted(episode.contacts["step"], (first, first + BLOCK))
            writer.write_steps(first, columns, contacts=episode.contacts[low:high])
            print(f"{seed}-{index:04} {first + BLOCK}", flush=True)
            time.sleep(pause)
        writer.finish({name: episode.columns[name][-1] for name in episode.before})
        print(f"{seed}-{index:04} finished", flush=True)
"""


def start(folder, seed, pause=0.0005):
    command = [sys.executable, "-c", RECORDING, str(HERE), str(folder), str(seed), str(pause)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "ready\n"
    return process


def assert_true_logs(folder, told):
    """Every finished file is valid and the one that was recorded.

    Every part is recoverable up to its last flush.
    """
    finished, flushed = set(), {}
    for line in told:
        name, what = line.split()
        if what == "finished":
            finished.add(name)
        else:
            flushed[name] = int(what)
    names = {path.name.split(".")[0] for path in folder.iterdir()}
    assert flushed.keys() <= names
    assert finished <= {path.stem for path in folder.glob("*.mcap")}
    for path in sorted(folder.iterdir()):
        name = path.name.split(".")[0]
        original = make_episode(
            np.random.default_rng([int(part) for part in name.split("-")]), length=100
        )
        if path.suffix == ".mcap":
            assert check(path) == []
            assert_same(read_episode(path), original)
            continue
        assert path.name == f"{name}.mcap{PART}"
        assert name not in finished
        if path.with_suffix(
            ""
        ).exists():  # killed after the name was given and before the part was unlinked
            assert os.path.samefile(path, path.with_suffix(""))
            continue
        recovered = outcome(recover, path, folder.parent / f"{name}.recovered.mcap")
        if isinstance(recovered, FormatError):
            assert flushed.get(name, 0) == 0
            continue
        assert recovered.steps_kept >= flushed.get(name, 0) - 1
        assert check(recovered.path) == []
        assert_prefix(read_episode(recovered.path), original)


def test_killed_at_random_moments(tmp_path, rng):
    partial = 0
    for trial in range(8):
        folder = tmp_path / f"{trial}" / "logs"
        folder.mkdir(parents=True)
        process = start(folder, trial)
        time.sleep(float(rng.uniform(0.005, 0.3)))
        process.send_signal(signal.SIGKILL)
        told, _ = process.communicate()
        lines = told.split("\n")
        assert_true_logs(folder, [line for line in lines[:-1] if line])
        partial += len(list(folder.glob("*.part")))
    assert partial  # at least one kill hit an open episode, or this test tests nothing


def test_two_recordings_into_one_folder(tmp_path):
    folder = tmp_path / "logs"
    folder.mkdir()
    processes = [start(folder, seed, pause=0) for seed in (1, 2)]
    told = [process.stdout.readline().strip() for process in processes]  # both have begun
    for process in processes:
        process.terminate()
        told += process.communicate()[0].split("\n")[:-1]
    assert {line.split("-")[0] for line in told} == {"1", "2"}
    assert_true_logs(folder, told)


def test_two_recordings_of_one_name_cannot_meet(tmp_path, episode):
    first = EpisodeWriter(tmp_path / "a.mcap", episode.header, attachments={}, display=False)
    with (
        first,
        pytest.raises(StorageError, match=r"a\.mcap\.part: the file exists and is not overwritten"),
    ):
        EpisodeWriter(tmp_path / "a.mcap", episode.header, attachments={}, display=False)


@pytest.fixture
def small_files():
    """A file system that refuses more than so many bytes per file, as a full one would."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_full_disk_leaves_a_part_that_can_be_recovered(tmp_path, episode, small_files):
    write_episode(tmp_path / "whole.mcap", episode, attachments=ATTACHMENTS, display=False)
    size = (tmp_path / "whole.mcap").stat().st_size
    kept = []
    for limit in range(1000, size, 1999):
        path = tmp_path / f"{limit}.mcap"
        descriptors = len(os.listdir("/proc/self/fd"))
        small_files(limit)
        with pytest.raises(StorageError) as caught:
            write_episode(path, episode, attachments=ATTACHMENTS, display=False)
        small_files(resource.RLIM_INFINITY)
        assert "File too large; what was recorded stays in" in str(caught.value)
        assert "\n" not in str(caught.value)
        assert len(os.listdir("/proc/self/fd")) == descriptors
        assert not path.exists()
        assert path.with_name(path.name + PART).stat().st_size == limit
        recovered = outcome(recover, path.with_name(path.name + PART))
        if isinstance(recovered, FormatError):
            kept.append(0)
            continue
        kept.append(recovered.steps_kept)
        assert_prefix(read_episode(recovered.path), episode)
    assert set(kept) == {0, BLOCK - 1, 2 * BLOCK - 1, 59, 60}
    assert kept == sorted(kept)


def test_a_disk_without_any_space_says_so(episode, tmp_path):
    if os.geteuid() != 0:
        pytest.skip("mounting a small file system needs root")
    mount = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=128k", "none", str(tmp_path)],
        capture_output=True,
        check=False,
    )
    if mount.returncode:
        pytest.skip("mounting is not allowed here")
    try:
        write_episode(tmp_path / "fits.mcap", episode, attachments=ATTACHMENTS, display=False)
        with pytest.raises(StorageError, match="No space left on device"):
            write_episode(
                tmp_path / "does_not.mcap",
                episode,
                attachments={"big": bytes(2**18)},
                display=False,
            )
        parts = list(tmp_path.glob("*.part"))
        assert [path.name for path in parts] == ["does_not.mcap.part"]
        assert_same(read_episode(tmp_path / "fits.mcap"), episode)
        assert not (tmp_path / "does_not.mcap").exists()
    finally:
        subprocess.run(["umount", str(tmp_path)], check=True)


def test_a_folder_that_cannot_be_written_to(tmp_path, episode):
    if os.geteuid() == 0:
        (tmp_path / "logs").write_text("a file, not a folder")
        with pytest.raises(StorageError, match="cannot create the file: Not a directory"):
            EpisodeWriter(
                tmp_path / "logs" / "a.mcap", episode.header, attachments={}, display=False
            )
        return
    tmp_path.chmod(0o500)
    with pytest.raises(StorageError, match="cannot create the file: Permission denied"):
        EpisodeWriter(tmp_path / "a.mcap", episode.header, attachments={}, display=False)


def test_the_columns_of_an_episode_are_all_compared():
    assert set(COLUMNS) == {item.name for item in (*STEP.fields[1:], *REACH)} | {"contacts"}
    assert {item.name for item in FINAL.fields} <= set(COLUMNS) | {"step"}
