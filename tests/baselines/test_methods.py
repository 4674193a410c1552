"""The rivals on surfaces whose Exp and Log are known in closed form."""

import numpy as np
import pytest
import trimesh

from riemlayer.baselines import (
    Heat,
    MeshHeat,
    MeshTracer,
    Projection,
    SupportsExp,
    SupportsLog,
    SupportsMesh,
    SupportsPoints,
    TrueLog,
    Walking,
)

POLE = np.array([0.0, 0, 1])


def sphere(n: int = 2000) -> np.ndarray:
    """Evenly spread points (Fibonacci) of the unit sphere, the pole among them."""
    i = np.arange(n)
    z = 1 - 2 * i / (n - 1)
    r, turn = np.sqrt(np.maximum(1 - z * z, 0)), i * np.pi * (3 - np.sqrt(5))
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], -1)


def vectors(length: float = 0.5, n: int = 24) -> np.ndarray:
    """Vectors of one length in the pole's tangent plane."""
    turn = np.linspace(0, 2 * np.pi, n, endpoint=False)
    return length * np.stack([np.cos(turn), np.sin(turn), 0 * turn], -1)


def sphere_exp(v: np.ndarray) -> np.ndarray:
    """Exp at the pole of the unit sphere."""
    r = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.cos(r) * POLE + np.sin(r) * v / r


def error(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm(np.asarray(a) - b, axis=-1).mean())


@pytest.fixture(scope="module")
def icosphere() -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.icosphere(subdivisions=4)
    turn = trimesh.geometry.align_vectors(mesh.vertices[0], POLE)[:3, :3]
    return np.asarray(mesh.vertices) @ turn.T, np.asarray(mesh.faces)


def test_projection_on_a_sphere_is_the_sine_and_snaps_to_the_cloud():
    method = Projection()
    method.prepare(sphere())
    v = vectors()
    shortened = v * np.sin(0.5) / 0.5
    assert error(method.log(POLE, sphere_exp(v)), shortened) < 0.02
    distance = np.linalg.norm(method.exp(POLE, v)[:, None] - sphere()[None], axis=-1).min(-1)
    assert distance.max() == 0


def test_walking_follows_great_circles_and_beats_projection():
    walking, projection = Walking(), Projection()
    for method in (walking, projection):
        method.prepare(sphere())
    v = vectors(1.0)
    assert error(walking.exp(POLE, v), sphere_exp(v)) < 0.02
    assert error(projection.exp(POLE, v), sphere_exp(v)) > 0.15


def test_walking_gets_better_with_the_cloud():
    errors = []
    for n in (500, 2000, 8000):
        method = Walking()
        method.prepare(sphere(n))
        errors.append(error(method.exp(POLE, vectors()), sphere_exp(vectors())))
    assert errors[0] > 2 * errors[1] > 4 * errors[2]


def test_walking_covers_exactly_its_length_on_a_plane():
    x = np.linspace(-1, 1, 21)
    method = Walking()
    method.prepare(np.stack(np.meshgrid(x, x, [0.0]), -1).reshape(-1, 3))
    p, v = np.array([0.03, -0.02, 0]), np.array([[0.31, 0.57, 0], [0, 0.004, 0]])
    np.testing.assert_allclose(method.exp(p, v), p + v, atol=1e-12)


def test_walking_nowhere_stays_at_p():
    method = Walking()
    method.prepare(sphere(500))
    np.testing.assert_array_equal(method.exp(POLE, np.zeros((2, 3))), [POLE, POLE])


def test_walking_refuses_a_vector_that_is_not_finite():
    method = Walking()
    method.prepare(sphere(500))
    with pytest.raises(ValueError, match="finite"):
        method.exp(POLE, np.array([[np.nan, 0, 0]]))


def test_heat_on_a_sphere():
    method = Heat()
    method.prepare(sphere())
    for length, bound in ((0.25, 0.03), (0.5, 0.05)):
        v = vectors(length)
        assert error(method.log(POLE, sphere_exp(v)), v) < bound


def test_heat_solves_anew_for_a_new_source_and_a_new_cloud():
    method, q = Heat(), sphere_exp(vectors())
    method.prepare(sphere())
    first = method.log(POLE, q)
    assert error(method.log(-POLE, q), first) > 0.5
    np.testing.assert_array_equal(method.log(POLE, q), first)
    method.prepare(2 * sphere())
    np.testing.assert_allclose(method.log(2 * POLE, 2 * q), 2 * first, atol=1e-6)


@pytest.mark.parametrize(("strategy", "bound"), [("AffineLocal", 0.005), ("VectorHeat", 0.04)])
def test_mesh_heat_on_a_sphere(icosphere, strategy, bound):
    method, v = MeshHeat(strategy), vectors()
    method.prepare_mesh(*icosphere)
    assert error(method.log(POLE, sphere_exp(v)), v) < bound


def test_mesh_tracer_on_a_sphere(icosphere):
    method, v = MeshTracer(), vectors()
    method.prepare_mesh(*icosphere)
    assert error(method.exp(POLE, v), sphere_exp(v)) < 0.005


def test_true_log_answers_its_table_and_nothing_else(icosphere):
    vertices, faces = icosphere
    table = np.random.default_rng(0).normal(size=(2, len(vertices), 3))
    method = TrueLog()
    method.prepare_truth(vertices, faces, np.array([3, 11]), table)
    np.testing.assert_array_equal(method.log(vertices[11], vertices), table[1])
    with pytest.raises(ValueError, match="p must be a source of the table"):
        method.log(vertices[12], vertices)


@pytest.mark.parametrize("method", [Projection(), Walking(), Heat()], ids=repr)
def test_rivals_leave_their_input_alone_and_answer_twice_the_same(method):
    points = sphere(800).astype(np.float32)
    v, before = vectors().astype(np.float32), points.copy()
    ask = method.exp if isinstance(method, SupportsExp) else method.log
    method.prepare(points)
    first = ask(POLE, v)
    np.testing.assert_array_equal(ask(POLE, v), first)
    np.testing.assert_array_equal(points, before)
    np.testing.assert_array_equal(v, vectors().astype(np.float32))


def test_each_method_has_the_maps_it_claims():
    has = {
        type(method).__name__: (
            isinstance(method, SupportsPoints),
            isinstance(method, SupportsMesh),
            isinstance(method, SupportsLog),
            isinstance(method, SupportsExp),
        )
        for method in (Heat(), Projection(), Walking(), MeshHeat(), MeshTracer(), TrueLog())
    }
    assert has == {
        "Heat": (True, False, True, False),
        "Projection": (True, False, True, True),
        "Walking": (True, False, False, True),
        "MeshHeat": (False, True, True, False),
        "MeshTracer": (False, True, False, True),
        "TrueLog": (False, False, True, False),
    }
