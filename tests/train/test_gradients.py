from __future__ import annotations

import numpy as np
import pytest
import torch

from coordlog.errors import ConfigError
from coordlog.train.gradients import gradient_mask, head_weights, project_conflicts


def test_private_joints_count_once_shared_ones_share_and_others_not_at_all() -> None:
    mask = gradient_mask({"left": [0, 1, 2], "right": [0, 3], "third": [0, 1]}, 4)
    np.testing.assert_allclose(mask, [[1 / 3, 1 / 2, 1, 0], [1 / 3, 0, 0, 1], [1 / 3, 1 / 2, 0, 0]])
    np.testing.assert_allclose(mask.sum(axis=0), 1)


def test_one_arm_has_the_plain_gradient() -> None:
    np.testing.assert_array_equal(gradient_mask({"only": [2, 0, 1]}, 3), [[1, 1, 1]])


@pytest.mark.parametrize(
    ("arms", "message"),
    [
        ({"left": [0], "right": [1]}, r"actions \[2\] serve no arm"),
        (
            {"left": [0, 3], "right": [1, 2]},
            r"arm 'left': expected action indices between 0 and 2, got \[0, 3\]",
        ),
        ({"left": [], "right": [0, 1, 2]}, r"arm 'left': expected action indices"),
        ({"left": [-1, 0], "right": [1, 2]}, r"arm 'left': expected action indices"),
    ],
)
def test_an_action_that_could_never_learn_is_an_error(
    arms: dict[str, list[int]], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        gradient_mask(arms, 3)


def test_the_ablations_see_every_joint_from_every_head() -> None:
    mask = gradient_mask({"left": [0, 1], "right": [0, 2]}, 3)
    np.testing.assert_array_equal(head_weights("mask", mask), mask)
    np.testing.assert_array_equal(head_weights("sum", mask), np.ones((2, 3)))
    np.testing.assert_array_equal(head_weights("mean", mask), np.full((2, 3), 0.5))
    np.testing.assert_array_equal(head_weights("pcgrad", mask), np.ones((2, 3)))


def test_gradients_that_agree_are_added_and_opposing_parts_are_removed() -> None:
    generator = torch.Generator().manual_seed(0)
    agreeing = [torch.tensor([1.0, 0.0]), torch.tensor([1.0, 1.0])]
    torch.testing.assert_close(
        project_conflicts(agreeing, generator=generator), torch.tensor([2.0, 1.0])
    )
    first, second = torch.tensor([1.0, 0.0]), torch.tensor([-1.0, 1.0])
    wanted = (first + 0.5 * second) + (second + first)  # each loses its component along the other
    torch.testing.assert_close(project_conflicts([first, second], generator=generator), wanted)


def test_a_projected_gradient_opposes_no_task_of_two() -> None:
    generator = torch.Generator().manual_seed(3)
    for _ in range(20):
        pair = list(torch.randn(2, 6, generator=generator))
        merged = project_conflicts(pair, generator=generator)
        assert all(torch.dot(merged, gradient) > -1e-5 for gradient in pair)
