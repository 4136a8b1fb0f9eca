"""Support polygon and zero-moment point, against convex hulls by scipy and point masses by hand."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull, QhullError

from coordlog.kinematics.balance import CONTACT_HEIGHT, GRAVITY, support_margin, zero_moment_point

FOOT = np.array([[-0.0425, -0.0234], [-0.0425, 0.029], [0.1005, -0.0234], [0.1005, 0.029]])
SIDE = np.array([0.0, 0.045])


def feet(rng):
    """Corners of two feet at random places and headings, flat on the floor, (8, 3)."""
    corners = []
    for side in (0.045, -0.045):
        angle = rng.uniform(-0.6, 0.6)
        R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        corners.append(FOOT @ R.T + [rng.uniform(-0.05, 0.05), side + rng.uniform(-0.02, 0.02)])
    return np.column_stack([np.concatenate(corners), np.zeros(8)])


def hull_margin(point, corners):
    """Signed distance to the edges of the hull of the low corners: scipy's facets are outward
    normals with offsets."""
    low = corners[corners[:, 2] < CONTACT_HEIGHT, :2]
    try:
        equations = ConvexHull(low).equations
    except (QhullError, ValueError):
        return -np.inf
    return -(equations[:, :2] @ point + equations[:, 2]).max()


def distance_outside(point, corners):
    """Distance of a point outside to the hull of the low corners, by its edges."""
    hull = ConvexHull(corners[corners[:, 2] < CONTACT_HEIGHT, :2])
    nearest = np.inf
    for a, b in hull.points[hull.simplices]:
        along = np.clip((point - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        nearest = min(nearest, np.linalg.norm(point - a - along * (b - a)))
    return nearest


def agrees(point, corners):
    """Inside, the margin is the hull's. Outside it is negative and bounds the distance.

    Returns whether inside.
    """
    wanted, got = hull_margin(point, corners), support_margin(point, corners)
    if wanted > 0 or wanted == -np.inf:
        assert got == pytest.approx(wanted, abs=1e-12)
    else:
        assert -distance_outside(point, corners) - 1e-12 <= got <= wanted + 1e-12
    return wanted > 0


def test_agrees_with_the_convex_hull_of_two_feet():
    rng = np.random.default_rng(0)
    inside = sum(agrees(rng.uniform([-0.12, -0.15], [0.18, 0.15]), feet(rng)) for _ in range(400))
    assert 60 < inside < 340


def test_agrees_with_the_convex_hull_of_any_points():
    rng = np.random.default_rng(1)
    corners = (
        np.column_stack([rng.normal(size=(8, 2)), rng.choice([0.0, 0.1], size=8, p=[0.6, 0.4])])
        for _ in range(300)
    )
    inside = sum(agrees(rng.normal(size=2) * 0.5, each) for each in corners)
    assert 50 < inside < 250


def test_corners_in_the_air_do_not_count():
    corners = np.column_stack([np.concatenate([FOOT + SIDE, FOOT - SIDE]), np.zeros(8)])
    middle = np.array([0.02, 0.0])
    assert support_margin(middle, corners) == pytest.approx(0.0625, abs=1e-3)
    corners[4:, 2] = (
        CONTACT_HEIGHT  # the right foot lifts off: the middle is no longer over the left one
    )
    assert support_margin(middle, corners) < 0
    assert support_margin(np.array([0.02, 0.05]), corners) > 0.02


def test_without_an_area_there_is_no_support():
    corners = np.column_stack([np.concatenate([FOOT, FOOT]), np.full(8, 0.1)])
    assert support_margin(np.zeros(2), corners) == -np.inf
    corners[0, 2] = 0.0
    assert support_margin(np.zeros(2), corners) == -np.inf
    corners[1, 2] = 0.0
    assert support_margin(np.zeros(2), corners) == -np.inf  # an edge
    line = np.column_stack([np.linspace(0, 1, 8), np.linspace(0, 2, 8), np.zeros(8)])
    assert support_margin(np.array([0.5, 1.0]), line) == -np.inf


def test_three_corners_are_a_triangle():
    corners = np.array([[0, 0, 0], [3, 0, 0], [0, 4, 0], [9, 9, 9]], dtype=float)
    assert support_margin(np.array([1.0, 1.0]), corners) == pytest.approx(
        1.0
    )  # the incircle's radius


def test_nan_is_no_support():
    corners = feet(np.random.default_rng(0))
    assert support_margin(np.array([np.nan, 0.0]), corners) == -np.inf
    assert support_margin(np.zeros(2), np.full_like(corners, np.nan)) == -np.inf


def test_a_batch_and_a_single_robot_give_the_same_bits():
    rng = np.random.default_rng(2)
    corners = np.stack([feet(rng) for _ in range(64)])
    corners[..., 2] = rng.choice([0.0, 0.05], size=(64, 8), p=[0.8, 0.2])
    points = rng.uniform(-0.1, 0.1, size=(64, 2))
    batch = support_margin(points, corners)
    assert (
        batch.tobytes()
        == support_margin(points.reshape(4, 16, 2), corners.reshape(4, 16, 8, 3)).tobytes()
    )
    for i in range(64):
        assert support_margin(points[i], corners[i]).tobytes() == batch[i].tobytes()
    flat = corners.copy()
    flat[..., 2] = 0.0  # nobody lifts a corner: another way through the function
    batch = support_margin(points, flat)
    mixed = support_margin(points[:2], np.stack([flat[0], corners[1]]))
    assert mixed[0].tobytes() == batch[0].tobytes()


def test_the_zero_moment_point_of_a_still_robot_is_under_its_centre_of_mass():
    com = np.array([[0.02, -0.01, 0.46]])
    assert zero_moment_point(com, np.zeros((1, 3))).tolist() == com[:, :2].tolist()


def test_the_zero_moment_point_of_a_point_mass():
    rng = np.random.default_rng(3)
    com, acceleration = rng.uniform(0.1, 0.5, (20, 3)), rng.uniform(-3, 3, (20, 3))
    for c, a, p in zip(com, acceleration, zero_moment_point(com, acceleration), strict=True):
        force = a + np.array([0, 0, GRAVITY])  # what the floor gives, per kilogram
        moment = np.cross(np.array([*p, 0.0]) - c, force)  # of that force about the mass
        assert moment[:2] == pytest.approx([0.0, 0.0], abs=1e-12)


def test_accelerating_forwards_moves_it_backwards_and_free_fall_is_finite():
    com = np.array([[0.0, 0.0, 0.5]])
    assert zero_moment_point(com, np.array([[2.0, 0.0, 0.0]]))[0, 0] < -0.05
    assert np.isfinite(zero_moment_point(com, np.array([[2.0, 0.0, -20.0]]))).all()
