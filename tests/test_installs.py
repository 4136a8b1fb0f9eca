"""What each install does: extras that are missing are missed only by what needs them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

EXTRAS = {
    "gym": ("gymnasium",),
    "train": ("torch", "safetensors", "duckdb"),
    "view": ("rerun", "rerun_cli", "matplotlib", "PIL"),
    "tensorboard": ("tensorboard",),
    "exchange": ("rosbags", "h5py", "av"),
    "cloud": ("obstore",),
    "cluster": ("ray",),
}
"""The libraries that an extra brings, by its name."""

BLOCKED = """
import sys


class Missing:  # finds nothing of what an extra would have brought
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {names!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)


sys.meta_path.insert(0, Missing())
sys.argv = ["coordlog", *{arguments!r}]
from coordlog.cli import main
main()
"""


def coordlog(
    *arguments: object, without: tuple[str, ...], cwd: Path
) -> subprocess.CompletedProcess[str]:
    """Run the command line in a process in which the libraries of some extras cannot be imported."""
    names = [library for extra in without for library in EXTRAS[extra]]
    code = BLOCKED.format(names=names, arguments=[str(each) for each in arguments])
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=cwd, check=False
    )


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two short episodes, recorded with no extra at all."""
    folder = tmp_path_factory.mktemp("plain")
    done = coordlog(
        *("record", "--scene", "planar", "--episodes", 2, "--out", "logs"),
        without=tuple(EXTRAS),
        cwd=folder,
    )
    assert done.returncode == 0, done.stderr
    return folder / "logs"


@pytest.mark.parametrize(
    "command", [("check", "logs"), ("info", "logs"), ("smooth", "logs", "--out", "smoothed")]
)
def test_the_plain_install_records_checks_and_smooths(logs: Path, command: tuple[str, ...]) -> None:
    done = coordlog(*command, without=tuple(EXTRAS), cwd=logs.parent)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("command", "extra"),
    [
        (("train", "--from", "logs", "--updates", "1"), "train"),
        (("view", "logs", "--save", "x.rrd"), "view"),
        (("plot", "logs"), "view"),
    ],
)
def test_what_needs_an_extra_says_which_one(
    logs: Path, command: tuple[str, ...], extra: str
) -> None:
    done = coordlog(*command, without=tuple(EXTRAS), cwd=logs.parent)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert f"coordlog[{extra}]" in done.stderr


def test_learning_needs_no_viewer(logs: Path) -> None:
    others = tuple(extra for extra in EXTRAS if extra != "train")
    command = ("train", "--from", "logs", "--updates", "2", "--eval-every", "0", "--out", "run")
    done = coordlog(*command, without=others, cwd=logs.parent)
    assert done.returncode == 0, done.stderr
