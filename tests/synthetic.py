"""Synthetic episodes: random numbers that keep every rule of a real one.

Results come from plain loops, as an oracle.
"""

import hashlib
import math
from dataclasses import replace

import numpy as np

from coordlog.episode import (
    CONTACT,
    FIELD_KEYS,
    INITIAL_STATE,
    MODEL_XML,
    Episode,
    Header,
    Path,
    Result,
)
from coordlog.errors import FormatError
from coordlog.record.records import walk
from coordlog.spec import REACH, SCHEMA_VERSION, Layout

HUMANOID = Layout(n_q=34, n_v=33, n_x=25, n_u=13, k=2, n_c=19)
PLANAR = Layout(n_q=8, n_v=8, n_x=23, n_u=8, k=3, n_c=8)
TINY = Layout(n_q=2, n_v=2, n_x=3, n_u=1, k=1, n_c=1)
TASK = {
    "name": "reach",
    "fields": [{key: getattr(item, key) for key in FIELD_KEYS} for item in REACH],
}

PERIOD = 0.04
START = 1_700_000_000_123_456_789
CONFIG = {"control_period": PERIOD, "max_steps": 150, "goal_radius": 0.03, "boundary_radius": 0.1}
REWARD = {"alpha": 1.0, "n1": 0.3, "n2": 10.0, "m1": 0.1, "m2": 0.3, "kappa": 30.0}
ATTACHMENTS = {
    MODEL_XML: b"(\xb5/\xfd not really zstd",
    INITIAL_STATE: np.linspace(0, 1, 20).tobytes(),
}


def rewards(distance, boundary, goal, collision, instability, constants):
    """The paper's reward, as the writer of a log computed it."""
    shared = -constants["n1"] * collision - constants["n2"] * instability
    each = (
        -constants["alpha"] * distance
        + constants["m1"] * boundary
        + constants["m2"] * goal
        + shared[:, None]
    )
    finished = goal.all(axis=1) & ~collision & ~instability
    return np.where(finished[:, None], constants["kappa"], each)


def make_header(layout=HUMANOID, *, start_time=START, **episode):
    names = ["right", "left", "middle", "fourth", "fifth"][: layout.k]  # not in alphabetical order
    joints = min(layout.n_q, layout.n_v)
    return Header(
        episode={
            "schema_version": SCHEMA_VERSION,
            "kind": "simulated",
            "id": "synthetic-0",
            "run": "test",
            "robot": "synthetic",
            "scene": "table",
            "split": "test",
            "seed": 7,
            "index": 0,
            "start": "stand",
            "control_period": PERIOD,
            "start_time": start_time,
            "goals": [[0.1, 0.2, 1 / 3]] * layout.k,
            "obstacles": [],
        }
        | episode,
        env={
            "coordlog_version": "0",
            "mujoco_version": "4.0.0",
            "architecture": "x86_64",
            "reward": REWARD,
            "config": CONFIG,
            "robot": {"name": "synthetic"},
            "joints": [
                {
                    "name": f"joint_{i}",
                    "qpos": layout.n_q - joints + i,
                    "qvel": layout.n_v - joints + i,
                }
                for i in range(joints)
            ],
            "task": TASK,
            "actuators": ["a"] * layout.n_c,
            "geoms": [f"geom_{i}" for i in range(20)],
            "arms": {name: [index % layout.n_u] for index, name in enumerate(names)},
            "action_joints": [f"joint_{i}" for i in range(layout.n_u)],
            "state": [f"x{i}" for i in range(layout.n_x)],
            "layout": {
                "n_q": layout.n_q,
                "n_v": layout.n_v,
                "n_x": layout.n_x,
                "n_u": layout.n_u,
                "k": layout.k,
                "n_c": layout.n_c,
            },
        },
        policy={
            "kind": "expert",
            "name": "expert",
            "checkpoint_sha256": "",
            "noise": {"scale": 0.1},
        },
    )


def make_path(rng, layout, *, knots=6, breaks=9):
    return Path(
        knot_time=np.arange(knots) * PERIOD,
        knot_position=rng.normal(size=(knots, layout.n_j)),
        knot_weight=np.array([math.inf, *rng.random(knots - 2), math.inf]),
        time=np.linspace(0, knots * PERIOD, breaks),
        position=rng.normal(size=(breaks, layout.n_j)),
        velocity=rng.normal(size=(breaks, layout.n_j)),
    )


def make_contacts(rng, collision):
    rows = []
    for step in np.flatnonzero(collision):
        count = int(rng.integers(1, 5))
        part = np.zeros(count, CONTACT)
        part["step"], part["substep"] = step, rng.integers(0, 8, count)
        part["geom1"], part["geom2"] = (
            np.arange(count),
            np.arange(count) + 1 + rng.integers(0, 9, count),
        )
        part["depth"] = rng.random(count) / 100
        for name in "xyz":
            part[name] = rng.normal(size=count)
        rows.append(part)
    return np.concatenate(rows) if rows else np.empty(0, CONTACT)


def make_episode(
    rng, *, length=60, layout=HUMANOID, collisions=0.2, ending="goal", path=False, header=None
):
    """`ending`: goal, fall, limit (cut off at max_steps) or the reason of an abort."""
    distance = rng.uniform(0.05, 0.5, (length, layout.k))
    collision, instability = rng.random(length) < collisions, np.zeros(length, bool)
    truncated = np.zeros(length, bool)
    if length and ending == "goal":
        distance[-1] = rng.uniform(0.001, 0.029, layout.k)
    if length and ending == "fall":
        instability[-1] = True
    if length and ending == "limit":
        truncated[-1] = True
    boundary, goal = distance < CONFIG["boundary_radius"], distance < CONFIG["goal_radius"]
    ended = length > 0 and ending in ("goal", "fall", "limit")
    episode = Episode(
        header=header or make_header(layout),
        result=Result(length, (), False, False, False, False, "" if ended else ending, ""),
        time=np.arange(length + 1) * PERIOD,
        qpos=rng.normal(size=(length + 1, layout.n_q)),
        qvel=rng.normal(size=(length + 1, layout.n_v)),
        state=rng.uniform(-1, 1, (length + 1, layout.n_x)).astype(np.float32),
        action=rng.uniform(-1, 1, (length, layout.n_u)).astype(np.float32),
        ctrl=rng.normal(size=(length, layout.n_c)),
        torque=rng.normal(size=(length, layout.n_c)),
        reward=rewards(distance, boundary, goal, collision, instability, REWARD),
        distance=distance,
        boundary=boundary,
        goal=goal,
        collision=collision,
        instability=instability,
        terminated=instability | goal.all(axis=1),
        truncated=truncated,
        contacts=make_contacts(rng, collision),
        path=make_path(rng, layout) if path else None,
    )
    return with_true_result(episode)


def with_true_result(episode):
    """The episode with the result that its arrays have, computed step by step in plain Python."""
    digest, returns, success, spoiled = (
        hashlib.sha256(),
        [0.0] * episode.header.layout.k,
        False,
        False,
    )
    for t in range(len(episode)):
        returns = [
            total + float(reward) for total, reward in zip(returns, episode.reward[t], strict=True)
        ]
        success |= all(episode.goal[t])
        spoiled |= bool(episode.collision[t] or episode.instability[t])
    for t in range(len(episode) + 1):
        digest.update(episode.qpos[t].tobytes() + episode.qvel[t].tobytes())
    last = len(episode) - 1
    return replace(
        episode,
        result=Result(
            length=len(episode),
            returns=tuple(returns),
            success=success,
            clean=success and not spoiled,
            terminated=last >= 0 and bool(episode.terminated[last]),
            truncated=last >= 0 and bool(episode.truncated[last]),
            aborted=episode.result.aborted,
            digest=digest.hexdigest(),
        ),
    )


COLUMNS = ("time", "qpos", "qvel", "state", "action", "ctrl", "torque", "reward")
COLUMNS += ("terminated", "truncated", "distance", "boundary", "goal", "collision")
COLUMNS += ("instability", "contacts")


def assert_same(a, b):
    """Every array equal bit for bit, header and result equal."""
    assert a.header == b.header
    assert list(a.header.arms) == list(b.header.arms)
    assert repr(a.result) == repr(b.result)  # repr, so that NaN equals NaN
    assert list(a.columns) == list(b.columns)
    for name in (*a.columns, "contacts"):
        assert getattr(a, name).dtype == getattr(b, name).dtype, name
        assert getattr(a, name).shape == getattr(b, name).shape, name
        assert getattr(a, name).tobytes() == getattr(b, name).tobytes(), name
    assert (a.path is None) == (b.path is None)
    if a.path is not None:
        for name in vars(a.path):
            assert getattr(a.path, name).tobytes() == getattr(b.path, name).tobytes(), name


def telling(data, *, edge=16, within=13):
    """Places to damage, or to cut at, one by one: all that are near the ends of a record, where
    lengths and CRCs are, and every thirteenth of what lies between and is of one kind.
    """
    found = set(range(16)) | set(range(len(data) - 64, len(data)))
    for span in walk(data):
        found.update(range(span.start - 9, min(span.start + edge, span.end)))
        found.update(range(max(span.end - edge, span.start), span.end))
        found.update(range(span.start, span.end, within))
    return sorted(found)


def outcome(call, *args):
    """What the call returned, or the FormatError it raised."""
    try:
        return call(*args)
    except FormatError as error:
        return error
