"""A planar arm among discs: the analytic checker of these tests, and noisy logs whose knots are
free of collision."""

from __future__ import annotations

import numpy as np

from coordlog.smooth import Verdict


class PlanarArm:
    """A chain of capsules on a base that may sway.

    Discs to avoid, itself to avoid, its centre of mass to keep in.
    """

    def __init__(self, lengths, discs, *, radius=0.02, sway=0.0, balance=np.inf):
        self.lengths, self.discs, self.radius = (
            np.asarray(lengths, float),
            np.asarray(discs, float).reshape(-1, 3),
            radius,
        )
        self.sway, self.balance = sway, balance
        n = len(self.lengths)
        self.selfs = [(i, k) for i in range(n) for k in range(i + 2, n)]
        # Pairs: every link with every disc, links that are not neighbours, and the centre of mass with its edge.
        tip = np.cumsum(self.lengths[::-1])[::-1]  # from joint j to the tip of the chain, stretched
        arm = np.array(
            [
                [tip[j] - (tip[i + 1] if i + 1 < n else 0.0) if j <= i else 0.0 for j in range(n)]
                for i in range(n)
            ]
        )
        own = np.array(
            [[arm[k, j] if j > i else 0.0 for j in range(n)] for i, k in self.selfs]
        ).reshape(-1, n)
        mass = self.lengths / self.lengths.sum()
        self.reach = np.vstack([np.repeat(arm, len(self.discs), axis=0), own, (mass @ arm)[None]])
        self.asked, self.measured = 0, 0

    def points(self, time, q):
        """Joints and tip, shape (n, n_links + 1, 2)."""
        angle = np.cumsum(q, axis=1)
        step = self.lengths[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=2)
        base = np.stack([self.sway * np.sin(5.0 * time), np.zeros_like(time)], axis=1)
        return base[:, None] + np.concatenate(
            [np.zeros((len(q), 1, 2)), np.cumsum(step, axis=1)], axis=1
        )

    def slack(self, time, q, clearance):
        self.measured += len(q)
        return self._slack(time, q, clearance)

    def check(self, time, q, clearance):
        self.asked += len(q)
        return Verdict.from_slack(self._slack(time, q, clearance))

    def _slack(self, time, q, clearance):
        p = self.points(time, q)
        a, b = p[:, :-1], p[:, 1:]
        discs = (
            _to_segment(self.discs[None, None, :, :2], a[:, :, None], b[:, :, None])
            - self.discs[:, 2]
            - self.radius
        )
        columns = [discs.reshape(len(q), -1) - clearance]
        if self.selfs:
            i, k = np.transpose(self.selfs)
            columns.append(
                _between(a[:, i], b[:, i], a[:, k], b[:, k]) - 2 * self.radius - clearance
            )
        com = ((a + b) / 2 * (self.lengths / self.lengths.sum())[:, None]).sum(axis=1)[:, 0]
        columns.append((self.balance - np.abs(com))[:, None])
        return np.concatenate(columns, axis=1)

    def drift(self, start, stop):
        return np.full((len(start), 1), 5.0 * self.sway)

    def describe(self, what):
        n, m = len(self.lengths), len(self.discs)
        if what < n * m:
            return f"link {what // m} and disc {what % m}"
        return (
            "centre of mass"
            if what == n * m + len(self.selfs)
            else "links {} and {}".format(*self.selfs[what - n * m])
        )


def _to_segment(point, a, b):
    along = b - a
    s = np.clip(((point - a) * along).sum(-1) / (along**2).sum(-1), 0.0, 1.0)
    return np.linalg.norm(point - a - s[..., None] * along, axis=-1)


def _between(a, b, c, d):
    ends = np.minimum(
        np.minimum(_to_segment(a, c, d), _to_segment(b, c, d)),
        np.minimum(_to_segment(c, a, b), _to_segment(d, a, b)),
    )

    def side(p, q, r):
        return (q - p)[..., 0] * (r - p)[..., 1] - (q - p)[..., 1] * (r - p)[..., 0]

    cross = (side(a, b, c) * side(a, b, d) < 0) & (side(c, d, a) * side(c, d, b) < 0)
    return np.where(cross, 0.0, ends)


def noisy_log(rng, *, n=150, links=8, discs=4, dt=0.02, noise=0.02, margin=0.005, sway=0.0):
    """An arm that folds, swings and unfolds, with coloured noise.

    Discs block the straight way but no knot of the log.
    """
    lengths = rng.uniform(0.08, 0.14, links)
    fold = np.resize([1.0, -1.0], links) * rng.uniform(0.9, 1.3)
    fold[0] = 0.0
    start, goal = 0.15 * rng.normal(size=(2, links))
    start[0], goal[0] = -rng.uniform(0.5, 1.0), rng.uniform(0.5, 1.0)
    x = np.linspace(0.0, 1.0, n)[:, None]
    ramp = x**3 * (10 - 15 * x + 6 * x**2)
    q = start + ramp * (goal - start) + np.sin(np.pi * x) ** 2 * fold
    wobble = np.zeros((n, links))
    for i in range(1, n):
        wobble[i] = 0.85 * wobble[i - 1] + noise * 0.5 * rng.normal(size=links)
    q, time = q + wobble * np.minimum(1.0, 10.0 * np.minimum(x, 1.0 - x)), np.arange(n) * dt
    free = PlanarArm(lengths, [], sway=sway)
    p = free.points(time, q)
    placed = []
    for _ in range(400):
        if len(placed) == discs:
            break
        s, link = rng.uniform(0.2, 0.8), rng.integers(links // 2, links)
        straight = free.points(time[:1], (start + s * (goal - start))[None])[0]
        centre = straight[link] + rng.uniform(0.0, 1.5) * (straight[link + 1] - straight[link])
        room = (
            _to_segment(centre, p[:, :-1], p[:, 1:]).min()
            - free.radius
            - margin * rng.uniform(0.2, 2.0)
        )
        if room > 0.01:
            placed.append([*centre, min(room, 0.12)])
    arm = PlanarArm(lengths, placed, sway=sway)
    if arm.check(time, q, 0.0).free.all():
        return time, q, arm
    return noisy_log(
        rng, n=n, links=links, discs=discs, dt=dt, noise=noise, margin=margin, sway=sway
    )  # it hit itself
