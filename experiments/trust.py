"""Harm files in every way we know, run every command on them, and count: how many harms were tried,
how many were noticed, how many changed a value without a word.

    python -m experiments.trust            writes the table of docs/trust.md anew (minutes)

The harms are drawn from a seed. A test of the suite draws a few of them; this draws many.
"""

from __future__ import annotations

import argparse
import json
import shutil
import struct
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from typer.testing import CliRunner

from coordlog import cli
from coordlog.episode import Episode, Header
from coordlog.errors import EXIT_INTERRUPTED, CoordlogError
from coordlog.record import writer
from coordlog.record.metadata import encode_header
from coordlog.record.reader import read_attachments, read_episode
from coordlog.record.writer import write_episode
from coordlog.verify.levels import check_files

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "trust.md"
BEGIN, END = "<!-- trust: begin -->", "<!-- trust: end -->"
ODD: tuple[str, ...] = (
    *("null", "5", "-1", "1e999", "NaN", "true", '""', '"text"', "[]", "{}", "[[]]", '[{"a":1}]'),
    *(str(1 << 70), "-1e308", '{"name":null}', '["[red]","\\u001b[31m"]', "not json", ""),
    "[" * 5000 + "]" * 5000,
)
"""Values that no key of a record expects, as they stand in a file."""


@dataclass
class Count:
    """What became of the harms of one kind."""

    tried: int = 0
    noticed: int = 0
    """an error of ours, or a finding of `check`"""
    silent: int = 0
    """a decoded value changed, and nobody said a word"""
    unforeseen: list[str] = field(default_factory=list)
    """errors that nobody raised on purpose: tracebacks"""


def command(*words: object) -> tuple[int, str, BaseException | None]:
    """Run a command in this process: exit code, what it said, and an error nobody foresaw."""
    done = CliRunner().invoke(cli.app, [str(word) for word in words])
    error = done.exception
    if isinstance(error, CoordlogError):
        return error.exit_code, f"{done.output}{error}", None
    if isinstance(error, KeyboardInterrupt) or done.exit_code == EXIT_INTERRUPTED:
        raise KeyboardInterrupt  # a command takes it for its own end
    if error is None or isinstance(error, SystemExit):
        return done.exit_code, done.output, None
    return 1, done.output, error


def flipped(data: bytes, rng: np.random.Generator) -> bytes:
    """One bit changed."""
    at, harmed = int(rng.integers(len(data))), bytearray(data)
    harmed[at] ^= 1 << int(rng.integers(8))
    return bytes(harmed)


def cut(data: bytes, rng: np.random.Generator) -> bytes:
    """The end missing."""
    return data[: int(rng.integers(len(data)))]


def smeared(data: bytes, rng: np.random.Generator) -> bytes:
    """A stretch overwritten with chance, with zeros, or moved."""
    start, size = int(rng.integers(len(data))), int(rng.integers(1, 400))
    stretch = (rng.bytes(size), bytes(size), data[:size], b"")[int(rng.integers(4))]
    return data[:start] + stretch + data[start + size :]


def same(one: Episode, other: Episode) -> bool:
    """Whether two episodes hold the same values, header and result included."""
    return (one.header, one.result) == (other.header, other.result) and _arrays(one) == _arrays(
        other
    )


def _arrays(episode: Episode) -> dict[str, bytes]:
    """Every array of an episode, by name."""
    found = {**episode.columns, "contacts": episode.contacts}
    found |= {f"inputs/{name}": values for name, values in episode.inputs.items()}
    if episode.path is not None:
        path = episode.path
        found |= {"time/": path.time, "position/": path.position, "velocity/": path.velocity}
    return {name: np.ascontiguousarray(values).tobytes() for name, values in found.items()}


def harm_bytes(
    source: Path,
    folder: Path,
    how: Callable[[bytes, np.random.Generator], bytes],
    *,
    count: int,
    seed: int,
    level: str = "",
) -> Count:
    """Harm the bytes of one episode again and again, and read or check it.

    Args:
        source: The episode.
        folder: Where harmed copies are written.
        how: The harm.
        count: How many to draw.
        seed: Of the draws.
        level: Ask `check` about each, at this level; otherwise open it.
    """
    rng, found, whole = np.random.default_rng(seed), Count(), source.read_bytes()
    wanted, path = read_episode(source), folder / "harmed.mcap"
    attached = read_attachments(source)
    for _ in range(count):
        path.write_bytes(how(whole, rng))
        found.tried += 1
        try:
            if level and check_files([path], level=level).findings:
                found.noticed += 1
            elif not same(read_episode(path), wanted) or read_attachments(path) != attached:
                found.silent += 1
        except CoordlogError:
            found.noticed += 1
        except Exception as error:  # noqa: BLE001 - it is what is counted
            found.unforeseen.append(f"{how.__name__}: {type(error).__name__}: {error}")
    return found


def forged(
    header: Header, *, rng: np.random.Generator, said: list[str]
) -> dict[str, dict[str, str]]:
    """The records of a header, one value of which is odd or missing; which one is added to `said`."""
    records = {name: dict(values) for name, values in encode_header(header).items()}
    name = str(rng.choice(sorted(records)))
    key = str(rng.choice(sorted(records[name]) or ["new"]))
    odd = ODD[int(rng.integers(len(ODD)))]
    inner = records[name].get(key, "")
    if rng.random() < 0.1:
        records[name].pop(key, None)
    elif rng.random() < 0.6 and inner.startswith("{"):
        values = json.loads(inner)
        part = str(rng.choice(sorted(values) or ["new"]))
        try:
            values[part] = json.loads(odd)
        except (ValueError, RecursionError):
            values.pop(part, None)
        records[name][key] = json.dumps(values)
        key = f"{key}.{part}"
    else:
        records[name][key] = odd
    said.append(f"{name} {key} = {odd[:20]}")
    return records


def harm_metadata(
    source: Path, folder: Path, *, count: int, seed: int, commands: tuple[tuple[str, ...], ...]
) -> Count:
    """Write the episode with odd metadata, every CRC right, and run commands on it.

    In the words of a command FILE stands for it, and OUT for a folder that is not there.
    """
    rng, found = np.random.default_rng(seed), Count()
    episode, attached = read_episode(source), read_attachments(source)
    path = folder / "forged.mcap"
    for _ in range(count):
        path.unlink(missing_ok=True)
        said: list[str] = []
        with (
            patch.object(writer, "encode_header", partial(forged, rng=rng, said=said)),
            patch.object(writer, "require_readable", lambda _: None),
        ):
            write_episode(path, episode, attachments=attached, display=False)
        what = said[0]
        words = commands[int(rng.integers(len(commands)))]
        shutil.rmtree(folder / "out", ignore_errors=True)
        (folder / "out.mcap").unlink(missing_ok=True)
        out = folder / "out"
        code, _, error = command(
            *(word.replace("FILE", str(path)).replace("OUT", str(out)) for word in words)
        )
        found.tried += 1
        found.noticed += code in (1, 2, 3)
        if error is not None:
            found.unforeseen.append(f"{words[0]}: {what}: {type(error).__name__}: {error}")
    return found


def odd_policies(policy: Path, rng: np.random.Generator) -> Iterator[tuple[str, bytes]]:
    """Policy files that are none, without end: what is odd about each, and its bytes."""
    data = policy.read_bytes()
    (size,) = struct.unpack("<Q", data[:8])
    head, body = json.loads(data[8 : 8 + size]), data[8 + size :]
    while True:
        made, what = json.loads(json.dumps(head)), int(rng.integers(8))
        name = str(rng.choice([key for key in made if key != "__metadata__"]))
        meta = json.loads(made["__metadata__"]["meta"])
        if what == 0:
            made[name]["dtype"] = str(rng.choice(["BF16", "F16", "I64", "BOOL", "F8_E4M3", "X"]))
        elif what == 1:
            made[name]["shape"] = json.loads(ODD[int(rng.integers(12))].replace("1e999", "9"))
        elif what == 2:
            made[name]["shape"] = made[name]["shape"][::-1]
        elif what == 3:
            made["renamed"] = made.pop(name)
        elif what == 4:
            made["__metadata__"]["meta"] = ODD[int(rng.integers(len(ODD)))]
        elif what == 5:
            meta[str(rng.choice(sorted(meta)))] = _odd(rng)
        elif what == 6:
            meta["env"][str(rng.choice(sorted(meta["env"])))] = _odd(rng)
        else:
            part = str(rng.choice(["config", "reward"]))
            meta["env"][part][str(rng.choice(sorted(meta["env"][part])))] = _odd(rng)
        if what >= 5:
            made["__metadata__"]["meta"] = json.dumps(meta)
        text = json.dumps(made).encode()
        yield f"policy of kind {what}", struct.pack("<Q", len(text)) + text + body


def _odd(rng: np.random.Generator) -> Any:
    text = ODD[int(rng.integers(len(ODD) - 2))]
    try:
        return json.loads(text)
    except ValueError:
        return text


def harm_policies(policy: Path, folder: Path, *, count: int, seed: int) -> Count:
    """Record with policy files that are odd."""
    found, path = Count(), folder / "odd.safetensors"
    made = odd_policies(policy, np.random.default_rng(seed))
    for _ in range(count):
        what, content = next(made)
        path.write_bytes(content)
        shutil.rmtree(folder / "out", ignore_errors=True)
        words = ("record", "--policy", path, "--episodes", "1", "--envs", "1", "--threads", "1")
        config = folder / "short.toml"
        config.write_text("[env]\nmax_steps = 2\n")
        code, _, error = command(*words, "--config", config, "--out", folder / "out")
        found.tried += 1
        found.noticed += code in (1, 2, 3)
        if error is not None:
            found.unforeseen.append(f"{what}: {type(error).__name__}: {error}")
    return found


TOML = (
    *(
        "",
        "env = 5",
        "env = []",
        "[env]\nmax_steps = 'a'",
        "[env]\ncontrol_period = 1e9",
        "[[env]]",
    ),
    *("[env]\ncontrol_period = nan", "[env]\nlocked = [1]", "[reward]\nkappa = inf", "\0", "[x"),
    *(
        "[env]\nspeed = {}",
        "[reward]\nn1 = []",
        "[env.deep.deep]\na = 1",
        "loop = 3",
        "[loop]\na=1",
    ),
    *(
        "[loop]\nupdates = 'x'",
        "[network]\nhidden = 3",
        "[learner]\ngamma = 9",
        "a = " + "[" * 5000,
    ),
    *("[env]\nmax_steps = 99999999999999999999999", "[env]\nstate_extras = 'com'", "\ufeff[env]"),
)
"""Configuration files that are odd."""


def harm_configurations(folder: Path) -> Count:
    """Record and train with odd configuration files."""
    found, path = Count(), folder / "odd.toml"
    for index, text in enumerate(TOML):
        path.write_text(text, encoding="utf-8")
        shutil.rmtree(folder / "out", ignore_errors=True)
        if index % 2:
            words: tuple[object, ...] = ("record", "--scene", "planar", "--episodes", "1")
            words += ("--policy", "random", "--envs", "1", "--threads", "1")
        else:
            words = (
                "train",
                "--scene",
                "planar",
                "--steps",
                "1",
                "--envs",
                "1",
                "--eval-every",
                "0",
            )
        code, _, error = command(*words, "--config", path, "--out", folder / "out")
        found.tried += 1
        found.noticed += code in (1, 2, 3)
        if error is not None:
            found.unforeseen.append(f"{text[:40]!r}: {type(error).__name__}: {error}")
    return found


RUN = {"scene": "free", "mode": "live", "seed": 0, "settings": {"loop": {"seed": 0}}, "env": {}}
ROW = {"kind": "evaluation", "update": 5, "step": 100, "episodes": 3, "episodes_total": 9}
ROW |= {"score": 1.0, "success": 0.5, "clean": 0.5}


def harm_runs(folder: Path, *, count: int, seed: int) -> Count:
    """Draw the curves of run folders whose files are odd."""
    rng, found, run = np.random.default_rng(seed), Count(), folder / "run"
    run.mkdir(exist_ok=True)
    for _ in range(count):
        said, row = dict(RUN), dict(ROW)
        harmed = said if rng.random() < 0.5 else row
        harmed[str(rng.choice(sorted(harmed)))] = _odd(rng)
        (run / "run.json").write_text(json.dumps(said))
        lines = [json.dumps({**ROW, "update": at}) for at in (1, 2)]
        (run / "metrics.jsonl").write_text("\n".join([*lines, json.dumps(row), ""]))
        if rng.random() < 0.2:
            broken = run / str(rng.choice(["run.json", "metrics.jsonl"]))
            broken.write_bytes(smeared(broken.read_bytes(), rng))
        code, _, error = command("plot", run, "--out", folder / "curves.svg", "--force")
        found.tried += 1
        found.noticed += code in (1, 2, 3)
        if error is not None:
            found.unforeseen.append(f"plot: {said} {row}: {type(error).__name__}: {error}"[:300])
    return found


EVERY = (
    ("info", "FILE"),
    ("check", "--jobs", "1", "FILE"),
    ("view", "FILE", "--no-open", "--alone"),
    ("plot", "FILE", "--out", "OUT/a.svg"),
    ("recover", "FILE", "--out", "OUT.mcap"),
    ("smooth", "FILE", "--out", "OUT", "--jobs", "1"),
    (
        "train",
        "--from",
        "FILE",
        "--updates",
        "1",
        "--eval-every",
        "0",
        "--jobs",
        "1",
        "--out",
        "OUT",
    ),
)
"""Commands that take an episode file."""


def recorded(folder: Path) -> Path:
    """A small episode of today's format."""
    out = folder / "recorded"
    words = ("record", "--scene", "planar", "--episodes", "1", "--envs", "1", "--threads", "1")
    code, said, error = command(*words, "--seed", "14", "--out", out)
    assert code == 0, (said, error)
    return next(out.glob("*.mcap"))


def main() -> None:
    """Draw many harms, and write what became of them into the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=2000, help="harms of a kind of bytes")
    count = parser.parse_args().count
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        source = recorded(folder)
        rows = {}
        for how, what in ((flipped, "one bit flipped"), (cut, "cut off"), (smeared, "overwritten")):
            for level in ("", "file", "content"):
                where = f"`check --level {level}`" if level else "`open`"
                harmed = harm_bytes(source, folder, how, count=count, seed=1, level=level)
                rows[f"episode file, {what}, {where}"] = harmed
        rows["metadata of an episode, odd, every command"] = harm_metadata(
            source, folder, count=count // 5, seed=2, commands=EVERY
        )
        policy = ROOT / "coordlog" / "policies" / "free.safetensors"
        rows["policy file, odd, `record`"] = harm_policies(
            policy, folder, count=count // 10, seed=3
        )
        rows["configuration, odd, `record` and `train`"] = harm_configurations(folder)
        rows["run folder, odd, `plot`"] = harm_runs(folder, count=count // 10, seed=4)
    lines = ["| what was harmed | tried | noticed | silent | tracebacks |", "|---|---|---|---|---|"]
    for what, found in rows.items():
        crashes = len(found.unforeseen)
        lines.append(f"| {what} | {found.tried} | {found.noticed} | {found.silent} | {crashes} |")
        for said, times in Counter(found.unforeseen).most_common(20):
            print(f"{times} × {said[:200]}")
    text = PAGE.read_text(encoding="utf-8")
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    table = "\n".join(lines)
    PAGE.write_text(f"{before}{BEGIN}\n{table}\n{END}{after}", encoding="utf-8")
    print(table)


if __name__ == "__main__":
    main()
