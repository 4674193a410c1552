"""The truth of one mesh where it is known, its queries, and the inputs made of it."""

import numpy as np
import pytest
import trimesh
from references import flat_grid, length

from riemlayer.tables.truth import cloud, draw_queries, ground_truth, shape_arrays

# The truth of one mesh


def test_on_a_plane_exp_and_log_are_the_chord():
    vertices, faces = flat_grid()
    src = np.array([20 * 41 + 20, 22 * 41 + 19])
    vec = np.random.default_rng(0).uniform(-0.35, 0.35, (2, 300, 3)) * [1, 1, 0]
    true = ground_truth(vertices, faces, src, vec)
    chord = vertices - vertices[src][:, None]
    inside = length(chord) < 0.48
    np.testing.assert_allclose(true["end"], vertices[src][:, None] + vec, atol=1e-7)
    np.testing.assert_allclose(true["log"][inside], chord[inside], atol=2e-3)
    assert true["ok"].all() and true["valid"][inside].all() and true["valid_tight"][inside].all()
    assert not true["valid"][length(chord) > 0.52].any()


def test_a_geodesic_that_leaves_the_mesh_does_not_count():
    vertices, faces = flat_grid()
    src = np.array([2 * 41 + 20])  # 0.1 from the side x = -1
    angle = 2 * np.pi * np.arange(60) / 60
    vec = 0.3 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)[None]
    leaves = vec[..., 0] < -0.1 - 1e-6
    assert np.array_equal(ground_truth(vertices, faces, src, vec)["ok"], ~leaves)


def test_across_the_cut_locus_nothing_is_tight():
    """On a cylinder of radius 0.1 geodesics longer than half way round are not the shortest."""
    around, along = 40, 200
    angle, z = np.meshgrid(
        2 * np.pi * np.arange(around) / around, np.linspace(-1, 1, along), indexing="ij"
    )
    vertices = np.stack([0.1 * np.cos(angle), 0.1 * np.sin(angle), z], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(around), np.arange(along - 1), indexing="ij")
    a, b = (i * along + j).ravel(), ((i + 1) % around * along + j).ravel()
    faces = np.concatenate([np.stack([a, b, a + 1], -1), np.stack([a + 1, b, b + 1], -1)])
    src, vec = np.array([along // 2]), np.random.default_rng(0).uniform(-0.5, 0.5, (1, 2000, 3))
    vec[..., 0] = 0  # the normal of the source
    vec = vec[:, length(vec[0]) < 0.5]
    true = ground_truth(vertices, faces, src, vec)
    across = np.abs(vec[..., 1])
    assert not true["ok_tight"][across > 0.1 * np.pi + 0.06].any()
    once = across < 0.2 * np.pi - 0.53  # the other way round is longer than any vector
    assert once.sum() > 100 and true["ok_tight"][once].all()
    turn = np.abs((angle.ravel() + np.pi) % (2 * np.pi) - np.pi)
    distance = np.hypot(0.1 * turn, z.ravel() - z.ravel()[src])
    collapsed = (length(true["log"][0]) < 0.5) & (distance > 0.56)
    assert collapsed.any() and not true["valid"][0, collapsed].any()
    assert true["ok"].sum() > true["ok_tight"].sum()


def test_vectors_are_tangent_and_uniform_by_area():
    sphere = trimesh.creation.icosphere(3)
    src, normal, vec = draw_queries(sphere.vertices, sphere.faces, 5, np.random.default_rng(0))
    assert len(set(src.tolist())) == 5
    np.testing.assert_allclose((vec * normal[:, None]).sum(-1), 0, atol=1e-12)
    share = np.sort(length(vec) / 0.5, axis=-1) ** 2
    np.testing.assert_allclose(
        share, np.linspace(0, 1, share.shape[1])[None].repeat(5, 0), atol=0.05
    )
    np.testing.assert_allclose(vec.mean(1), 0, atol=0.02)


@pytest.mark.parametrize("sources", [0, 163])
def test_a_number_of_sources_that_no_mesh_has_is_named(sources):
    sphere = trimesh.creation.icosphere(2)
    with pytest.raises(ValueError, match=f"sources must lie between 1 and 162 .* got {sources}"):
        shape_arrays(sphere.vertices, sphere.faces, sources, 0)


# The inputs of Sec. 4.1


def test_noise_is_uniform_in_length():
    x = np.random.default_rng(0).normal(size=(20_000, 3)).astype(np.float32)
    moved = np.sort(length(cloud("noisy", x, np.zeros((1, 3)), 1) - x))
    np.testing.assert_allclose(moved, np.linspace(0, 0.015, len(x)), atol=3e-4)


def test_the_uneven_cloud_lies_on_the_surface_and_its_density_varies():
    vertices, faces = flat_grid()
    points = cloud("nonuniform", vertices.astype(np.float32), faces.astype(np.int32), 1)
    assert np.abs(points[:, 2]).max() == 0 and np.abs(points).max() <= 1
    counts = np.histogram2d(points[:, 0], points[:, 1], bins=8)[0]
    assert 3 < counts.max() / counts.min() < 40
    assert points.dtype == np.float32


def test_inputs_depend_on_their_seed_alone():
    vertices, faces = (x.astype(t) for x, t in zip(flat_grid(), ("f4", "i4"), strict=True))
    for name in ("noisy", "nonuniform"):
        first, again, other = (cloud(name, vertices, faces, seed) for seed in (1, 1, 2))
        assert np.array_equal(first, again)
        assert first.shape != other.shape or not np.array_equal(first, other)
    with pytest.raises(ValueError, match=r"inputs must be among .*, got 'rotten'"):
        cloud("rotten", vertices, faces, 0)
