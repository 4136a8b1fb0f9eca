"""Episodes to show, and recordings read back from disk."""

from dataclasses import replace

import mujoco
import numpy as np
import rerun as rr
import zstandard
from scipy.interpolate import make_smoothing_spline

from coordlog.episode import CONTACT, MODEL_XML, Episode, Header, Path, Result
from coordlog.policies.noise import Random
from coordlog.sim.env import BatchEnv
from coordlog.sim.rollout import rollout
from coordlog.tasks.config import EnvConfig
from coordlog.tasks.scene import SCENES
from coordlog.view.show import Show

STEPS = 40


def rolled_out(scene, *, steps=STEPS, seed=3):
    """A short episode of random motion, as a file would give it back."""
    env = BatchEnv(SCENES[scene], EnvConfig(max_steps=steps), n=1, threads=1)
    policy = Random(1, env.layout.n_u)
    seen = {"qpos": [], "qvel": [], "state": [], "action": []}
    led_to = {
        name: []
        for name in (
            "reward",
            "distance",
            "boundary",
            "goal",
            "collision",
            "instability",
            "terminated",
            "truncated",
        )
    }
    contacts, attachments = [], {}
    begin, act = policy.begin, policy.act

    def watch(ids, state):
        if not attachments:
            attachments.update(env.attachments(0))
        action = act(ids, state)
        for name, value in zip(
            seen, (env.physics.qpos[0], env.physics.qvel[0], env.state[0], action[0]), strict=True
        ):
            seen[name].append(np.array(value))
        return action

    policy.act, policy.begin = watch, begin
    for step, (_, outcome) in enumerate(rollout(env, policy, [0], seed=seed, split="test")):
        for name in led_to:
            led_to[name].append(getattr(outcome, name)[0])
        rows = outcome.contacts[0].copy()
        rows["step"] = step
        contacts.append(rows)
    for name, value in (
        ("qpos", env.physics.qpos[0]),
        ("qvel", env.physics.qvel[0]),
        ("state", env.state[0]),
    ):
        seen[name].append(np.array(value))
    problem = env.problem(seed=seed, split="test", index=0)
    header = Header(
        episode={
            "schema_version": 1,
            "id": "0123456789abcdef",
            "run": "feedbeef",
            "robot": env.scene.robot.name,
            "scene": scene,
            "split": "test",
            "seed": seed,
            "index": 0,
            "start": "stand",
            "control_period": 0.04,
            "start_time": 0,
            "goals": problem.goals.tolist(),
            "obstacles": problem.spheres.tolist(),
        },
        env=env.describe(),
        policy={"kind": "random", "name": "random", "checkpoint_sha256": "", "noise": {}},
    )
    columns = {name: np.stack(values) for name, values in (seen | led_to).items()}
    columns["time"] = np.arange(len(columns["qpos"])) * 0.04
    columns["contacts"] = np.concatenate(contacts)
    returns = tuple(columns["reward"].sum(axis=0).tolist())
    terminated = bool(columns["terminated"][-1])
    result = Result(
        len(columns["action"]), returns, False, False, terminated, not terminated, "", ""
    )
    return Show(scene, Episode(header=header, result=result, **columns), attachments)


def with_contacts(show):
    """Three contacts at known places: two during step 5, one during step 7."""
    rows = np.zeros(3, dtype=CONTACT)
    rows["step"], rows["geom1"], rows["geom2"] = [5, 5, 7], [0, 1, 2], [3, 4, 5]
    rows["x"], rows["y"], rows["z"] = [0.1, 0.2, 0.3], [0.0, 0.1, -0.1], [0.5, 0.6, 0.7]
    return replace(show, episode=replace(show.episode, contacts=rows))


def with_path(show, rng, *, noise=0.05):
    """A spline over knots that scatter around what was executed."""
    episode = show.episode
    time, executed = episode.time, episode.qpos[:, action_places(episode)]
    knots = executed + noise * rng.standard_normal(executed.shape)
    fits = [make_smoothing_spline(time, column, lam=1e-3) for column in knots.T]
    position = np.stack([fit(time) for fit in fits], axis=1)
    velocity = np.stack([fit.derivative()(time) for fit in fits], axis=1)
    path = Path(time, knots, np.ones(len(time)), time, position, velocity)
    return replace(show, episode=replace(episode, path=path))


def action_places(episode):
    """Places of the action joints in qpos."""
    places = {joint["name"]: joint["qpos"] for joint in episode.header.env["joints"]}
    return [places[name] for name in episode.header.env["action_joints"]]


def simulated_palms(show):
    """Palm positions by plain MuJoCo, (T + 1, k, 3) [m]."""
    model = mujoco.MjModel.from_xml_string(
        zstandard.ZstdDecompressor().decompress(show.attachments[MODEL_XML]).decode()
    )
    data, palms = mujoco.MjData(model), []
    for qpos in show.episode.qpos:
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        palms.append(
            [data.site(arm["palm"]).xpos.copy() for arm in show.episode.header.env["robot"]["arms"]]
        )
    return np.array(palms)


class ReadBack:
    """An .rrd read back: components by entity, static ones and those on a timeline."""

    def __init__(self, path):
        self.path, self.reader = path, rr.chunk.RrdReader(str(path))
        self._batches = {}
        for chunk in self.reader.stream().to_chunks():
            self._batches.setdefault(str(chunk.entity_path), []).append(chunk.to_record_batch())

    @property
    def entities(self):
        return set(self._batches)

    def column(self, entity, component):
        """Rows of one component over all chunks, each a NumPy array."""
        found = [
            batch[component] for batch in self._batches[entity] if component in batch.schema.names
        ]
        assert found, (
            f"{entity} has no {component}; it has {[batch.schema.names for batch in self._batches[entity]]}"
        )
        return [np.array(row.as_py()) for batch in found for row in batch]

    def times(self, entity, component, timeline="sim_time"):
        """Times of those rows, in the timeline's integers (ns for durations)."""
        found = [
            batch[timeline] for batch in self._batches[entity] if component in batch.schema.names
        ]
        return np.concatenate([np.asarray(column.cast("int64")) for column in found])


class Recording(ReadBack):
    """A recording that is written to a file, and read back."""

    def __init__(self, stream, path):
        stream.save(path)
        stream.flush()
        stream.disconnect()
        super().__init__(path)
