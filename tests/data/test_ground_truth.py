"""Traced geodesics against surfaces where they are known, and the filters on them."""

import math

import gpytoolbox
import numpy as np
import pytest
import torch
import trimesh

from riemlayer.data.closed_form import Sphere
from riemlayer.data.cut_locus import divergence, filter_cut_locus
from riemlayer.data.ground_truth import (
    sample_tangent_vectors,
    shape_ground_truth,
    shortest_mask,
    trace,
)
from riemlayer.data.manifold import vertex_normals


def icosphere(subdivisions, radius=1.0):
    mesh = trimesh.creation.icosphere(subdivisions, radius)
    return np.array(mesh.vertices), np.array(mesh.faces)


def crooked_grid(n=12):
    """An open square [0, 1]^2 x {0} with irregular triangles, and its inner vertices."""
    rng = np.random.default_rng(0)
    i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    inner = (i > 0) & (i < n - 1) & (j > 0) & (j < n - 1)
    xy = np.stack([i, j], -1) / (n - 1) + 0.3 / n * rng.uniform(-1, 1, (n, n, 2)) * inner[..., None]
    corner = (i * n + j)[:-1, :-1].ravel()
    faces = np.concatenate([corner[:, None] + [0, n, n + 1], corner[:, None] + [0, n + 1, 1]])
    return np.c_[xy.reshape(-1, 2), np.zeros(n * n)], faces, np.flatnonzero(inner)


def bumpy_sphere(subdivisions=3):
    vertices, faces = icosphere(subdivisions)
    return vertices * (1 + 0.2 * np.sin(5 * vertices[:, :1] + 3 * vertices[:, 1:2])), faces


# Tracing


def test_tracing_a_plane_adds_v():
    vertices, faces, inner = crooked_grid()
    sources = inner[::17]
    v = sample_tangent_vectors(
        np.tile([0.0, 0, 1], (len(sources), 1)), 40, 0.5, np.random.default_rng(1)
    )
    q, complete = trace(vertices, faces, sources, v)
    goal = vertices[sources][:, None] + v
    stays = ((goal[..., :2] > 0) & (goal[..., :2] < 1)).all(-1)
    assert 0.3 < stays.mean() < 0.9
    np.testing.assert_array_equal(complete, stays)
    np.testing.assert_allclose(q[stays], goal[stays], atol=1e-12)


def test_tracing_an_icosphere_is_exp_of_the_sphere():
    vertices, faces = icosphere(4)
    sources = np.arange(0, 2000, 100)
    normal = vertex_normals(vertices, faces)[sources]
    v = sample_tangent_vectors(normal, 60, 0.5, np.random.default_rng(2))
    q, complete = trace(vertices, faces, sources, v)
    exact = Sphere().exp(torch.from_numpy(vertices[sources])[:, None], torch.from_numpy(v)).numpy()
    assert complete.all()
    assert np.linalg.norm(q - exact, axis=-1).max() < 1e-2


def test_finer_icospheres_are_traced_better():
    errors = []
    for subdivisions in (2, 3, 4):
        vertices, faces = icosphere(subdivisions)
        sources = np.arange(12)  # these vertices are in all three
        normal = vertex_normals(vertices, faces)[sources]
        v = sample_tangent_vectors(normal, 100, 1.0, np.random.default_rng(3))
        q, _ = trace(vertices, faces, sources, v)
        p = torch.from_numpy(vertices[sources])[:, None]
        exact = Sphere().exp(p, torch.from_numpy(v)).numpy()
        errors.append(np.linalg.norm(q - exact, axis=-1).mean())
    assert errors[0] > 3 * errors[1] > 9 * errors[2]  # second order is 4


def test_the_tracer_ignores_only_what_is_along_our_normal():
    vertices, faces = bumpy_sphere()
    sources = np.arange(0, 600, 60)
    normal = vertex_normals(vertices, faces)[sources]
    v = sample_tangent_vectors(normal, 20, 0.5, np.random.default_rng(4))
    q, _ = trace(vertices, faces, sources, v)
    lifted, _ = trace(vertices, faces, sources, v + 0.3 * normal[:, None])
    np.testing.assert_allclose(lifted, q, atol=1e-9)


def test_trace_of_zero_is_p():
    vertices, faces = bumpy_sphere()
    q, complete = trace(vertices, faces, np.array([5]), np.zeros((1, 2, 3)))
    np.testing.assert_array_equal(q[0], vertices[[5, 5]])
    assert complete.all()


@pytest.mark.parametrize(
    ("sources", "v", "said"),
    [
        ([0], np.zeros((2, 3, 3)), "v must have shape"),
        ([0], np.zeros((1, 3)), "v must have shape"),
        ([99], np.zeros((1, 3, 3)), "sources must index the 42 vertices"),
        ([0], np.full((1, 3, 3), np.nan), "v must be finite"),
    ],
)
def test_trace_rejects_bad_input(sources, v, said):
    with pytest.raises(ValueError, match=said):
        trace(*icosphere(1), np.array(sources), v)


# Tangent vectors


def test_tangent_vectors_are_orthogonal_bounded_and_paired():
    rng = np.random.default_rng(5)
    normal = rng.normal(size=(40, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    v = sample_tangent_vectors(normal, 400, 0.5, rng)
    assert np.abs((v * normal[:, None]).sum(-1)).max() < 1e-12
    first, second = np.split(v, 2, axis=1)
    assert np.linalg.norm(first, axis=-1).max() <= 0.5
    assert np.linalg.norm(second, axis=-1).max() <= 0.52 + 1e-12
    apart = np.linalg.norm(first - second, axis=-1)
    assert 0.02 < apart.mean() < 0.035
    assert apart.max() < 0.15


def test_half_of_the_first_half_is_uniform_by_area():
    v = sample_tangent_vectors(np.array([0.0, 0, 1]), 40_000, 0.5, np.random.default_rng(6))
    length = np.linalg.norm(v[:20_000], axis=-1)
    assert (length[::2] < 0.25).mean() == pytest.approx(1 / 4, abs=0.015)
    assert (length[1::2] < 0.25).mean() == pytest.approx(1 / 2, abs=0.015)
    np.testing.assert_allclose(v.mean(0), 0, atol=0.01)


def test_an_odd_number_of_vectors_is_refused():
    with pytest.raises(ValueError, match="K must be even"):
        sample_tangent_vectors(np.array([0.0, 0, 1]), 7, 0.5, np.random.default_rng(0))


# Filters


def test_the_filter_flags_vectors_beyond_pi_on_the_unit_sphere():
    rng = np.random.default_rng(7)
    length = 1.1 * math.pi * np.sqrt(rng.random(20_000))
    angle = 2 * math.pi * rng.random(20_000)
    v = np.stack([length * np.cos(angle), length * np.sin(angle), 0 * length], -1)
    q = Sphere().exp(torch.tensor([0.0, 0, 1], dtype=torch.float64), torch.from_numpy(v)).numpy()
    kept = filter_cut_locus(q, v)
    assert kept[length < 0.88 * math.pi].all()  # 0.9 pi is met from beyond by 1.1 pi
    assert kept[length > math.pi].mean() < 0.1
    assert filter_cut_locus(q, v, tau=10).all()


def test_divergence_is_equation_8():
    rng = np.random.default_rng(8)
    q, v = rng.normal(size=(2, 2, 30, 3))
    delta = divergence(q, v, k=5)
    for s in range(2):
        for i in range(30):
            near = np.argsort(np.linalg.norm(q[s] - q[s, i], axis=1))[1:6]
            expected = max(np.linalg.norm(v[s, i] - v[s, j]) for j in near)
            assert delta[s, i] == pytest.approx(expected)


def test_divergence_of_nothing_is_nothing():
    assert divergence(np.zeros((2, 0, 3)), np.zeros((2, 0, 3))).shape == (2, 0)


def test_divergence_rejects_bad_input():
    with pytest.raises(ValueError, match=r"shape \(..., K, 3\), got \(4, 3\) and \(5, 3\)"):
        divergence(np.zeros((4, 3)), np.zeros((5, 3)))
    with pytest.raises(ValueError, match="more than k = 5 points a source, got 5"):
        divergence(np.zeros((5, 3)), np.zeros((5, 3)))


def test_vectors_beyond_the_cut_locus_are_not_shortest():
    radius = 0.3
    vertices, faces = icosphere(4, radius)
    sources = np.array([0, 500, 1000])
    normal = vertex_normals(vertices, faces)[sources]
    v = sample_tangent_vectors(normal, 400, 1.4 * math.pi * radius, np.random.default_rng(9))
    q, _ = trace(vertices, faces, sources, v)
    shortest = shortest_mask(vertices, faces, sources, v, q)
    length = np.linalg.norm(v, axis=-1)
    assert shortest[length < 0.95 * math.pi * radius].mean() > 0.99
    assert shortest[length > 1.2 * math.pi * radius].mean() < 0.01


# A whole shape


def test_shape_ground_truth_keeps_its_promises():
    vertices, faces = bumpy_sphere()
    truth = shape_ground_truth(vertices, faces, seed=3, S=4, K=40)
    assert {name: x.shape for name, x in truth.items()} == {
        "p": (4, 3), "normal": (4, 3), "v": (4, 40, 3), "q": (4, 40, 3),
        "divergence": (4, 40), "complete": (4, 40), "shortest": (4, 40),
    }  # fmt: skip
    assert all(x.dtype == np.float32 for n, x in truth.items() if n not in ("complete", "shortest"))
    assert truth["complete"].dtype == truth["shortest"].dtype == bool
    assert truth["complete"].all()
    assert np.abs((truth["v"] * truth["normal"][:, None]).sum(-1)).max() < 1e-6
    square = gpytoolbox.squared_distance(
        truth["q"].reshape(-1, 3).astype(float), vertices, F=faces.astype(np.int32), use_cpp=True
    )[0]
    assert np.max(square) < 1e-12
    chord = np.linalg.norm(truth["q"] - truth["p"][:, None], axis=-1)
    assert (chord <= np.linalg.norm(truth["v"], axis=-1) + 1e-6).all()


def test_shape_ground_truth_depends_on_the_seed_alone():
    vertices, faces = bumpy_sphere()
    one, same, other = (shape_ground_truth(vertices, faces, s, S=3, K=20) for s in (1, 1, 2))
    assert all((one[name] == same[name]).all() for name in one)
    assert (one["v"] != other["v"]).any()


def test_sources_are_inner_vertices():
    vertices, faces, inner = crooked_grid()
    truth = shape_ground_truth(vertices, faces, seed=0, S=50, K=12)
    allowed = {tuple(x) for x in vertices[inner].astype(np.float32).tolist()}
    assert {tuple(x) for x in truth["p"].tolist()} <= allowed
    assert not truth["complete"].all()
