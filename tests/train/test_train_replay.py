"""Logs, the live buffer, and batches mixed from both."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from coordlog.errors import ConfigError, SpecError, StorageError
from coordlog.spec import LEARNT, names
from coordlog.train.columns import Block, Columns
from coordlog.train.config import ReplayConfig
from coordlog.train.relabel import outcome
from coordlog.train.replay import (
    Arrays,
    Asked,
    Horizon,
    MixedReplay,
    in_hindsight,
    moved,
    transitions,
)
from coordlog.train.task import Motion
from coordlog.train.transitions import Transitions
from tests.train import toy_arms as toy

WIDTHS = (toy.N_X, toy.N_U, 2)
GAMMA = 0.9


def read(store: Transitions, rows: np.ndarray, *, n: int = 1, cut: bool = False) -> Arrays:
    out = Arrays.empty(len(rows), WIDTHS)
    for array in out:
        array[:] = np.nan
    transitions(store, rows, out, Horizon(n, GAMMA, cut))
    return out


def wandering(lanes: int, steps: int, *, seed: int = 0) -> Block:
    rng = np.random.default_rng(seed)
    return toy.ToySource(lanes, seed=seed).collect(
        steps, lambda state: rng.uniform(-1, 1, (len(state), toy.N_U)).astype(np.float32)
    )


def numbered(steps: int, *, first: int = 0, lanes: int = 1) -> Block:
    """A block whose states are the number of their slot."""
    block = wandering(lanes, steps)
    slot = np.arange(first, first + steps)[:, None, None]
    return block._replace(
        state=np.broadcast_to(slot, block.state.shape).astype(np.float32),
        next_state=np.broadcast_to(slot + 0.5, block.state.shape).astype(np.float32),
        episode=np.broadcast_to(slot[:, :, 0] // 4, block.episode.shape),
        step=np.broadcast_to(slot[:, :, 0] % 4, block.step.shape),
    )


# logs


def test_every_logged_transition_leads_to_the_next_state_of_its_own_episode() -> None:
    columns = toy.logs(12)
    store = Transitions.of_logs(columns, toy.reward)
    out = read(store, np.arange(len(store)))
    row = 0
    for episode, length in enumerate(columns.length):
        states = np.concatenate(
            (columns.steps["state"][row : row + length], columns.final[episode][None])
        )
        np.testing.assert_array_equal(out.state[row : row + length], states[:-1])
        np.testing.assert_array_equal(out.next_state[row : row + length], states[1:])
        row += length
    np.testing.assert_array_equal(out.action, columns.steps["action"])
    np.testing.assert_array_equal(out.discount[:, 0] == 0, columns.steps["terminated"])
    assert not np.isnan(out.reward).any()


def test_rewards_are_recomputed_from_distances_and_flags() -> None:
    columns = toy.logs(12)
    doubled = Transitions.of_logs(columns, lambda *inputs: 2 * toy.reward(*inputs))
    rows = np.arange(len(doubled))
    wanted = toy.reward(
        columns.steps["distance"],
        columns.steps["boundary"],
        columns.steps["goal"],
        columns.steps["collision"],
        columns.steps["instability"],
    )
    np.testing.assert_allclose(read(doubled, rows).reward, 2 * wanted, rtol=1e-6)


def test_later_states_of_logs_stay_in_their_episode(rng: np.random.Generator) -> None:
    columns = toy.logs(12)
    store = Transitions.of_logs(columns, toy.reward)
    rows = store.draw(rng, 500)
    episode = np.repeat(np.arange(12), columns.length)
    later = store.next_state(store.later(rng, rows, 0)[0])
    following = read(store, np.arange(len(store))).next_state
    for row, state in zip(rows, later, strict=True):
        places = np.flatnonzero((following == state).all(axis=1) & (episode == episode[row]))
        assert len(places)
        assert places.max() >= row
    last = np.cumsum(columns.length) - 1
    np.testing.assert_array_equal(store.next_state(store.later(rng, last, 0)[0]), columns.final)


def test_arrow_tables_become_columns_over_the_same_memory() -> None:
    columns = toy.logs(5)

    def lists(values: np.ndarray) -> pa.Array:
        return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])

    arrays = columns.steps
    steps = pa.table(
        {
            name: lists(array) if array.ndim == 2 else pa.array(array)
            for name, array in arrays.items()
        }
    )
    finals = pa.table({"state": lists(columns.final), "length": pa.array(columns.length)})
    found = Columns.from_tables(steps, finals)
    for name in names(LEARNT):
        np.testing.assert_array_equal(found.steps[name], columns.steps[name])
    np.testing.assert_array_equal(found.final, columns.final)
    np.testing.assert_array_equal(found.length, columns.length)
    assert np.shares_memory(found.steps["state"], columns.steps["state"])
    parts = pa.concat_tables([steps.slice(0, 7), steps.slice(7)])
    np.testing.assert_array_equal(
        Columns.from_tables(parts, finals).steps["action"], columns.steps["action"]
    )
    with pytest.raises(SpecError, match="expected columns state, length, length missing"):
        Columns.from_tables(steps, finals.drop_columns("length"))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"length": np.array([3])}, r"state: expected 3 rows for 1 episodes of 3 steps in all"),
        ({"length": np.array([], int)}, "expected episodes of at least one step, got 0 episodes"),
        ({"action": np.zeros((1, 9), np.float32)}, r"action: expected \d+ rows"),
        ({"state": None}, "state: expected float32, got float64"),
    ],
)
def test_columns_that_do_not_fit_together_are_refused(
    changes: dict[str, np.ndarray | None], message: str
) -> None:
    columns = toy.logs(5)
    given = {
        name: columns.steps["state"].astype(float) if array is None else array
        for name, array in changes.items()
    }
    steps = {name: given.pop(name) for name in (*given,) if name != "length"}
    with pytest.raises(SpecError, match=message):
        replace(columns, steps={**columns.steps, **steps}, **given)


def test_logs_cost_little_memory_of_their_own(tmp_path: Path) -> None:
    n, episodes = 150_000, 1000
    steps: dict[str, np.ndarray] = {
        "state": np.memmap(tmp_path / "state", np.float32, "w+", shape=(n, 37)),
        "action": np.memmap(tmp_path / "action", np.float32, "w+", shape=(n, 13)),
        "distance": np.memmap(tmp_path / "distance", np.float64, "w+", shape=(n, 2)),
        **{name: np.zeros((n, 2), bool) for name in ("boundary", "goal")},
        **{name: np.zeros(n, bool) for name in ("collision", "instability", "terminated")},
    }
    columns = Columns(
        steps,
        final=np.zeros((episodes, 37), np.float32),
        length=np.full(episodes, n // episodes),
    )
    tracemalloc.start()
    store = Transitions.of_logs(columns, toy.reward)
    own, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(store) == n
    assert own < 22 * n, "1.5 million transitions cost 33 MB beside the files"
    assert peak < 150 * n


# the live buffer


def test_the_buffer_gives_back_what_was_added() -> None:
    block = wandering(4, 30)
    buffer = Transitions.ring(1000, 4, widths=WIDTHS, reward=toy.reward)
    buffer.add(Block(*(column[:10] for column in block)))
    buffer.add(Block(*(column[10:] for column in block)))
    out = read(buffer, np.arange(len(buffer)))
    for name in ("state", "action", "next_state"):
        np.testing.assert_array_equal(getattr(out, name), getattr(block, name).reshape(120, -1))
    flat = [
        getattr(block, name).reshape(120, *getattr(block, name).shape[2:])
        for name in ("distance", "boundary", "goal", "collision", "instability")
    ]
    np.testing.assert_allclose(out.reward, toy.reward(*flat), rtol=1e-6)
    np.testing.assert_array_equal(out.discount[:, 0] == 0, block.terminated.ravel())


def test_truncated_steps_are_not_ends() -> None:
    block = toy.ToySource(4, limit=5).collect(10, lambda state: np.zeros((4, toy.N_U), np.float32))
    assert (block.step[4] == 4).all()
    assert (block.step[5] == 0).all()
    buffer = Transitions.ring(100, 4, widths=WIDTHS, reward=toy.reward)
    buffer.add(block)
    out = read(buffer, np.arange(len(buffer)))
    assert (out.discount == np.float32(GAMMA)).all()
    np.testing.assert_array_equal(
        out.next_state[16:20], out.state[16:20]
    )  # nothing moved: the state before the reset


def test_the_oldest_transitions_leave_first() -> None:
    buffer = Transitions.ring(10, 1, widths=WIDTHS, reward=toy.reward)
    for first, steps in ((0, 4), (4, 4), (8, 4), (12, 1)):
        buffer.add(numbered(steps, first=first))
    assert len(buffer) == 10
    assert sorted(read(buffer, np.arange(10)).state[:, 0]) == list(range(3, 13))
    assert len(Transitions.ring(10, 4, widths=WIDTHS, reward=toy.reward)) == 0


def test_rows_are_drawn_evenly_from_what_is_stored(rng: np.random.Generator) -> None:
    buffer = Transitions.ring(40, 2, widths=WIDTHS, reward=toy.reward)
    buffer.add(numbered(10, lanes=2))
    assert np.bincount(buffer.draw(rng, 40_000), minlength=20) / 40_000 == pytest.approx(
        0.05, abs=0.01
    )
    assert buffer.draw(rng, 1000).max() == 19


def test_later_states_follow_the_lane_around_the_end_of_the_buffer(
    rng: np.random.Generator,
) -> None:
    buffer = Transitions.ring(3 * 11, 3, widths=WIDTHS, reward=toy.reward)
    for first in range(0, 30, 5):
        buffer.add(
            numbered(5, first=first, lanes=3)
        )  # episodes of four slots; slot 29 is in the middle of one
    rows = np.repeat(np.arange(len(buffer)), 50)
    now = read(buffer, rows).state[:, 0].astype(int)
    then, steps = buffer.later(rng, rows, 0)
    later = buffer.next_state(then)[:, 0] - 0.5
    np.testing.assert_array_equal(steps, later - now + 1)
    ends = np.minimum(now // 4 * 4 + 3, 29)
    assert ((now <= later) & (later <= ends)).all()
    for slot in range(19, 30):
        assert set(later[now == slot]) == set(range(slot, min(slot // 4 * 4 + 3, 29) + 1))


def test_later_states_are_of_the_same_lane_and_episode(rng: np.random.Generator) -> None:
    source, buffer = (
        toy.ToySource(5, seed=3, limit=7),
        Transitions.ring(5 * 23, 5, widths=WIDTHS, reward=toy.reward),
    )
    for _ in range(9):
        buffer.add(
            source.collect(6, lambda state: rng.uniform(-1, 1, (5, toy.N_U)).astype(np.float32))
        )
    rows = buffer.draw(rng, 400)
    view = toy.view()
    goals = view.points(read(buffer, rows).state, view.goals)
    np.testing.assert_array_equal(
        view.points(buffer.next_state(buffer.later(rng, rows, 0)[0]), view.goals), goals
    )  # goals differ between episodes


@pytest.mark.parametrize("slots", [7, 1000])
def test_a_buffer_continues_exactly_from_its_segments(slots: int, tmp_path: Path) -> None:
    def fill(buffer: Transitions, first: int, last: int) -> None:
        for start in range(first, last, 3):
            buffer.add(numbered(3, first=start, lanes=2))

    def made() -> Transitions:
        return Transitions.ring(2 * slots, 2, widths=WIDTHS, reward=toy.reward)

    through, first = made(), made()
    fill(through, 0, 30)
    for stop in (6, 12, 18):
        fill(first, stop - 6, stop)
        first.save(tmp_path)
    fill(first, 18, 24)
    first.save(tmp_path)  # a later save, whose checkpoint was never written
    second = made()
    second.load(tmp_path, total=18)
    fill(second, 18, 30)
    rows = np.arange(len(through))
    for one, other in zip(read(through, rows), read(second, rows), strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(
        through.later(np.random.default_rng(0), rows, 0),
        second.later(np.random.default_rng(0), rows, 0),
    )
    np.testing.assert_array_equal(through.clean(rows, 0), second.clean(rows, 0))
    second.save(tmp_path)
    third = made()
    third.load(tmp_path, total=30)
    np.testing.assert_array_equal(read(third, rows).state, read(through, rows).state)
    if slots == 7:
        assert len(list(tmp_path.iterdir())) <= 3, (
            "segments that nothing needs any more are removed"
        )


def test_a_missing_segment_is_an_error(tmp_path: Path) -> None:
    buffer = Transitions.ring(100, 1, widths=WIDTHS, reward=toy.reward)
    for first in (0, 5):
        buffer.add(numbered(5, first=first))
        buffer.save(tmp_path)
    min(tmp_path.iterdir()).unlink()
    with pytest.raises(StorageError, match="expected saved steps up to 10, found them up to 0"):
        Transitions.ring(100, 1, widths=WIDTHS, reward=toy.reward).load(tmp_path, total=10)


def test_live_transitions_cost_little_more_than_their_numbers() -> None:
    buffer = Transitions.ring(1000, 10, widths=(37, 13, 2), reward=toy.reward)
    each = sum(column.nbytes for column in buffer._rows.values()) / 1000
    assert each < 1.1 * 4 * (37 + 13 + 2 + 37)
    assert 1_500_000 * each < 4e9


def test_a_buffer_too_small_for_its_simulations_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"at least one transition per simulation, 8, got 5"):
        Transitions.ring(5, 8, widths=WIDTHS, reward=toy.reward)
    with pytest.raises(ConfigError, match=r"loop\.block: expected at most the buffer's 5 steps"):
        Transitions.ring(5, 1, widths=WIDTHS, reward=toy.reward).add(numbered(6))


# batches


def stores() -> tuple[Transitions, Transitions]:
    buffer = Transitions.ring(1000, 4, widths=WIDTHS, reward=toy.reward)
    buffer.add(wandering(4, 50))
    return Transitions.of_logs(toy.logs(12), toy.reward), buffer


def config(**values: float) -> ReplayConfig:
    return ReplayConfig(**{"batch": 32, "warmup": 32, "hindsight": 0.0, **values})  # type: ignore[arg-type]


def test_batches_mix_logs_and_live_steps_by_share(rng: np.random.Generator) -> None:
    logs, live = stores()
    known = {row.tobytes() for row in read(logs, np.arange(len(logs))).state}
    for share, count in ((0.5, 16), (0.25, 8), (0.0, 0), (1.0, 32)):
        batch = MixedReplay(
            config(log_fraction=share), toy.task(), gamma=GAMMA, logs=logs, live=live
        ).sample(rng)
        known_rows = np.array([row.tobytes() in known for row in batch.state.numpy()])
        np.testing.assert_array_equal(known_rows, np.arange(32) < count)


def test_all_of_a_batch_comes_from_whichever_there_is(rng: np.random.Generator) -> None:
    logs, live = stores()
    known = {row.tobytes() for row in read(logs, np.arange(len(logs))).state}
    nothing = Transitions.ring(1000, 4, widths=WIDTHS, reward=toy.reward)
    for given, share in (
        ({"logs": logs}, 1),
        ({"logs": logs, "live": nothing}, 1),
        ({"live": live}, 0),
    ):
        batch = MixedReplay(config(), toy.task(), gamma=GAMMA, **given).sample(rng)
        assert np.mean([row.tobytes() in known for row in batch.state.numpy()]) == share


def test_batches_follow_from_the_generator_alone() -> None:
    logs, live = stores()
    replay = MixedReplay(
        config(hindsight=0.5, log_hindsight=0.5), toy.task(), gamma=GAMMA, logs=logs, live=live
    )
    one, other = (replay.sample(np.random.default_rng(5)) for _ in range(2))
    assert all((a == b).all() for a, b in zip(one, other, strict=True))


@pytest.mark.parametrize("logged", [0.25, 0.0, 0.5])
def test_hindsight_asks_a_share_of_each_part_of_a_batch_for_what_was_reached(
    logged: float, rng: np.random.Generator
) -> None:
    logs, live = stores()
    view = toy.view()
    asked = {
        points.tobytes()
        for store in (logs, live)
        for points in view.points(read(store, np.arange(len(store))).state, view.goals)
    }
    replay = MixedReplay(
        config(hindsight=0.25, log_hindsight=logged, n_step=1),
        toy.task(),
        gamma=GAMMA,
        logs=logs,
        live=live,
    )
    for _ in range(20):
        batch = replay.sample(rng)
        state, following = batch.state.numpy(), batch.next_state.numpy()
        fresh = np.array(
            [points.tobytes() not in asked for points in view.points(state, view.goals)]
        )
        np.testing.assert_array_equal(fresh, [*(np.arange(16) < 16 * logged), *(np.arange(16) < 4)])
        goals, palms = view.points(following, view.goals), view.points(following, view.palms)
        np.testing.assert_array_equal(view.points(state, view.goals), goals)
        np.testing.assert_allclose(
            view.points(following, view.difference), goals - palms, atol=1e-6
        )
        reached = (np.linalg.norm(goals - palms, axis=2) < toy.RADIUS).all(axis=1)
        won = batch.reward.numpy()[:, 0] == np.float32(toy.CONSTANTS.kappa)
        np.testing.assert_array_equal(won[fresh], reached[fresh])
        assert (batch.discount.numpy()[fresh & reached] == 0).all()


@pytest.mark.parametrize("kind", ["logs", "live"])
def test_several_steps_of_an_episode_are_summed_as_one_by_one(
    kind: str, rng: np.random.Generator
) -> None:
    store: Transitions = Transitions.of_logs(toy.logs(12), toy.reward)
    if kind == "live":
        source = toy.ToySource(5, seed=3, limit=7)
        store = Transitions.ring(5 * 23, 5, widths=WIDTHS, reward=toy.reward)
        for _ in range(9):  # goes around its end
            store.add(
                source.collect(6, lambda state: rng.uniform(-1, 1, (5, toy.N_U)).astype(np.float32))
            )
    rows = store.draw(rng, 200)
    one, found = read(store, np.arange(len(store))), read(store, rows, n=4)
    goals = toy.view().goals
    for place, row in enumerate(rows):
        reward, discount, at = np.zeros(2), 1.0, row
        for _ in range(4):
            reward, discount = reward + discount * one.reward[at], discount * GAMMA
            following = one.next_state[at]
            if one.discount[at, 0] == 0:
                discount = 0.0
                break
            after = np.flatnonzero(
                (one.state == following).all(axis=1)
                & (one.state[:, goals] == one.state[row, goals]).all(axis=1)
            )
            if len(after) == 0:  # truncated, or not stored yet
                break
            at = after[0]
        np.testing.assert_allclose(found.reward[place], reward, rtol=1e-5)
        np.testing.assert_allclose(found.discount[place], discount, rtol=1e-6)
        np.testing.assert_array_equal(found.next_state[place], following)


def test_several_steps_in_hindsight_end_where_the_new_goals_are_reached(
    rng: np.random.Generator,
) -> None:
    store, view = Transitions.of_logs(toy.logs(12), toy.reward), toy.view()
    rows = store.draw(rng, 200)
    goals = view.points(store.next_state(store.later(rng, rows, 8)[0]), view.palms)
    out = Arrays.empty(200, WIDTHS)
    in_hindsight(store, rows, out, Asked(goals, view, toy.reward), Horizon(4, GAMMA))
    index, within = store.ahead(rows, 4)
    for place in range(200):
        reward, discount = np.zeros(2), 1.0
        for row, inside in zip(index[place], within[place], strict=True):
            if not inside:
                break
            palms = view.points(store.next_state(np.array([row])), view.palms)
            mishaps = {
                name: store.take(name, np.array([row])) for name in ("collision", "instability")
            }
            found = outcome(view, toy.reward, palms=palms, goals=goals[place][None], **mishaps)
            reward, discount, last = reward + discount * found.reward[0], discount * GAMMA, palms[0]
            if found.terminated[0]:
                discount = 0.0
                break
        np.testing.assert_allclose(out.reward[place], reward, rtol=1e-5)
        np.testing.assert_allclose(out.discount[place], discount, rtol=1e-6)
        np.testing.assert_allclose(view.points(out.next_state[place][None], view.palms)[0], last)
    assert 0.3 < (out.discount == 0).mean() < 0.95, (
        "some goals are reached within the four steps, some are not"
    )
    np.testing.assert_allclose(view.points(out.state, view.goals), goals, atol=1e-6)
    np.testing.assert_array_equal(out.state[:, view.goals], out.next_state[:, view.goals])


@pytest.mark.parametrize("kind", ["logs", "live"])
def test_a_cut_return_ends_before_the_mishap_of_a_later_step(kind: str) -> None:
    """Steps 0 … 5 of one episode, something is touched at 3 and 4: only what is done there pays for
    it."""
    store = mishaps(kind, 6, touched=(3, 4))
    rows = np.arange(6)
    plain, cut = read(store, rows, n=3), read(store, rows, n=3, cut=True)
    np.testing.assert_allclose(cut.discount[:, 0], GAMMA ** np.array([3, 2, 1, 1, 2, 1]))
    single = read(store, rows)
    np.testing.assert_allclose(cut.reward[[2, 3, 5]], single.reward[[2, 3, 5]], rtol=1e-6)
    np.testing.assert_allclose(
        cut.reward[1], single.reward[1] + GAMMA * single.reward[2], rtol=1e-6
    )
    np.testing.assert_array_equal(cut.next_state[2], single.next_state[2])
    for array, other in zip(cut, plain, strict=True):
        np.testing.assert_array_equal(
            array[0], other[0], err_msg="nothing goes wrong within three steps of the first"
        )
    assert (cut.reward[1] > plain.reward[1]).all()


def test_far_goals_are_from_anywhere_later_and_not_imitated(rng: np.random.Generator) -> None:
    buffer = Transitions.ring(400, 1, widths=WIDTHS, reward=toy.reward)
    block = wandering(1, 400)
    buffer.add(
        block._replace(
            episode=np.zeros_like(block.episode),
            step=np.arange(400)[:, None],
            collision=np.zeros_like(block.collision),
        )
    )
    asked = ReplayConfig(
        batch=200, warmup=200, capacity=400, hindsight=0.5, far=0.4, horizon=1, n_step=1
    )
    batch = MixedReplay(asked, toy.task(), gamma=GAMMA, live=buffer).sample(rng)
    np.testing.assert_array_equal(
        batch.imitated[:, 0].numpy(), np.repeat([0.0, 1.0, 0.0], [40, 60, 100])
    )
    view = toy.view()
    state = batch.next_state.numpy()
    distance = np.linalg.norm(
        view.points(state, view.goals) - view.points(state, view.palms), axis=2
    ).max(axis=1)
    assert (distance[40:100] < 1e-5).all(), "a horizon of one step: the goals are where it led"
    assert np.median(distance[:40]) > toy.RADIUS, "far ones are elsewhere"


def test_goals_in_hindsight_lie_within_their_horizon(rng: np.random.Generator) -> None:
    buffer = Transitions.ring(40, 1, widths=WIDTHS, reward=toy.reward)
    block = numbered(40)
    buffer.add(block._replace(episode=np.zeros_like(block.episode), step=np.arange(40)[:, None]))
    rows = np.repeat(np.arange(40), 100)
    ahead = buffer.next_state(buffer.later(rng, rows, 6)[0])[:, 0] - 0.5 - rows
    assert set(ahead) == set(range(6))
    assert (ahead + rows).max() == 39


def mishaps(kind: str, steps: int, *, touched: tuple[int, ...]) -> Transitions:
    """One episode in which some steps touch something and no goal is reached, from logs or live."""
    block, flag = numbered(steps), np.isin(np.arange(steps), touched)[:, None]
    none = {
        name: np.zeros_like(getattr(block, name))
        for name in ("boundary", "goal", "instability", "terminated", "episode")
    }
    block = block._replace(**none, collision=flag, step=np.arange(steps)[:, None])
    if kind == "live":
        store = Transitions.ring(100, 1, widths=WIDTHS, reward=toy.reward)
        store.add(block)
        return store
    columns = {name: getattr(block, name)[:, 0] for name in names(LEARNT)}
    return Transitions.of_logs(
        Columns(columns, final=block.next_state[-1], length=np.array([steps])), toy.reward
    )


@pytest.mark.parametrize("kind", ["logs", "live"])
def test_what_leads_to_a_mishap_is_not_imitated(kind: str) -> None:
    block = numbered(12)._replace(
        collision=(np.arange(12) == 6)[:, None], instability=(np.arange(12) == 11)[:, None]
    )  # episodes of four
    store: Transitions = Transitions.ring(100, 1, widths=WIDTHS, reward=toy.reward)
    if kind == "live":
        store.add(block)
    else:
        columns = {name: getattr(block, name)[:, 0] for name in names(LEARNT)}
        store = Transitions.of_logs(
            Columns(columns, final=block.next_state[3::4, 0], length=np.array([4, 4, 4])),
            toy.reward,
        )
    rows = np.arange(12)
    np.testing.assert_array_equal(
        store.clean(rows, 0), [True] * 4 + [False] * 3 + [True] + [False] * 4
    )
    np.testing.assert_array_equal(
        store.clean(rows, 2), [True] * 5 + [False] * 2 + [True] * 3 + [False] * 2
    )


def test_logs_are_imitated_and_of_live_steps_those_in_hindsight(rng: np.random.Generator) -> None:
    logs, live = stores()
    asked = config(hindsight=0.25, imitation=0.5, horizon=1)
    replay = MixedReplay(asked, toy.task(), gamma=GAMMA, logs=logs, live=live)
    imitated = replay.sample(rng).imitated[:, 0].numpy()
    np.testing.assert_array_equal(
        imitated, np.repeat([1.0, 0.5, 0.0], [16, 4, 12])
    )  # nothing goes wrong in these episodes


def test_examples_are_logged_states_with_what_was_done_there(rng: np.random.Generator) -> None:
    logs, live = stores()
    replay = MixedReplay(config(horizon=1), toy.task(), gamma=GAMMA, logs=logs, live=live)
    found = replay.examples(rng)
    rows = np.arange(len(logs))
    known = {
        state.tobytes(): action
        for state, action in zip(logs.take("state", rows), logs.take("action", rows), strict=True)
    }
    wanted = np.stack([known[state.numpy().tobytes()] for state in found.state])
    np.testing.assert_array_equal(found.action.numpy(), wanted)
    np.testing.assert_array_equal(found.imitated.numpy(), np.ones((len(wanted), 1)))


def test_a_steady_motion_is_imitated_in_hindsight_and_what_was_done_otherwise(
    rng: np.random.Generator,
) -> None:
    motion = Motion(slice(3, 5), np.array([0.1, 0.2]))
    state, reached = np.zeros((3, 8), np.float32), np.zeros((3, 8), np.float32)
    reached[:, 3:5] = [[0.4, -0.4], [0.0, 0.1], [9.0, -9.0]]
    np.testing.assert_allclose(
        moved(motion, state, reached, np.array([8, 1, 2])),
        [[0.5, -0.25], [0.0, 0.5], [1.0, -1.0]],
        rtol=1e-6,
    )
    _, live = stores()
    task = replace(toy.task(), motion=Motion(slice(0, toy.N_U), np.full(toy.N_U, 0.01)))
    batch = MixedReplay(config(hindsight=0.5, horizon=1), task, gamma=GAMMA, live=live).sample(rng)
    same = (batch.wanted == batch.action).all(dim=1).numpy()
    np.testing.assert_array_equal(same, np.arange(32) >= 16)


def test_stores_that_cannot_be_mixed_are_refused() -> None:
    logs, _ = stores()
    with pytest.raises(ConfigError, match="expected logs, live steps or both, got neither"):
        MixedReplay(config(), toy.task(), gamma=GAMMA)
    with pytest.raises(
        ConfigError, match=r"replay\.log_hindsight: expected to know where goals stand"
    ):
        MixedReplay(
            config(log_hindsight=0.5), replace(toy.task(), view=None), gamma=GAMMA, logs=logs
        )
    other = Transitions.ring(100, 1, widths=(5, toy.N_U, 2), reward=toy.reward)
    with pytest.raises(
        ConfigError,
        match=r"logs have widths \(n_x, n_u, k\) = \(18, 9, 2\), live steps \(5, 9, 2\)",
    ):
        MixedReplay(config(), toy.task(), gamma=GAMMA, logs=logs, live=other)
