"""Sums of rewards over several steps."""

from __future__ import annotations

import numpy as np
import pytest

from coordlog.train.returns import n_step


def test_one_step_is_the_step_itself(rng: np.random.Generator) -> None:
    reward, ended = rng.normal(size=(9, 1, 2)), rng.random((9, 1)) < 0.5
    found = n_step(reward, ended, np.ones((9, 1), bool), gamma=0.9)
    np.testing.assert_array_equal(found.reward, reward[:, 0])
    np.testing.assert_array_equal(found.discount, np.where(ended[:, 0], 0, 0.9))
    assert not found.last.any()


def test_sums_stop_where_the_task_ends_and_where_the_record_does() -> None:
    reward = np.array([1.0, 2.0, 4.0, 8.0])[None, :, None] * np.ones((4, 1, 1))
    ended = np.zeros((4, 4), bool)
    ended[1, 1] = ended[3, 2] = True
    within = np.ones((4, 4), bool)
    within[2, 3:] = within[3, 1:] = False
    found = n_step(reward, ended, within, gamma=0.5)
    np.testing.assert_allclose(found.reward[:, 0], [1 + 1 + 1 + 1, 1 + 1, 1 + 1 + 1, 1])
    np.testing.assert_allclose(found.discount, [0.5**4, 0, 0.5**3, 0.5])
    np.testing.assert_array_equal(found.last, [3, 1, 2, 0])


@pytest.mark.parametrize("n", [1, 3, 8])
def test_sums_are_those_of_a_plain_loop(n: int, rng: np.random.Generator) -> None:
    reward, ended = rng.normal(size=(50, n, 3)), rng.random((50, n)) < 0.2
    within = np.arange(n) <= rng.integers(0, n, 50)[:, None]
    found = n_step(reward, ended, within, gamma=0.8)
    for row in range(50):
        total, weight, last = np.zeros(3), 1.0, 0
        for step in range(n):
            total, weight, last = total + weight * reward[row, step], weight * 0.8, step
            if ended[row, step] or step + 1 == n or not within[row, step + 1]:
                break
        np.testing.assert_allclose(found.reward[row], total)
        assert found.last[row] == last
        assert found.discount[row] == pytest.approx(0.0 if ended[row, last] else weight)
