"""What smoothing does to our own logs, beside the paper and beside other tools; one verifier for
all.

    coordlog record --scene S --noise 0.15 --episodes 25 --out LOGS/S          (for each of the four
    scenes) python experiments/speed/bench_smooth_logs.py [LOGS] [--peers 5] [--plain 2] [--json
    FILE]

The verifier shares no code with the search: kinematics and distances in plain NumPy
(tests/plain.py), 16 samples per knot. A path passes if at every sample nothing touches (10 µm), the
centre of mass is over the feet with the task's margin, joints are within their ranges (1 mrad), and
the end points are exact (1 µrad). Processor time of one thread (set OMP_NUM_THREADS=1). Medians
with 95 % bootstrap intervals.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from time import process_time

import mujoco
import numpy as np
import peers
from scipy.spatial import ConvexHull

sys.path.insert(0, str(Path(__file__).parents[2]))

from coordlog.episode import INITIAL_STATE, MODEL_XML
from coordlog.kinematics.clearance import SceneChecker
from coordlog.mjcf import load_model
from coordlog.record.dataset import find_files
from coordlog.record.reader import read_attachments, read_episode
from coordlog.sim.replay import Log, bound_task
from coordlog.sim.tracking import run
from coordlog.smooth import metrics
from coordlog.smooth.execute import execute, follow, worse
from coordlog.smooth.knots import clean
from coordlog.smooth.limits import Limits
from coordlog.smooth.lineage import FASTER, fastest_of
from coordlog.smooth.metrics import PathLoad
from coordlog.smooth.smoother import smooth
from coordlog.tasks.scene import sole_corner
from tests.plain import BOX, Plain, between, rotate, to_shape

OURS = {
    "local, 5 mm": {"method": "local", "ends": "soft", "clearance": 0.005},
    "local": {"method": "local", "ends": "soft"},
    "local, rest ends": {"method": "local", "ends": "rest"},
    "local, 0.1 rad": {"method": "local", "ends": "soft", "max_deviation": 0.1},
    "shared": {"method": "shared", "ends": "soft"},
    "paper, proven": {"method": "paper"},
    "paper, knots": {"method": "paper", "dense": 1, "certify": False},
}
EVERYWHERE = ("local, 5 mm", "local", "paper, proven", "paper, knots")
"""Of ours, what smooths every log; the rest smooth the logs that the peers do."""
DENSE = 16


class Bench:
    """One log, and everything that is asked about it."""

    def __init__(self, path):
        self.episode, attachments = read_episode(path), read_attachments(path)
        model = load_model(attachments[MODEL_XML], None)
        self.log = Log(
            self.episode.header,
            model,
            np.frombuffer(attachments[INITIAL_STATE]),
            self.episode.action,
        )
        self.task = bound_task(self.log)
        self.time, self.q = self.episode.time, self.episode.qpos[:, self.task.qpos_index]
        self.knots = clean(self.time, self.q)
        self.data = mujoco.MjData(model)
        mujoco.mj_setState(model, self.data, self.log.start, mujoco.mjtState.mjSTATE_INTEGRATION)
        self.plain = Plain(model, mocap_pos=self.data.mocap_pos.copy())
        self.corners = [
            model.site(sole_corner(sole, i)) for sole in self.task.robot.soles for i in range(4)
        ]
        began = process_time()
        self.checker = self.check()
        self.building = process_time() - began
        self.load = PathLoad.of(
            peers.through(self.time, self.q), self.checker.inverse, self.knots.unit
        )

    def check(self):
        log = self.log
        return SceneChecker(
            log.model,
            self.task.robot,
            self.task.config,
            time=self.time,
            qpos=self.episode.qpos,
            initial=log.start,
        )

    def whole(self, time, q):
        """The log's base and other joints at these times, with the action joints at q."""
        qpos = np.stack(
            [np.interp(time, self.time, column) for column in self.episode.qpos.T], axis=1
        )
        qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
        qpos[:, self.task.qpos_index] = q
        return qpos

    def verify(self, spline):
        """Why a path does not pass; "" if it does."""
        samples = np.linspace(spline.time[0], spline.time[-1], DENSE * (len(self.time) - 1) + 1)
        q, span = spline(samples), spline.time[-1] - spline.time[0]
        qpos = self.whole((samples - spline.time[0]) / span * self.time[-1], q)
        if max(abs(q[0] - self.q[0]).max(), abs(q[-1] - self.q[-1]).max()) > 1e-6:
            return "ends"
        if (q < self.task.limits[:, 0] - 1e-3).any() or (q > self.task.limits[:, 1] + 1e-3).any():
            return "limits"
        if self.deepest(qpos) > 1e-5:
            return "collision"
        return "" if self.margin(qpos) >= self.task.config.balance_margin - 1e-6 else "balance"

    def deepest(self, qpos):
        """Deepest penetration of any pair at any sample [m]."""
        model, worst = self.log.model, 0.0
        centre, axes = self.plain.geoms(qpos)
        for a, b in self.checker.pairs:
            if model.geom_type[a] == BOX and model.geom_type[b] != BOX:
                a, b = b, a
            bound = (
                to_shape(
                    centre[:, a], model.geom_type[b], model.geom_size[b], centre[:, b], axes[:, b]
                )
                - model.geom_rbound[a]
            )
            near = np.flatnonzero(bound < 0.0)
            if not len(near):
                continue
            one, other = (centre[near, a], axes[near, a]), (centre[near, b], axes[near, b])
            if model.geom_type[a] == BOX and model.geom_type[b] == BOX:
                apart = separation(model.geom_size[a], one, model.geom_size[b], other)
            else:
                apart = between(
                    model.geom_type[a],
                    model.geom_size[a],
                    one,
                    model.geom_type[b],
                    model.geom_size[b],
                    other,
                )
            worst = max(worst, float(-apart.min()))
        return worst

    def margin(self, qpos):
        """Least distance of the centre of mass to the edge of the hull of all sole corners [m]."""
        com, (pos, quat) = self.plain.com(qpos)[:, :2], self.plain.bodies(qpos)
        corners = np.stack(
            [
                pos[:, s.bodyid[0]] + rotate(quat[:, s.bodyid[0]], np.tile(s.pos, (len(qpos), 1)))
                for s in self.corners
            ],
            axis=1,
        )
        hulls = (ConvexHull(each[:, :2]).equations for each in corners)
        return min(
            float(-(edges[:, :2] @ point + edges[:, 2]).max())
            for edges, point in zip(hulls, com, strict=True)
        )

    def figures(self, spline):
        """Ratios to the log's own.

        A path of another duration is sampled at the log's period too.
        """
        n = max(4, round((spline.time[-1] - spline.time[0]) / self.knots.unit) + 1)
        q, dt = (
            spline(np.linspace(spline.time[0], spline.time[-1], n)),
            (spline.time[-1] - spline.time[0]) / (n - 1),
        )
        return {
            "jerk": metrics.jerk(q, dt) / metrics.jerk(self.q, self.knots.unit),
            "acceleration": metrics.acceleration(q, dt)
            / metrics.acceleration(self.q, self.knots.unit),
            "path": metrics.path_length(q) / metrics.path_length(self.q),
            "sparc": metrics.sparc(metrics.speed(q, dt), dt),
            "deviation": float(abs(spline(self.time) - self.q).max())
            if n == len(self.time)
            else None,
        } | self.effort(spline)

    def effort(self, spline):
        """What the path alone asks of servos and feet, next to the log.

        Nothing for a path of another duration.
        """
        if abs(spline.time[-1] - self.time[-1]) > 1e-9:
            return {"path_torque": None, "floor": None, "zmp": None}
        load = PathLoad.of(spline, self.checker.inverse, self.knots.unit)
        return {
            "path_torque": load.rate / self.load.rate,
            "floor": load.floor / self.load.rate,
            "zmp": load.balance,
        }


def separation(half_a, a, half_b, b):
    """Separating axis test of boxes (n of each): the largest gap over 15 axes, negative where they
    overlap.
    """
    axes = [a[1][:, :, i] for i in range(3)] + [b[1][:, :, i] for i in range(3)]
    axes += [np.cross(x, y) for x in axes[:3] for y in axes[3:]]
    gaps = []
    for axis in axes:
        size = np.linalg.norm(axis, axis=1, keepdims=True)
        axis = np.where(size > 1e-9, axis / np.maximum(size, 1e-9), a[1][:, :, 0])
        reach = sum(
            (abs(np.einsum("nij,ni->nj", frame, axis)) * half).sum(axis=1)
            for frame, half in ((a[1], half_a), (b[1], half_b))
        )
        gaps.append(abs(((a[0] - b[0]) * axis).sum(axis=1)) - reach)
    return np.max(gaps, axis=0)


def limits_of(bench):
    """The limits that `coordlog smooth` sets."""
    fastest = fastest_of(bench.time, bench.q)
    return Limits(
        bench.task.limits[:, 0],
        bench.task.limits[:, 1],
        speed=FASTER * np.maximum(bench.task.speeds, fastest),
        nominal_speed=bench.task.speeds,
    )


def measure(bench, *, with_peers, with_plain):
    """Rows of one log: method → figures."""
    rows = {}
    period, log, episode = bench.task.config.control_period, bench.log, bench.episode
    again = run(log, lambda step, _: log.action[step], steps=len(log.action))
    torque = metrics.torque_rate(again.torque, period)
    raw = peers.through(bench.time, bench.q)
    rows["log"] = bench.figures(raw) | {
        "jerk": 1.0,
        "acceleration": 1.0,
        "torque": 1.0,
        "cpu": 0.0,
        "fault": bench.verify(raw),
        "executed": "",
    }
    results = {}
    for name, options in OURS.items():
        if name not in EVERYWHERE and not with_peers:
            continue
        result = smooth(
            bench.time,
            bench.q,
            bench.check(),
            limits=limits_of(bench),
            joints=bench.task.robot.action_joints,
            **options,
        )
        results[name], ran = result, execute(log, result, episode)
        rows[name] = bench.figures(result.spline) | {
            "torque": ran.smoothed.rate / torque if ran.smoothed else 1.0,
            "cpu": result.cpu + bench.building,
            "fault": bench.verify(result.spline),
            "executed": ran.reason if ran.run is None else "",
            "status": ran.status,
            "found": result.status,
            "certified": result.certified,
            "checks": result.checks + result.slacks,
            "ease": result.blend,
        }
    like = results["local, 5 mm"]
    scene = peers.PlainScene(
        log.model,
        bench.data,
        episode.qpos,
        bench.task.qpos_index,
        bench.task.limits,
        pairs=bench.checker.pairs,
        balanced=balanced(bench),
    )
    calls = {}
    if with_peers:
        calls |= {
            "EMA 0.25": lambda: peers.exponential(bench.time, bench.q, bench.task.limits),
            "Savitzky-Golay 21,3": lambda: peers.savitzky_golay(
                bench.time, bench.q, bench.task.limits
            ),
            "Butterworth 3 Hz": lambda: peers.butterworth(bench.time, bench.q, bench.task.limits),
            "scipy GCV": lambda: peers.cross_validated(bench.time, bench.q, bench.task.limits),
            "OMPL simplify + min-jerk": lambda: peers.ompl_simplify(
                bench.time, bench.q, bench.task.limits, scene
            ),
            "toppra on the log": lambda: peers.toppra_raw(
                bench.time, bench.q, bench.task.limits, bench.task.speeds
            ),
        }
    if with_plain:
        calls["paper, plainly"] = lambda: peers.paper_plainly(bench.time, bench.q, scene)
    for name, call in calls.items():
        began = process_time()
        spline = call()
        cpu = process_time() - began
        if spline is None:
            continue
        if name == "paper, plainly":
            spline, ps = spline
            rows["paper, knots"]["p_away"] = float(abs(results["paper, knots"].p - ps).max())
        row = rows[name] = bench.figures(spline) | {
            "cpu": cpu,
            "fault": bench.verify(spline),
            "torque": None,
            "executed": "",
        }
        if name != "toppra on the log":
            ran = follow(log, replace(like, spline=spline), bench.q, arrives=episode.result.success)
            row |= {
                "torque": metrics.torque_rate(ran.torque, period) / torque,
                "executed": worse(ran, episode),
            }
    return rows


def balanced(bench):
    """The balance rule for the plain loop, from the present poses."""
    from coordlog.kinematics.balance import support_margin

    model, sites = bench.log.model, [site.id for site in bench.corners]
    mass = model.body_mass / model.body_mass.sum()

    def rule(data):
        margin = support_margin((mass @ data.xipos)[None, :2], data.site_xpos[sites][None])
        return bool(margin[0] >= bench.task.config.balance_margin)

    return rule


def interval(values, rng):
    """Median and 95 % bootstrap interval."""
    values = np.array([value for value in values if value is not None], dtype=float)
    if not len(values):
        return None
    draws = np.median(values[rng.integers(len(values), size=(2000, len(values)))], axis=1)
    return float(np.median(values)), *np.percentile(draws, [2.5, 97.5]).tolist()


def table(all_rows, rng, scenes):
    names = list(dict.fromkeys(name for rows in all_rows for name in rows))
    print(
        f"\n{'method':26s} {'n':>3s} {'pass':>5s} {'exec ok':>7s}  {'jerk/log (95 %)':25s} {'acc':5s}  {'torque rate (95 %)':22s}",
        end=" ",
    )
    print("path's torque rate    ZMP mm  path  SPARC dev   CPU ms (95 %)")
    for name in names:
        rows = [each[name] for each in all_rows if name in each]

        def shown(key, scale=1.0, digits=4, rows=rows):
            found = interval([row.get(key) for row in rows], rng)
            return (
                "-"
                if found is None
                else "{:.{d}f} ({:.{d}f}-{:.{d}f})".format(*(scale * x for x in found), d=digits)
            )

        def middle(key, digits=3, rows=rows):
            found = interval([row.get(key) for row in rows], rng)
            return "-" if found is None else f"{found[0]:.{digits}f}"

        def least(key, rows=rows):
            found = [row[key] for row in rows if row.get(key) is not None]
            return f"{1e3 * min(found):.1f}" if found else "-"

        passed, fine = (
            sum(not row["fault"] for row in rows),
            sum(not row["executed"] for row in rows),
        )
        print(
            f"{name:26s} {len(rows):3d} {passed:5d} {fine:7d}  {shown('jerk'):25s} {middle('acceleration')}  {shown('torque', 1, 3):22s} "
            f"{shown('path_torque', 1, 3):22s} {least('zmp'):6s} "
            f"{middle('path', 2):5s} {middle('sparc', 2)} {middle('deviation', 2):5s} {shown('cpu', 1e3, 0)}"
        )
    for name in OURS:
        for scene in sorted(set(scenes)):
            own = [
                each[name]
                for each, at in zip(all_rows, scenes, strict=True)
                if at == scene and name in each
            ]
            if not own:
                continue
            counts = {
                status: sum(row["status"] == status for row in own)
                for status in sorted({row["status"] for row in own})
            }
            jerk, certified = (
                np.median([row["jerk"] for row in own]),
                sum(row["certified"] for row in own),
            )
            faults = {
                fault: sum(row["fault"] == fault for row in own)
                for fault in sorted({row["fault"] for row in own})
                if fault
            }
            print(
                f"  {name:18s} {scene:8s} {counts} certified {certified} jerk {jerk:.4f} faults of the verifier {faults}"
            )


def ratios(all_rows, rng):
    """What `local` is better by, log by log."""
    print("\nratios within one log, median (95 %)")
    for ours, other, key in (
        ("local", "paper, proven", "jerk"),
        ("local", "paper, proven", "torque"),
        ("local", "paper, proven", "path_torque"),
        ("local", "paper, knots", "path_torque"),
        ("local", "paper, proven", "cpu"),
        ("local", "paper, knots", "jerk"),
        ("local", "paper, knots", "cpu"),
        ("local", "paper, plainly", "cpu"),
        ("paper, knots", "paper, plainly", "cpu"),
        ("local", "OMPL simplify + min-jerk", "jerk"),
    ):
        each = [
            rows[other][key] / rows[ours][key]
            for rows in all_rows
            if other in rows and ours in rows and rows[ours][key]
        ]
        found = interval(each, rng)
        if found is not None:
            print(
                f"  {key:11s} of {other:26s} / {ours:14s} {found[0]:8.2f} ({found[1]:.2f}-{found[2]:.2f})   n = {len(each)}"
            )
    both = [rows for rows in all_rows if "local" in rows]
    best = interval(
        [rows["paper, proven"]["path_torque"] / rows["local"]["floor"] for rows in both], rng
    )
    if best is not None:
        print(
            f"  path_torque of the paper / the least that any path between the same ends has {best[0]:.2f} ({best[1]:.2f}-{best[2]:.2f})"
        )
    away = [
        rows["paper, knots"]["p_away"]
        for rows in all_rows
        if "p_away" in rows.get("paper, knots", {})
    ]
    if away:
        print(
            f"  largest difference of p between `paper` and the plain version: {max(away):.1e}, n = {len(away)}"
        )


def growth(bench):
    """Processor time as one log is gone through there and back again, over and over."""
    print("\nlocal, growth with length:   knots       ms   us/knot   status")
    from coordlog.smooth.smoother import smooth

    there = np.concatenate([bench.episode.qpos, bench.episode.qpos[-2:0:-1]])
    for n in (150, 1500, 15000):
        qpos = np.resize(there, (n, there.shape[1]))
        time = np.arange(n) * bench.knots.unit
        checker = SceneChecker(
            bench.log.model,
            bench.task.robot,
            bench.task.config,
            time=time,
            qpos=qpos,
            initial=bench.log.start,
        )
        result = smooth(
            time,
            qpos[:, bench.task.qpos_index],
            checker,
            limits=limits_of(bench),
            clearance=0.005,
            cutoff=1.0,
        )
        print(
            f"                            {n:6d} {1e3 * result.cpu:8.0f} {1e6 * result.cpu / n:9.0f}   {result.status}"
        )


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument(
        "logs", type=Path, nargs="?", help="without it, three logs of each scene are recorded first"
    )
    parser.add_argument("--count", type=int, default=25, help="logs of each scene")
    parser.add_argument(
        "--peers", type=int, default=5, help="logs of each scene that the other tools smooth too"
    )
    parser.add_argument(
        "--plain", type=int, default=2, help="logs of each scene for the paper written plainly"
    )
    parser.add_argument("--json", type=Path)
    parser.add_argument(
        "--tables",
        type=Path,
        nargs="+",
        help="print the tables of these --json files, and measure nothing",
    )
    arguments = parser.parse_args()
    if arguments.tables:
        found = [each for file in arguments.tables for each in json.loads(file.read_text())]
        return show([each["rows"] for each in found], [each["scene"] for each in found])
    with tempfile.TemporaryDirectory() as folder:
        report(arguments, arguments.logs or recorded(Path(folder)))


def recorded(folder):
    """Noisy expert logs of all four scenes, three each."""
    for scene in ("free", "spheres", "table", "shelf"):
        call = [
            sys.executable,
            "-m",
            "coordlog.cli",
            "record",
            "--scene",
            scene,
            "--episodes",
            "3",
            "--noise",
            "0.15",
            "--out",
            str(folder),
        ]
        subprocess.run(call, check=True, stdout=subprocess.DEVNULL)
    return folder


def report(arguments, logs):
    """Measure every log, and print the tables."""
    all_rows, scenes, seen = [], [], {}
    for path in find_files(logs).paths:
        bench = Bench(path)
        scene = bench.episode.header.episode["scene"]
        at = seen[scene] = seen.get(scene, -1) + 1
        if at >= arguments.count:
            continue
        all_rows.append(
            measure(bench, with_peers=at < arguments.peers, with_plain=at < arguments.plain)
        )
        scenes.append(scene)
        print(f"\r{len(all_rows)} logs", end="", file=sys.stderr, flush=True)
        if arguments.json:
            rows = [{"scene": at, "rows": rows} for at, rows in zip(scenes, all_rows, strict=True)]
            arguments.json.write_text(json.dumps(rows, indent=1))
    show(all_rows, scenes)
    growth(bench)


def show(all_rows, scenes):
    rng = np.random.default_rng(0)
    table(all_rows, rng, scenes)
    ratios(all_rows, rng)


if __name__ == "__main__":
    main()
