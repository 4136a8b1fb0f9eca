"""What smoothing does to our own logs, beside the paper and beside other tools; one verifier for
all.

    python -m experiments.speed.bench_smooth [--logs FOLDER] [--count 3] [--peers 1] [--plain 1]

FOLDER has noisy logs of several scenes; without it some expert logs of each are recorded first.
The verifier shares no code with the search: MuJoCo's own collisions at 16 samples per knot. A path
passes if at every sample nothing touches (10 µm), the centre of mass is over the feet with the
task's margin, joints are within their ranges (1 mrad), and the end points are exact (1 µrad).
Processor time; medians over logs with 95 % bootstrap intervals.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any

import mujoco
import numpy as np
from scipy.spatial import ConvexHull

from coordlog import api
from coordlog.episode import Array
from coordlog.kinematics.clearance import SceneChecker
from coordlog.record.recording import Recording
from coordlog.sim.replay import Log, bound_task
from coordlog.sim.tracking import run
from coordlog.smooth import metrics
from coordlog.smooth.execute import execute, follow, worse
from coordlog.smooth.knots import clean
from coordlog.smooth.metrics import PathLoad
from coordlog.smooth.recorded import smooth_motion
from coordlog.tasks.scene import sole_corner
from experiments import tables
from experiments.speed import smoothers
from experiments.stats import median_interval

OURS: dict[str, dict[str, Any]] = {
    "local, 5 mm": {"method": "local", "ends": "soft", "clearance": 0.005},
    "local": {"method": "local", "ends": "soft"},
    "local, rest ends": {"method": "local", "ends": "rest"},
    "local, 0.1 rad": {"method": "local", "ends": "soft", "max_deviation": 0.1},
    "shared": {"method": "shared", "ends": "soft"},
    "paper, proven": {"method": "paper"},
    "paper, knots": {"method": "paper", "dense": 1, "certify": False},
}
EVERYWHERE = ("local, 5 mm", "local", "paper, proven", "paper, knots")
"""Of ours, what smooths every log; the rest smooth the logs that the others do."""
DENSE = 16
COLUMNS = ("jerk", "torque", "path_torque", "deviation", "cpu")
RATIOS = (
    ("local", "paper, proven", "jerk"),
    ("local", "paper, proven", "torque"),
    ("local", "paper, proven", "path_torque"),
    ("local", "paper, proven", "cpu"),
    ("local", "paper, knots", "cpu"),
    ("local", "paper, plainly", "cpu"),
    ("local", "paper, plainly, all knots in one call", "cpu"),
    ("paper, knots", "paper, plainly", "cpu"),
)
Rows = dict[str, dict[str, Any]]


class Bench:
    """One log, and everything that is asked about it."""

    def __init__(self, path: Path) -> None:
        recording = Recording(path)
        self.episode = recording.episode
        self.log = Log.of(self.episode, recording.model, recording.initial_state)
        self.task = bound_task(self.log)
        self.time, self.q = self.episode.time, self.episode.qpos[:, self.task.qpos_index]
        self.knots, self.model = clean(self.time, self.q), recording.model
        self.checker = SceneChecker(
            self.model,
            self.task.robot,
            self.task.config,
            time=self.time,
            qpos=self.episode.qpos,
            initial=self.log.start,
        )
        self.pairs = {tuple(pair) for pair in self.checker.pairs.tolist()}
        self.data = mujoco.MjData(self.model)
        mujoco.mj_setState(
            self.model, self.data, self.log.start, mujoco.mjtState.mjSTATE_INTEGRATION
        )
        self.corners = [
            self.model.site(sole_corner(sole, i)).id
            for sole in self.task.robot.soles
            for i in range(4)
        ]
        self.mass = self.model.body_mass / self.model.body_mass.sum()
        self.load = self.loads(smoothers.through(self.time, self.q))

    def loads(self, path: Any) -> PathLoad:
        """What a path alone asks of servos and feet."""
        return PathLoad.of(path, self.checker.inverse, self.knots.unit)

    def stands(self, qpos: Array) -> str:
        """What is wrong with a configuration (n_q,); "" if nothing is."""
        model, data = self.model, self.data
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        for contact in data.contact:
            if contact.dist < -1e-5 and tuple(sorted(contact.geom.tolist())) in self.pairs:
                return "collision"
        edges = ConvexHull(data.site_xpos[self.corners, :2]).equations
        over = -(edges[:, :2] @ (self.mass @ data.xipos)[:2] + edges[:, 2]).max()
        return "" if over >= self.task.config.balance_margin - 1e-6 else "balance"

    def free(self, row: int, q: Array) -> bool:
        """Whether the action joints may stand at q while the rest is as in `row` of the log."""
        if (q < self.task.limits[:, 0] - 1e-3).any() or (q > self.task.limits[:, 1] + 1e-3).any():
            return False
        qpos = self.episode.qpos[row].copy()
        qpos[self.task.qpos_index] = q
        return not self.stands(qpos)

    def verify(self, path: Any) -> str:
        """Why a path does not pass; "" if it does."""
        samples = np.linspace(path.time[0], path.time[-1], DENSE * (len(self.time) - 1) + 1)
        q = path(samples)
        if max(abs(q[0] - self.q[0]).max(), abs(q[-1] - self.q[-1]).max()) > 1e-6:
            return "ends"
        if (q < self.task.limits[:, 0] - 1e-3).any() or (q > self.task.limits[:, 1] + 1e-3).any():
            return "limits"
        columns = [np.interp(samples, self.time, column) for column in self.episode.qpos.T]
        qpos = np.stack(columns, axis=1)
        qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
        qpos[:, self.task.qpos_index] = q
        return next((fault for fault in map(self.stands, qpos) if fault), "")

    def figures(self, path: Any, *, cpu: float, torque: float | None, worse: str) -> dict[str, Any]:
        """A row of the table, relative to the log's own."""
        dt = self.knots.unit
        q = path(np.linspace(path.time[0], path.time[-1], len(self.time)))
        return {
            "fault": self.verify(path),
            "executed": worse,
            "jerk": metrics.jerk(q, dt) / metrics.jerk(self.q, dt),
            "torque": torque,
            "path_torque": self.loads(path).rate / self.load.rate,
            "deviation": float(abs(path(self.time) - self.q).max()),
            "cpu": cpu,
        }


def measure(bench: Bench, *, with_peers: bool, with_plain: bool) -> Rows:
    """Rows of one log: method → figures."""
    log, episode, period = bench.log, bench.episode, bench.task.config.control_period
    again = run(log, lambda step, _: log.action[step], steps=len(log.action))
    torque = metrics.torque_rate(again.torque, period)
    raw = smoothers.through(bench.time, bench.q)
    rows: Rows = {"the log": bench.figures(raw, cpu=0.0, torque=1.0, worse="")}
    results = {}
    for name, how in OURS.items():
        if name not in EVERYWHERE and not with_peers:
            continue
        settings = {key: value for key, value in how.items() if key != "ends"}
        began = process_time()
        result, _ = smooth_motion(
            log, bench.time, episode.qpos, ends=how.get("ends", "natural"), settings=settings
        )
        cpu = process_time() - began
        results[name], ran = result, execute(log, result, episode)
        rows[name] = bench.figures(
            result.spline,
            cpu=cpu,
            torque=ran.smoothed.rate / torque if ran.smoothed else 1.0,
            worse=ran.reason if ran.run is None else "",
        ) | {"status": ran.status, "certified": result.certified}
    for name, call in others(bench, with_peers=with_peers, with_plain=with_plain).items():
        began = process_time()
        found = call()
        cpu = process_time() - began
        if name.startswith("paper"):
            found, ps = found
            rows["paper, knots"]["p_away"] = float(abs(results["paper, knots"].p - ps).max())
        as_ours = replace(results["local, 5 mm"], spline=found)
        drove = follow(log, as_ours, bench.q, arrives=episode.result.success)
        rows[name] = bench.figures(
            found,
            cpu=cpu,
            torque=metrics.torque_rate(drove.torque, period) / torque,
            worse=worse(drove, episode),
        )
    return rows


def others(bench: Bench, *, with_peers: bool, with_plain: bool) -> dict[str, Callable[[], Any]]:
    """Other people's ways, ready to be called."""
    time, q, middle = bench.time, bench.q, len(bench.q) // 2
    calls: dict[str, Callable[[], Any]] = {}
    if with_peers:
        calls = {
            "EMA 0.25": lambda: smoothers.exponential(time, q),
            "Savitzky-Golay 21, 3": lambda: smoothers.savitzky_golay(time, q),
            "Butterworth 3 Hz": lambda: smoothers.butterworth(time, q),
            "scipy GCV": lambda: smoothers.cross_validated(time, q),
            "OMPL simplify + min-jerk": lambda: smoothers.ompl_simplify(
                time, q, bench.task.limits, lambda at: bench.free(middle, at)
            ),
        }
    if with_plain:
        calls["paper, plainly"] = lambda: smoothers.paper_plainly(
            time, q, lambda path: all(bench.free(i, at) for i, at in enumerate(path))
        )
        calls["paper, plainly, all knots in one call"] = lambda: smoothers.paper_plainly(
            time, q, lambda path: bool(bench.checker.check(time, path, 0.0).free.all())
        )
    return calls


def show(every: Sequence[Rows]) -> None:
    """The table, and what `local` is better by, log by log."""
    print(f"\n{'method':40} {'n':>3} {'pass':>4} {'exec':>4}", *(f"{c:>24}" for c in COLUMNS))
    for name in dict.fromkeys(name for rows in every for name in rows):
        rows = [each[name] for each in every if name in each]
        good = [sum(not row[key] for row in rows) for key in ("fault", "executed")]
        texts = [text([row[key] for row in rows if row[key] is not None]) for key in COLUMNS]
        print(
            f"{name:40} {len(rows):3} {good[0]:4} {good[1]:4}", *(f"{each:>24}" for each in texts)
        )
    for ours, other, key in RATIOS:
        both = [rows for rows in every if ours in rows and other in rows]
        if both:
            found = text([rows[other][key] / rows[ours][key] for rows in both])
            print(f"{key} of {other} / {ours}: {found}, n = {len(both)}")
    away = [rows["paper, knots"].get("p_away", 0.0) for rows in every]
    print(f"largest difference of p between `paper` and the plain version: {max(away):.1e}")


def text(values: Sequence[float]) -> str:
    """Median and interval."""
    found = median_interval(values)
    return "-" if found is None else "{median:.4g} ({low:.3g}-{high:.3g})".format(**found)


def main() -> None:
    """Measure every log, and print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--logs", type=Path)
    parser.add_argument("--count", type=int, default=3, help="logs of each scene")
    parser.add_argument("--peers", type=int, default=1, help="of them, for the other tools")
    parser.add_argument("--plain", type=int, default=1, help="of them, for the paper plainly")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    found: list[Rows] = []
    seen: dict[str, int] = {}
    with tempfile.TemporaryDirectory() as name:
        for scene in tables.SCENES if given.logs is None else ():
            api.record(scene, episodes=given.count, noise=0.15, out=name)
        for path in api.open(given.logs or name).paths:
            bench = Bench(path)
            scene = bench.episode.header.episode["scene"]
            at = seen[scene] = seen.get(scene, -1) + 1
            if at < given.count:
                asked = {"with_peers": at < given.peers, "with_plain": at < given.plain}
                found.append(measure(bench, **asked))
                print(f"{len(found)} logs", file=sys.stderr, flush=True)
    if given.json:
        given.json.write_text(json.dumps(found, indent=1))
    show(found)


if __name__ == "__main__":
    main()
