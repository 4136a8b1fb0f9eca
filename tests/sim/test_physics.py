"""The batch against plain MuJoCo: the same bits, every contact of every substep, and no word when a
simulation diverges."""

import mujoco
import numpy as np
import pytest

from coordlog.episode import CONTACT
from coordlog.mjcf import compile_model, compose
from coordlog.sim.env import BatchEnv
from coordlog.sim.physics import DIVERGED, Physics, deepest
from coordlog.sim.settling import settled
from coordlog.tasks.config import EnvConfig
from coordlog.tasks.scene import SCENES, find, sphere_geom

STATE = mujoco.mjtState.mjSTATE_INTEGRATION
SUBSTEPS = 10
AHEAD = np.array([0.10, 0.0, 0.0])


def model_of(name, **changes):
    """A scene's model; `cone` replaces the friction cone."""
    text = compose(find(name), EnvConfig()).text
    for old, new in changes.items():
        text = text.replace("<option ", f'<option {old}="{new}" ')
    return compile_model(text)


def physics_at(model, qpos, **options):
    """Physics of one simulation per row of qpos."""
    physics = Physics(model, n=len(qpos), threads=1, **options)
    physics.qpos[:] = qpos
    physics.refresh(np.arange(len(qpos)))
    return physics


def foreign(model, data, robot):
    """Contacts other than sole on floor, by name, the slow way: [(geom1, geom2, depth,
    position)]."""
    found = []
    for contact in data.contact:
        names = {model.geom(contact.geom1).name, model.geom(contact.geom2).name}
        if not ("floor" in names and names & set(robot.soles)):
            first, second = sorted((int(contact.geom1), int(contact.geom2)))
            found.append((first, second, -contact.dist, contact.pos.copy()))
    return found


def wild(model, rng, n):
    """Whole-body states anywhere: joints in their ranges, the base low enough to lie, kneel and
    stand."""
    qpos = np.tile(model.qpos0, (n, 1))
    for i in range(model.njnt):
        joint = model.joint(i)
        if joint.type[0] == mujoco.mjtJoint.mjJNT_HINGE:
            qpos[:, joint.qposadr[0]] = rng.uniform(*joint.range, n)
    qpos[:, 0] = rng.uniform(-0.1, 0.25, n)
    qpos[:, 2] = rng.uniform(0.1, 0.5, n)
    qpos[:, 3:7] = rng.normal(size=(n, 4))
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    return qpos


@pytest.fixture(scope="module")
def shelf():
    """The shelf's model and the robot's state at rest."""
    model = model_of("shelf")
    return model, settled(find("shelf").robot, model, "stand")


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
@pytest.mark.parametrize("name", ["shelf", "spheres"])
def test_counting_contacts_by_constraint_rows_agrees_with_looking_at_each(name, cone):
    model, rng, robot = model_of(name, cone=cone), np.random.default_rng(0), find(name).robot
    physics = physics_at(model, wild(model, rng, 300))
    if name == "spheres":
        physics.mocap_pos[:, -3:] = rng.uniform([-0.2, -0.3, 0.0], [0.4, 0.3, 0.9], (300, 3, 3))
        physics.refresh(np.arange(300))
    counted = physics.touching(np.arange(300))
    data, wanted, soles = mujoco.MjData(model), [], 0
    for row in physics.rows:
        mujoco.mj_setState(model, data, row, STATE)
        mujoco.mj_forward(model, data)
        wanted.append(len(foreign(model, data, robot)))
        soles += data.ncon - wanted[-1]
    assert counted.tolist() == wanted
    assert len(set(wanted)) > 5
    assert soles > 20


@pytest.mark.parametrize("threads", [1, 3])
def test_a_control_step_is_ten_plain_steps_bit_for_bit(shelf, threads):
    model, start = shelf
    n, rng = 5, np.random.default_rng(0)
    physics = Physics(model, n=n, threads=threads)
    physics.rows[:] = start
    physics.refresh(np.arange(n))
    plain = [mujoco.MjData(model) for _ in range(n)]
    for data in plain:
        mujoco.mj_setState(model, data, start, STATE)
    before = physics.ctrl.copy()
    low, high = model.actuator_ctrlrange.T
    touched = 0
    for _ in range(15):
        ids = np.flatnonzero(rng.random(n) < 0.8)
        after = before.copy()
        after[ids] = np.clip(
            before[ids] + rng.normal(scale=0.15, size=(len(ids), model.nu)), low, high
        )
        collision, contacts = physics.advance(ids, before[ids], after[ids], substeps=SUBSTEPS)
        for row, i in enumerate(ids):
            found = []
            for substep in range(SUBSTEPS):
                plain[i].ctrl[:] = before[i] + (after[i] - before[i]) * ((substep + 1) / SUBSTEPS)
                mujoco.mj_step(model, plain[i])
                look = mujoco.MjData(model)
                mujoco.mj_setState(model, look, get_state(model, plain[i]), STATE)
                mujoco.mj_forward(model, look)
                found += [
                    (*pair, substep, depth, position)
                    for *pair, depth, position in foreign(model, look, find("shelf").robot)
                ]
            assert physics.rows[i].tobytes() == get_state(model, plain[i]).tobytes()
            assert physics.sensors[i].tobytes() == look.sensordata.tobytes()
            assert collision[row] == bool(found)
            assert same_contacts(contacts[row], found)
            touched += len(found)
        before = after
    assert touched > 10


def get_state(model, data):
    row = np.empty(mujoco.mj_stateSize(model, STATE))
    mujoco.mj_getState(model, data, row, STATE)
    return row


def same_contacts(rows, found):
    """Per pair the deepest, to the bit."""
    best = {}
    for first, second, substep, depth, position in found:
        if (first, second) not in best or depth > best[first, second][1]:
            best[first, second] = (substep, depth, *position)
    wanted = [(0, values[0], *pair, *values[1:]) for pair, values in sorted(best.items())]
    return [tuple(row) for row in rows.tolist()] == [
        (a, b, c, d, *map(float, rest)) for a, b, c, d, *rest in wanted
    ]


def two_episodes(n, threads, slots):
    """Two episodes of `spheres` in the given slots, beside n - 2 others that do other things: their
    states and outcomes as bytes."""
    env, slots = BatchEnv(SCENES["spheres"], n=n, threads=threads), np.array(slots)
    env.reset(np.arange(n), [env.problem(seed=9, split="train", index=index) for index in range(n)])
    env.reset(slots, [env.problem(seed=0, split="train", index=index) for index in range(2)])
    others, trace = np.setdiff1d(np.arange(n), slots), []
    for step, action in enumerate(
        np.random.default_rng(0).uniform(-1, 1, (25, 2, 13)).astype(np.float32)
    ):
        if len(others):
            env.step(np.full((len(others), 13), (-1.0) ** step, dtype=np.float32), others)
        outcome = env.step(action, slots)
        trace += [
            env.physics.rows[slots].tobytes(),
            env.state[slots].tobytes(),
            outcome.reward.tobytes(),
            *map(bytes, outcome.contacts),
        ]
    return trace


@pytest.mark.parametrize(
    ("n", "threads", "slots"), [(2, 2, (0, 1)), (5, 1, (1, 4)), (16, 4, (3, 9))]
)
def test_an_episode_is_the_same_at_any_width_and_number_of_threads(n, threads, slots):
    assert two_episodes(n, threads, slots) == two_episodes(2, 1, (0, 1))


def test_resized_spheres_really_collide():
    """The trap: a new radius without new bounding volumes drops contacts silently."""
    model = model_of("spheres")
    start = settled(find("spheres").robot, model, "stand")
    physics = Physics(model, n=2, threads=1)
    physics.rows[:] = start
    palm = model.sensor("palm_left").adr[0]
    physics.refresh(np.arange(2))
    hand = physics.sensors[0, palm : palm + 3]
    sphere = model.geom(sphere_geom(0)).id
    mocap = model.body(sphere_geom(0)).mocapid[0]
    physics.mocap_pos[:, mocap] = hand + AHEAD  # the hand is 2 cm thick
    physics.resize(np.array([0, 1]), [sphere], np.array([[0.03], [0.095]]))
    physics.refresh(np.arange(2))
    assert physics.touching(np.arange(2))[0] == 0
    assert physics.touching(np.arange(2))[1] > 0
    collision, contacts = physics.advance(
        np.arange(2), physics.ctrl.copy(), physics.ctrl.copy(), substeps=SUBSTEPS
    )
    assert collision.tolist() == [False, True]
    assert sphere in np.concatenate([contacts[1]["geom1"], contacts[1]["geom2"]])
    physics.rows[:] = start
    physics.mocap_pos[:, mocap] = hand + AHEAD
    physics.resize(np.array([1]), [sphere], np.array([[0.03]]))
    physics.refresh(np.arange(2))
    assert not physics.touching(np.arange(2)).any()


def test_a_resized_simulations_model_is_the_compiled_one():
    radii = (0.031, 0.047, 0.06)
    physics = Physics(model_of("spheres"), n=2, threads=1)
    spheres = [physics.model.geom(sphere_geom(i)).id for i in range(3)]
    physics.resize(np.array([1]), spheres, np.array([radii]))
    compiled = compile_model(compose(find("spheres"), EnvConfig(), radii))
    for field in (
        "geom_size",
        "geom_rbound",
        "geom_aabb",
        "body_mass",
        "body_inertia",
        "dof_invweight0",
    ):
        assert (
            getattr(physics.model_of(1), field).tobytes() == getattr(compiled, field).tobytes()
        ), field
        assert (
            getattr(physics.model_of(0), field).tobytes() == getattr(physics.model, field).tobytes()
        ), field


def test_a_collision_between_control_steps_is_not_missed():
    """A ball through the hand within one control step: there at no control step, seen at a
    substep."""
    xml = """
    <mujoco><option timestep="0.004" gravity="0 0 0"/><worldbody>
      <geom name="wall" type="box" size=".002 .1 .1" solref="10 1"/>
      <body pos="-.05 0 0"><joint name="x" type="slide" axis="1 0 0"/><geom name="ball" type="sphere" size=".01" mass="1"/></body>
    </worldbody></mujoco>
    """
    model = compile_model(xml)  # a soft wall: it only brakes a little
    physics = Physics(model, n=1, threads=1)
    physics.qvel[:] = 2.5  # 1 cm per substep: it passes 5 cm, the wall, and another 5 cm
    physics.refresh(np.zeros(1, dtype=int))
    assert physics.touching(np.zeros(1, dtype=int)) == 0
    still = np.zeros((1, 0))
    collision, contacts = physics.advance(np.zeros(1, dtype=int), still, still, substeps=SUBSTEPS)
    assert physics.qpos[0, 0] > 0.07
    assert physics.touching(np.zeros(1, dtype=int)) == 0
    assert collision.tolist() == [True]
    assert len(contacts[0]) == 1
    assert 3 <= contacts[0]["substep"][0] <= 6


def test_contacts_at_the_first_and_the_last_substep_count_where_they_happen():
    """The start state belongs to the control step before; the state reached belongs to this one."""
    xml = """
    <mujoco><option timestep="0.004" gravity="0 0 0"/><worldbody>
      <geom name="wall" type="box" pos=".06 0 0" size=".01 .1 .1" solref="10 1"/>
      <body><joint type="slide" axis="1 0 0"/><geom name="ball" type="sphere" size=".01" mass="1"/></body>
    </worldbody></mujoco>
    """
    model, one, still = compile_model(xml), np.zeros(1, dtype=int), np.zeros((1, 0))
    physics = Physics(model, n=1, threads=1)
    physics.qvel[:] = 0.0401 / 0.04  # arrives with the last of the ten substeps
    physics.refresh(one)
    collision, contacts = physics.advance(one, still, still, substeps=SUBSTEPS)
    assert collision.tolist() == [True]
    assert contacts[0]["substep"].tolist() == [9]
    physics.qvel[:] = -1.0  # and leaves again: touching only before the first substep
    physics.qpos[:] = 0.0401
    physics.refresh(one)
    assert physics.touching(one) == 1
    collision, contacts = physics.advance(one, still, still, substeps=SUBSTEPS)
    assert collision.tolist() == [False]
    assert len(contacts[0]) == 0


def test_the_deepest_contact_of_a_pair_is_kept_and_the_first_of_equals():
    rows = np.zeros(5, dtype=CONTACT)
    rows["geom1"], rows["geom2"] = (1, 1, 1, 0, 1), (2, 2, 2, 9, 3)
    rows["substep"], rows["depth"] = (3, 1, 0, 5, 2), (0.1, 0.3, 0.3, 0.2, 0.0)
    rows["x"] = (1, 2, 3, 4, 5)
    rng = np.random.default_rng(0)
    for _ in range(5):
        kept = deepest(rng.permutation(rows))
        assert kept[["geom1", "geom2"]].tolist() == [(0, 9), (1, 2), (1, 3)]
        assert kept["substep"].tolist() == [5, 0, 2]
        assert kept["x"].tolist() == [4, 3, 5]
    assert len(deepest(rows[:0])) == 0


@pytest.mark.parametrize("poison", [np.nan, np.inf, 1e12, 3e7])
@pytest.mark.parametrize("where", ["qpos", "qvel"])
def test_a_diverged_simulation_is_flagged_and_the_others_go_on(
    where, poison, tmp_path, monkeypatch, capfd
):
    monkeypatch.chdir(tmp_path)
    env = {}
    for sick in (False, True):
        env[sick] = BatchEnv(SCENES["table"], n=6, threads=2)
        env[sick].reset(
            np.arange(6),
            [env[sick].problem(seed=0, split="train", index=index) for index in range(6)],
        )
    getattr(env[True].physics, where)[3, 10] = poison
    rng, flagged = np.random.default_rng(0), False
    with np.errstate(all="ignore"):
        for _ in range(4):
            action = rng.uniform(-1, 1, (6, 13)).astype(np.float32)
            well, ill = (env[sick].step(action, np.arange(6)) for sick in (False, True))
            flagged |= bool(ill.diverged[3])
            others = [0, 1, 2, 4, 5]
            assert not ill.diverged[others].any()
            assert not well.diverged.any()
            for name in ("reward", "distance", "collision", "instability", "terminated"):
                assert getattr(ill, name)[others].tobytes() == getattr(well, name)[others].tobytes()
            assert (
                env[True].physics.rows[others].tobytes()
                == env[False].physics.rows[others].tobytes()
            )
    assert flagged
    assert list(tmp_path.iterdir()) == []  # no MUJOCO_LOG.TXT
    assert capfd.readouterr() == ("", "")
    for sick in (False, True):  # and the slot is as good as new
        env[sick].reset(np.array([3]), [env[sick].problem(seed=1, split="train", index=0)])
        outcome = env[sick].step(np.zeros((1, 13), dtype=np.float32), np.array([3]))
        assert not outcome.diverged.any()
    assert env[True].physics.rows[3].tobytes() == env[False].physics.rows[3].tobytes()


def test_a_simulation_that_explodes_under_way_is_flagged_in_that_very_step():
    """Finite before and after, but MuJoCo gave up in between: the steps it did not make must not
    pass for made."""
    physics = Physics(model_of("free"), n=2, threads=1)
    start = settled(find("free").robot, physics.model, "stand")
    physics.rows[:] = start
    physics.qvel[1, 10] = 1e6
    ids = np.arange(2)
    physics.refresh(ids)
    assert not physics.diverged(ids).any()
    physics.advance(ids, physics.ctrl.copy(), physics.ctrl.copy(), substeps=SUBSTEPS)
    assert (
        max(np.abs(physics.qpos).max(), np.abs(physics.qvel).max()) < DIVERGED
    )  # there is nothing to see in the state
    assert physics.diverged(ids).tolist() == [False, True]


def test_one_model_per_simulation_is_what_a_replay_needs():
    models = [
        compile_model(compose(find("spheres"), EnvConfig(), radii))
        for radii in ((0.03,) * 3, (0.095, 0.03, 0.03))
    ]
    start = settled(find("spheres").robot, models[0], "stand")
    physics = Physics(models[0], n=2, threads=1, models=models)
    physics.rows[:] = start
    physics.refresh(np.arange(2))
    palm = models[0].sensor("palm_left").adr[0]
    physics.mocap_pos[:, models[0].body(sphere_geom(0)).mocapid[0]] = (
        physics.sensors[0, palm : palm + 3] + AHEAD
    )
    physics.refresh(np.arange(2))
    assert physics.touching(np.arange(2)).astype(bool).tolist() == [False, True]
    collision, contacts = physics.advance(
        np.arange(2), physics.ctrl.copy(), physics.ctrl.copy(), substeps=1
    )
    assert collision.tolist() == [False, True]
    assert models[0].geom(sphere_geom(0)).id in np.concatenate(
        [contacts[1]["geom1"], contacts[1]["geom2"]]
    )


def test_the_number_of_substeps_may_change():
    physics = Physics(model_of("free"), n=1, threads=1)
    physics.rows[:] = settled(find("free").robot, physics.model, "stand")
    one = np.zeros(1, dtype=int)
    physics.refresh(one)
    for substeps in (1, 10, 3):
        collision, _ = physics.advance(
            one, physics.ctrl.copy(), physics.ctrl.copy(), substeps=substeps
        )
        assert not collision.any()
    assert physics.rows[0, 0] == pytest.approx(14 * physics.model.opt.timestep)
