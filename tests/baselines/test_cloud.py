"""PCA planes, spacing, and values carried from a cloud or a mesh to other points."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from riemlayer.baselines.cloud import carry_over, checked_cloud, mean_spacing, pca_normals
from riemlayer.baselines.mesh import SurfaceInterpolation


def plane(n: int = 400, seed: int = 0) -> np.ndarray:
    """Random points of a tilted plane, and its normal's direction is (1, 1, 1)."""
    xy = np.random.default_rng(seed).uniform(-1, 1, (n, 2))
    axes = np.linalg.qr(np.array([[1.0, 1, 1], [1, -1, 0], [1, 1, -2]]).T)[0]
    return xy @ axes[:, 1:].T


def test_normal_of_a_plane():
    points = plane()
    normals = pca_normals(points, KDTree(points), points[:20], k=10)
    np.testing.assert_allclose(np.abs(normals), 1 / np.sqrt(3), atol=1e-7)


def test_mean_spacing_of_a_grid_is_its_step():
    x = np.arange(20.0) * 0.25
    points = np.stack(np.meshgrid(x, x, [0.0]), -1).reshape(-1, 3)
    tree = KDTree(points)
    assert mean_spacing(points, tree, 1) == 0.25
    inner = 4 * [0.25] + 2 * [0.25 * np.sqrt(2)]
    assert mean_spacing(points, tree, 6) == pytest.approx(np.mean(inner), rel=0.05)


def test_carry_over_keeps_the_values_of_the_cloud():
    points = plane()
    values = np.random.default_rng(1).normal(size=(len(points), 2))
    np.testing.assert_array_equal(carry_over(points, values, KDTree(points), points, 9), values)


def test_carry_over_reproduces_affine_functions_on_a_plane():
    points = plane()
    queries = 0.8 * plane(50, seed=2)
    matrix = np.random.default_rng(3).normal(size=(3, 2))
    carried = carry_over(points, points @ matrix + 5, KDTree(points), queries, 12)
    np.testing.assert_allclose(carried, queries @ matrix + 5, atol=1e-9)


def test_carry_over_of_a_constant_is_the_constant_even_on_a_line():
    points = np.linspace([0.0, 0, 0], [1.0, 0, 0], 30)
    beside = points + np.array([0.01, 0.02, 0])
    carried = carry_over(points, np.ones((30, 1)), KDTree(points), beside, 6)
    np.testing.assert_allclose(carried, 1)


def test_interpolation_on_a_mesh_is_linear_and_exact_at_vertices():
    vertices = np.array([[0.0, 0, 0], [2, 0, 0], [0, 2, 0], [2, 2, 0]])
    interpolate = SurfaceInterpolation(vertices, np.array([[0, 1, 2], [1, 3, 2]]))
    values = vertices[:, :2] @ np.array([[1.0], [3.0]])
    queries = np.array([[0.5, 0.25, 0], [1.5, 1.75, 0], [2, 0, 0]])
    np.testing.assert_allclose(interpolate(values, queries)[:, 0], [1.25, 6.75, 2.0])


def test_interpolation_does_not_cross_a_thin_wall():
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    faces = np.array([[0, 1, 2], [1, 3, 2]])
    wall = np.concatenate([corners, corners + np.array([0, 0, 0.01])])
    interpolate = SurfaceInterpolation(wall, np.concatenate([faces, faces + 4]))
    values = np.repeat([[0.0], [1.0]], 4, axis=0)
    np.testing.assert_allclose(interpolate(values, np.array([[0.4, 0.4, 0.01]])), [[1.0]])


def test_carry_over_from_points_that_coincide_is_their_value():
    points = np.zeros((9, 3))
    carried = carry_over(points, np.full((9, 1), 2.0), KDTree(points), np.ones((1, 3)), 6)
    np.testing.assert_allclose(carried, 2)


def test_a_query_beside_the_mesh_takes_no_part_of_the_vertex_behind():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    interpolate = SurfaceInterpolation(vertices, np.array([[0, 1, 2]]))
    values = np.array([[0.0], [0.0], [1.0]])
    assert interpolate(values, np.array([[0.25, -0.5, 0]])) == 0


def test_a_cloud_that_is_none_is_refused():
    with pytest.raises(ValueError, match="points"):
        checked_cloud(np.full((9, 3), np.nan))
    with pytest.raises(ValueError, match=r"\(N, 3\)"):
        checked_cloud(np.zeros((9, 2)))
