"""Safe norms, segment reductions, weighted rows and 3x3 eigenproblems against plain references."""

import pytest
import torch
from references import loop_segments, loop_weighted_rows, matrix
from torch.autograd import gradcheck

from riemlayer.numerics import (
    normalise,
    outer6,
    recomputed,
    safe_norm,
    segment_max,
    segment_mean,
    segment_sum,
    smallest_eigenvector,
    symmetric_eigenvalues,
    weighted_rows,
)


def double(*shape: int) -> torch.Tensor:
    return torch.randn(*shape, dtype=torch.float64)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_safe_norm_is_the_norm(dtype):
    x = torch.randn(50, 3, dtype=dtype) * 10.0 ** torch.randint(-6, 6, (50, 1))
    torch.testing.assert_close(safe_norm(x).squeeze(-1), x.norm(dim=-1))


@pytest.mark.parametrize("function", [safe_norm, normalise])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradients_at_zero_are_finite(function, dtype):
    x = torch.zeros(4, 3, dtype=dtype, requires_grad=True)
    function(x).sum().backward()
    assert x.grad is not None and x.grad.isfinite().all()
    assert (safe_norm(x) < 1e-15).all() and torch.equal(normalise(x), x)


def test_safe_norm_gradcheck():
    assert gradcheck(safe_norm, double(5, 3).requires_grad_(), check_forward_ad=True)


def test_normalise_gives_unit_vectors():
    torch.testing.assert_close(normalise(double(9, 3)).norm(dim=-1), double(9) * 0 + 1)


SEGMENTS = {"sum": segment_sum, "mean": segment_mean, "max": segment_max}


@pytest.mark.parametrize("name", SEGMENTS)
def test_segments_are_those_of_a_loop(name):
    x, index = double(40, 3) - 5, torch.randint(9, (40,))
    index[index == 4] = 5  # an empty group
    answer = SEGMENTS[name](x, index, 10)
    torch.testing.assert_close(answer, loop_segments(x, index, 10, name))
    assert (answer[[4, 9]] == 0).all()


@pytest.mark.parametrize("name", SEGMENTS)
def test_segments_gradcheck(name):
    x, index = double(12, 2).requires_grad_(), torch.randint(5, (12,))
    assert gradcheck(lambda x: SEGMENTS[name](x, index, 6), x)


def test_ties_share_the_gradient_of_the_maximum():
    x = torch.tensor([[2.0], [2.0], [1.0]], requires_grad=True)
    segment_max(x, torch.tensor([0, 0, 0]), 1).sum().backward()
    assert x.grad is not None and x.grad.squeeze(-1).tolist() == [0.5, 0.5, 0.0]


def test_weighted_rows_are_those_of_a_loop():
    table, index, weight = double(7, 4), torch.randint(7, (20, 5)), double(20, 5)
    expected = loop_weighted_rows(table, index, weight)
    torch.testing.assert_close(weighted_rows(table, index, weight), expected)


def test_weighted_rows_gradcheck_backward_and_forward():
    index = torch.randint(4, (6, 3))
    inputs = double(4, 2).requires_grad_(), double(6, 3).requires_grad_()
    assert gradcheck(lambda t, w: weighted_rows(t, index, w), inputs, check_forward_ad=True)


def test_weighted_rows_forward_mode_is_a_finite_difference():
    table, index, weight = double(6, 3), torch.randint(6, (9, 4)), double(9, 4)
    d_table, d_weight, step = double(6, 3), double(9, 4), 1e-6
    _, tangent = torch.func.jvp(
        lambda t, w: weighted_rows(t, index, w), (table, weight), (d_table, d_weight)
    )
    ahead = weighted_rows(table + step * d_table, index, weight + step * d_weight)
    behind = weighted_rows(table - step * d_table, index, weight - step * d_weight)
    torch.testing.assert_close(tangent, (ahead - behind) / (2 * step), rtol=0, atol=1e-7)


def test_outer6_is_the_outer_product_and_forgets_the_sign():
    n = double(8, 3)
    torch.testing.assert_close(matrix(outer6(n)), n[..., :, None] * n[..., None, :])
    assert torch.equal(outer6(-n), outer6(n))


def covariances(n: int = 200) -> torch.Tensor:
    """(n, 6) covariances of stretched clouds: thin, flat and round ones."""
    spread = double(n, 3, 5) * 10 ** (2 * torch.rand(n, 3, 1, dtype=torch.float64) - 2)
    m = torch.linalg.qr(double(n, 3, 3))[0] @ spread
    m = m @ m.mT
    i, j = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]
    return m[:, i, j]


def test_eigenvalues_are_those_of_eigh():
    m = covariances()
    expected = torch.linalg.eigvalsh(matrix(m))
    torch.testing.assert_close(symmetric_eigenvalues(m), expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    "entries, expected",
    [
        ([2.0, 2, 2, 0, 0, 0], [2.0, 2, 2]),
        ([1.0, 1, 5, 0, 0, 0], [1.0, 1, 5]),
        ([0.0, 0, 0, 0, 0, 0], [0.0, 0, 0]),
        ([1.0, 1, 1, 1, 1, 1], [0.0, 0, 3]),
    ],
)
def test_eigenvalues_of_degenerate_matrices(entries, expected):
    m = torch.tensor(entries, dtype=torch.float64, requires_grad=True)
    values = symmetric_eigenvalues(m)
    torch.testing.assert_close(values, values.new_tensor(expected), rtol=0, atol=1e-6)
    values.sum().backward()
    assert m.grad is not None and m.grad.isfinite().all()


def test_smallest_eigenvector_is_that_of_eigh():
    m = covariances()
    values, vectors = torch.linalg.eigh(matrix(m))
    clear = values[:, 1] > 2 * values[:, 0]  # elsewhere the direction is not defined
    assert clear.sum() > 100
    n = smallest_eigenvector(m, symmetric_eigenvalues(m)[:, 0])
    agree = (n * vectors[..., 0]).sum(-1).abs()
    torch.testing.assert_close(agree[clear], torch.ones_like(agree[clear]), rtol=0, atol=1e-9)


def test_normals_of_flat_clouds_are_exact_to_single_precision():
    normal = normalise(torch.randn(100, 3))
    points = torch.randn(100, 30, 3)
    points = points - (points * normal[:, None]).sum(-1, keepdim=True) * normal[:, None]
    m = outer6(points - points.mean(1, keepdim=True)).mean(1)
    found = smallest_eigenvector(m, symmetric_eigenvalues(m)[:, 0])
    assert ((found * normal).sum(-1).abs() > 1 - 1e-5).all()


def test_isotropic_matrices_get_the_z_axis():
    m = torch.tensor([[2.0, 2, 2, 0, 0, 0], [0.0, 0, 0, 0, 0, 0]], requires_grad=True)
    n = smallest_eigenvector(m, symmetric_eigenvalues(m)[:, 0])
    assert n.tolist() == [[0, 0, 1], [0, 0, 1]]
    n.sum().backward()
    assert m.grad is not None and m.grad.isfinite().all()


def test_eigen_gradcheck():
    m = covariances(4).requires_grad_()
    assert gradcheck(symmetric_eigenvalues, m)
    assert gradcheck(lambda m: outer6(smallest_eigenvector(m, symmetric_eigenvalues(m)[:, 0])), m)


def test_what_is_recomputed_has_the_same_gradient_and_is_called_again_for_it():
    calls = []

    def cube(x, power):
        calls.append(1)
        return (x**power).sin()

    x = torch.randn(5, dtype=torch.float64, requires_grad=True)
    found = recomputed(cube, x, 3)
    assert len(calls) == 1 and torch.equal(found, cube(x, 3))
    (expected,) = torch.autograd.grad(cube(x, 3).sum(), x)
    calls.clear()
    (gradient,) = torch.autograd.grad(found.sum(), x)
    assert len(calls) == 1 and torch.equal(gradient, expected)
    assert torch.equal(
        torch.func.grad(lambda x: recomputed(cube, x, 3).sum())(x.detach()), expected
    )
    with torch.no_grad():
        assert torch.equal(recomputed(cube, x, 3), found)
