"""Every bad input is named: which argument, what was expected, what came, what mends it."""

import numpy as np
import pytest
import torch

from riemlayer.checks import (
    check_batch,
    check_broadcast,
    check_index,
    check_points,
    check_shapes,
    check_vectors,
)


def cloud(n: int = 8) -> torch.Tensor:
    return torch.linspace(-1, 1, 3 * n).reshape(n, 3)


def with_value(value: float) -> torch.Tensor:
    points = cloud()
    points[3, 1] = value
    return points


def test_good_points_pass_in_every_float_dtype():
    for dtype in (torch.float32, torch.float64, torch.bfloat16):
        check_points(cloud().to(dtype))
    check_points(cloud(4), torch.zeros(4, dtype=torch.int64))


@pytest.mark.parametrize(
    "points, error, words",
    [
        (cloud().numpy(), TypeError, "numpy.ndarray; make one with torch.from_numpy"),
        (cloud().tolist(), TypeError, "got list; make one with torch.tensor"),
        (1.0, TypeError, "got float"),
        (None, TypeError, "got NoneType"),
        (cloud().long(), TypeError, r"got torch.int64; convert with points.float\(\)"),
        (cloud().to(torch.complex64), TypeError, "got torch.complex64"),
        (torch.zeros(0, 3), ValueError, "at least 4 points, got 0"),
        (cloud(3), ValueError, "at least 4 points, got 3"),
        (torch.zeros(8, 2), ValueError, r"shape \(N, 3\), got \(8, 2\)"),
        (torch.zeros(12), ValueError, r"shape \(N, 3\), got \(12,\)"),
        (torch.zeros(2, 8, 3), ValueError, r"got \(2, 8, 3\); .*pass `batch`"),
        (with_value(float("nan")), ValueError, "in 1 of 8 rows; keep the good ones"),
        (with_value(float("-inf")), ValueError, "NaN or infinity"),
        (torch.full((8, 3), 0.7), ValueError, "not all be equal, all are in one place"),
    ],
)
def test_bad_points_are_named(points, error, words):
    with pytest.raises(error, match=words) as raised:
        check_points(points)
    assert "`points`" in str(raised.value)


def test_one_flat_shape_of_a_batch_is_named():
    points = torch.cat([cloud(4), torch.ones(5, 3), cloud(6)])
    batch = torch.tensor([0] * 4 + [1] * 5 + [2] * 6)
    with pytest.raises(ValueError, match="those of shape 1 are in one place"):
        check_points(points, batch)
    check_points(points)


@pytest.mark.parametrize(
    "batch, error, words",
    [
        ([0] * 8, TypeError, "got list"),
        (np.zeros(8, dtype=np.int64), TypeError, "got ndarray"),
        (torch.zeros(8), TypeError, r"got torch.float32; convert with batch.long\(\)"),
        (torch.zeros(8, dtype=torch.int32), TypeError, "got torch.int32"),
        (torch.zeros(7, dtype=torch.int64), ValueError, r"shape \(8,\).* got \(7,\)"),
        (torch.zeros(8, 1, dtype=torch.int64), ValueError, r"got \(8, 1\)"),
        (torch.tensor([1] * 4 + [0] * 4), ValueError, "sorted.*argsort"),
        (torch.tensor([-1] * 4 + [0] * 4), ValueError, "negative, got -1"),
        (torch.tensor([0] * 5 + [1] * 3), ValueError, "got 3 in shape 1"),
        (torch.tensor([0] * 4 + [2] * 4), ValueError, "got 0 in shape 1"),
        (torch.tensor([0] * 4 + [2**40] * 4), ValueError, f"got {2**40} for 8 points"),
    ],
)
def test_bad_batch_is_named(batch, error, words):
    with pytest.raises(error, match=words) as raised:
        check_points(cloud(), batch)
    assert "`batch`" in str(raised.value)


def test_good_batch_passes():
    check_batch(torch.tensor([0] * 4 + [1] * 5), 9)


@pytest.mark.parametrize(
    "v, error, words",
    [
        (np.zeros((5, 3)), TypeError, "torch.from_numpy"),
        (0.5, TypeError, "got float"),
        (torch.zeros(5, 3, dtype=torch.int32), TypeError, "torch.int32"),
        (torch.tensor(1.0), ValueError, r"\(\.\.\., 3\), got \(\)"),
        (torch.zeros(3, 5), ValueError, r"\(\.\.\., 3\), got \(3, 5\)"),
        (torch.zeros(5, 3, dtype=torch.float64), ValueError, r"torch.float32 .*got torch.float64"),
        (torch.zeros(5, 3, device="meta"), ValueError, r'device cpu, got meta; .*v.to\("cpu"\)'),
        (torch.full((5, 3), float("nan")), ValueError, "5 of 5 rows"),
        (torch.full((3,), float("inf")), ValueError, "infinity"),
    ],
)
def test_bad_vectors_are_named(v, error, words):
    with pytest.raises(error, match=words) as raised:
        check_vectors("v", v, like=cloud())
    assert "`v`" in str(raised.value)


@pytest.mark.parametrize("shape", [(3,), (0, 3), (2, 5, 3)])
def test_any_leading_shape_of_vectors_passes(shape):
    check_vectors("v", torch.zeros(shape), like=cloud())


def test_checks_leave_inputs_as_they_were():
    points, batch = cloud(), torch.zeros(8, dtype=torch.int64)
    before = points.clone(), batch.clone()
    check_points(points, batch)
    check_vectors("p", points, like=points)
    assert torch.equal(points, before[0]) and torch.equal(batch, before[1])


def test_broadcast_gives_the_common_shape_or_says_how_to_align():
    p, v = torch.zeros(4, 3), torch.zeros(4, 7, 3)
    assert check_broadcast(p=p[:, None], v=v) == (4, 7, 3)
    with pytest.raises(ValueError, match=r"`p` and `v` .*\(4, 3\) and \(4, 7, 3\); .*p\[:, None\]"):
        check_broadcast(p=p, v=v)


def test_shapes_bind_names_across_arguments():
    p, v = torch.zeros(4, 3), torch.zeros(4, 7, 3)
    assert check_shapes(p=(p, "S 3"), v=(v, "S K 3")) == {"S": 4, "K": 7}
    assert check_shapes(J=(torch.zeros(2, 5, 3, 3), "... 3 3")) == {}


@pytest.mark.parametrize("shape", [(5, 7, 3), (4, 7, 2), (4, 3), (3,), (1, 4, 7, 3)])
def test_shapes_that_do_not_fit_are_quoted(shape):
    words = r"`v` must have shape \(S, K, 3\) with S=4, got \(" + str(shape[0])
    with pytest.raises(ValueError, match=words):
        check_shapes(p=(torch.zeros(4, 3), "S 3"), v=(torch.zeros(shape), "S K 3"))


@pytest.mark.parametrize(
    "index, error, words",
    [
        ([0, 1], TypeError, "got list"),
        (torch.zeros(4), TypeError, "got torch.float32"),
        (torch.tensor([0, 1, 2, 3]), ValueError, r"lie in \[0, 3\), got values in \[0, 3\]"),
        (torch.tensor([-1, 0, 0, 0]), ValueError, r"got values in \[-1, 0\]"),
        (torch.zeros(5, dtype=torch.int64), ValueError, r"`shape` and `p` must broadcast"),
    ],
)
def test_bad_index_is_named(index, error, words):
    with pytest.raises(error, match=words) as raised:
        check_index("shape", index, 3, like=torch.zeros(4, 3))
    assert "`shape`" in str(raised.value)


def test_index_that_broadcasts_passes():
    check_index("shape", torch.tensor([0, 1, 2, 2]), 3, like=torch.zeros(4, 3))
    check_index("shape", torch.tensor(1), 3, like=torch.zeros(4, 3))
