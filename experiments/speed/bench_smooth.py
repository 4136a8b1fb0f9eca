"""What smoothing costs, as ratios within one run.

    python experiments/speed/bench_smooth.py [--problems FILE.py:FUNCTION] [--count N] [--length K]

Processor time of one thread (set OMP_NUM_THREADS=1), medians over problems, the rivals taking turns
on the same one. FUNCTION(rng, n) draws a problem with n knots: time (n,), q (n, n_j), checker. The
default is a planar arm among discs, whose checker is vectorised NumPy: cheap in blocks. A rival
that asks about one configuration at a time would look worse beside it than beside a physics engine,
so the plain algorithm asks here about all knots at once; what does not depend on the checker is the
number of configurations asked about.
"""

from __future__ import annotations

import argparse
import runpy
from pathlib import Path
from time import process_time

import numpy as np
from csaps import csaps
from scipy.interpolate import make_smoothing_spline

from coordlog.smooth import cutoff, smooth
from coordlog.smooth.spline import Grid

DEFAULT = f"{Path(__file__).parents[2] / 'tests' / 'smooth' / 'planar.py'}:noisy_log"


def exact_ends(n):
    weight = np.ones(n)
    weight[[0, -1]] = np.inf
    return weight


def timed(call, repeat):
    began = process_time()
    for _ in range(repeat):
        result = call()
    return (process_time() - began) / repeat, result


def bench_fits(rng, n=150):
    """One fit of all joints, for one λ, against csaps and scipy with the same weights."""
    print(f"\nfit, {n} knots           own       csaps at once    csaps per joint    scipy")
    for joints in (1, 13, 27):
        calls = fits(np.cumsum(0.01 * rng.normal(size=(n, joints)), axis=0), np.arange(n) * 0.02)
        for call in calls.values():  # the first call of each warms up
            call()
        seconds, answers = {}, {}
        for name, call in calls.items():
            seconds[name], answers[name] = timed(call, 200 if name == "own" else 5)
        away = max(abs(answers[name] - answers["own"]).max() for name in calls)
        ratios = "".join(
            f"{seconds[name] / seconds['own']:14.1f} x" for name in ("all", "each", "scipy")
        )
        print(
            f"{joints:3d} joints     {1e6 * seconds['own']:8.0f} us{ratios}      (all agree to {away:.0e} rad)"
        )


def fits(q, time):
    """The same fit by four roads."""
    weight, lam, grid = (
        exact_ends(len(time)),
        float(cutoff.lam_from_cutoff(2.0, time[1])),
        Grid(time, clamped=False),
    )
    p = float(cutoff.p_from_lam(lam, 1.0))
    return {
        "own": lambda: grid.fit(q, lam=lam, weight=weight).position,
        "all": lambda: csaps(time, q.T, time, smooth=p, weights=weight).T,
        "each": lambda: np.stack(
            [csaps(time, column, time, smooth=p, weights=weight) for column in q.T], axis=1
        ),
        "scipy": lambda: make_smoothing_spline(time, q, w=weight, lam=lam)(time),
    }


def plain(time, q, checker, *, precision=1e-6):
    """The paper written plainly: csaps for one joint at each step, all knots checked.

    P of each joint.
    """
    index, weight, path, ps = np.arange(len(time)), exact_ends(len(time)), q.copy(), []
    for joint in range(q.shape[1]):
        lower, upper = 0.0, 1.0
        while upper - lower >= precision:
            middle, candidate = (lower + upper) / 2, path.copy()
            candidate[:, joint] = csaps(index, q[:, joint], index, smooth=middle, weights=weight)
            if checker.check(time, candidate, 0.0).free.all():
                upper = middle
            else:
                lower = middle
        path[:, joint] = csaps(index, q[:, joint], index, smooth=upper, weights=weight)
        ps.append(upper)
    return np.array(ps)


def bench_methods(problems):
    """Each method against the plain paper on the same problems."""
    options = {
        "paper, knots": {"method": "paper", "dense": 1, "certify": False},
        "paper, proven": {"method": "paper"},
        "shared, proven": {"method": "shared"},
        "local, proven": {"method": "local"},
        "local, 5 mm": {"method": "local", "clearance": 0.005},
    }
    cpu, asked, worst_p = [], [], 0.0
    results = {name: [] for name in options}
    for time, q, checker in problems:
        began = process_time()
        ps = plain(time, q, checker)
        cpu.append(process_time() - began)
        asked.append(len(time) * 20 * q.shape[1])
        for name, option in options.items():
            results[name].append(smooth(time, q, checker, **option))
        if results["paper, knots"][-1].status in ("smoothed", "partly"):
            worst_p = max(worst_p, abs(results["paper, knots"][-1].p - ps).max())
    print(
        f"\n{len(problems)} problems: the paper written plainly takes {1e3 * np.median(cpu):.0f} ms and {np.median(asked):.0f} checks"
    )
    print(f"the fast paper's p differs from it by at most {worst_p:.1e}")
    print("method           faster  fewer checks   checks  slacks     ms   jerk/raw    statuses")
    for name, found in results.items():
        speed = np.median(
            [plainly / result.cpu for plainly, result in zip(cpu, found, strict=True)]
        )
        fewer = np.median(
            [n / (result.checks + result.slacks) for n, result in zip(asked, found, strict=True)]
        )
        checks, slacks = (
            int(np.median([getattr(result, kind) for result in found]))
            for kind in ("checks", "slacks")
        )
        rough = np.median([result.after.jerk / result.before.jerk for result in found])
        statuses = {
            status: sum(result.status == status for result in found)
            for status in sorted({r.status for r in found})
        }
        ms = 1e3 * np.median([result.cpu for result in found])
        print(
            f"{name:15s} {speed:6.1f} x {fewer:10.1f} x {checks:8d} {slacks:7d} {ms:6.1f} {rough:10.5f}    {statuses}"
        )


def bench_growth(draw, rng):
    """Time and checks per knot as a path grows: the same kind of motion, over and over."""
    print(
        "\nlocal, growth with length: knots      ms    us/knot   checks/knot   slacks/knot   status"
    )
    time, q, checker = draw(rng, 150)
    back = np.concatenate(
        [q, q[-2:0:-1]]
    )  # there and back again, so that the motion repeats without a jump
    for repeat in (1, 10, 100):
        n = 150 * repeat
        path = np.resize(back, (n, q.shape[1]))
        result = smooth(np.arange(n) * (time[1] - time[0]), path, checker)
        row = f"{1e3 * result.cpu:8.0f} {1e6 * result.cpu / n:9.0f} {result.checks / n:12.1f} {result.slacks / n:13.2f}"
        print(f"                           {n:6d} {row}     {result.status}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--problems", default=DEFAULT, help="FILE.py:FUNCTION that draws a problem")
    parser.add_argument("--count", type=int, default=10, help="problems")
    parser.add_argument("--length", type=int, default=150, help="knots of each")
    arguments = parser.parse_args()
    file, function = arguments.problems.rsplit(":", 1)
    draw = runpy.run_path(file)[function]
    rng = np.random.default_rng(1)
    bench_fits(rng)
    bench_methods([tuple(draw(rng, n=arguments.length)) for _ in range(arguments.count)])
    bench_growth(lambda rng, n: draw(rng, n=n), rng)


if __name__ == "__main__":
    main()
