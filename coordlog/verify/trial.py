"""Can the models that some files carry be compiled and stepped, in bounded time and memory?

Anybody's model is tried before it is replayed: a plain one right here, any other in a process of
its own whose time and memory the kernel limits, and that may crash without taking the check along.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import resource
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from coordlog.episode import INITIAL_STATE, MODEL_XML
from coordlog.errors import CoordlogError
from coordlog.mjcf import ASSETS, is_plain_model, load_attached
from coordlog.record.opening import File
from coordlog.record.reader import read_attachments, read_summary
from coordlog.sim.physics import STATE
from coordlog.verify.finding import Finding

SECONDS = 8
"""Processor time that compiling a model and a few steps may take [s]."""
PATIENCE = 20
"""Seconds that may pass for each of them on a machine with other work."""
MEMORY = 6 << 30
"""Address space of the process that tries a model [bytes]."""
BUDGET = 60.0
"""Time that replaying one log may take [s], besides SLOWER times what it lasts itself."""
SLOWER = 30.0
STEPS = 4
_tried_before: dict[str, tuple[float, float] | str] = {}
COMMAND = ["-m", "coordlog.verify.trial"]


def runnable(paths: Sequence[File]) -> list[Finding]:
    """Findings for the files whose models cannot be simulated within the limits."""
    found: list[Finding] = []
    for path in paths:
        try:
            reason = _tried(path)
        except CoordlogError as error:
            reason = str(error)
        if reason:
            wanted = "one that can be simulated"
            found.append(Finding(os.fspath(path), "replay", None, "model", wanted, reason))
    return found


def _tried(path: File) -> str:
    """Why the model of a file cannot be simulated; "" if it can."""
    attached = read_attachments(path)
    if is_plain_model(attached.get(MODEL_XML)):
        return ""  # no more than the replay itself will do
    summary = read_summary(path)
    period = min(float(summary.header.episode.get("control_period", 0.0)), 1.0)
    duration = summary.result.length * period
    carried = {
        name: data
        for name, data in attached.items()
        if name in (MODEL_XML, INITIAL_STATE) or name.startswith(ASSETS)
    }
    model = hashlib.sha256(attached[MODEL_XML]).hexdigest()  # which names its assets by their own
    if model not in _tried_before:
        _tried_before[model] = _in_a_child(carried)
    answer = _tried_before[model]
    if isinstance(answer, str):
        return answer
    timestep, cost = answer
    needed = duration / timestep * cost
    if needed > BUDGET + SLOWER * duration:
        return f"one that takes {needed:,.0f} s to replay, at {cost:.2g} s per physics step"
    return ""


def _in_a_child(attached: Mapping[str, bytes]) -> tuple[float, float] | str:
    """Timestep and cost of a step [s], or why there is none."""
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            [sys.executable, *COMMAND],
            input=pickle.dumps(dict(attached)),
            capture_output=True,
            timeout=PATIENCE * SECONDS,
            env=environment,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"one that was still busy after {PATIENCE * SECONDS} s"
    said = done.stdout.decode("utf-8", "replace").strip()
    if done.returncode == 0:
        timestep, cost = said.split()
        return float(timestep), float(cost)
    if done.returncode in (-24, -9):  # SIGXCPU, SIGKILL
        return f"one that takes more than {SECONDS} s of processor time to compile and step"
    if done.returncode < 0:
        return f"one that crashes MuJoCo (signal {-done.returncode})"
    return said or f"one that MuJoCo gives up on (exit code {done.returncode})"


def main() -> None:
    """Try the model on standard input, within limits."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS + 1))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    attached: dict[str, bytes] = pickle.load(sys.stdin.buffer)  # from our own parent process
    try:
        model = load_attached(attached)
        data = mujoco.MjData(model)
        start = np.frombuffer(attached.get(INITIAL_STATE, b""))
        if start.shape == (mujoco.mj_stateSize(model, STATE),):
            mujoco.mj_setState(model, data, start, STATE)
        began = time.process_time()
        mujoco.mj_step(model, data, nstep=STEPS)
        cost = (time.process_time() - began) / STEPS
    except (CoordlogError, MemoryError, mujoco.FatalError, ValueError) as error:
        reason = str(error) or f"one that needs more than {MEMORY >> 30} GiB of memory"
        sys.stdout.write(reason.splitlines()[0])
        sys.exit(1)
    sys.stdout.write(f"{model.opt.timestep!r} {cost!r}")


if __name__ == "__main__":
    main()
