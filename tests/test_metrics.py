"""The metrics of the paper against numbers worked out by hand, and their laws."""

import math

import numpy as np
import pytest
import torch

from riemlayer import metrics

TRIANGLE = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=torch.float64)
FACE = torch.tensor([[0, 1, 2]])
ALL = torch.ones(3, dtype=torch.bool)


def grid(n: int = 5) -> tuple[torch.Tensor, torch.Tensor]:
    """A square of n x n vertices at multiples of 1/4, and its triangles."""
    x = torch.arange(n, dtype=torch.float64) / 4
    V = torch.stack([*torch.meshgrid(x, x, indexing="ij"), torch.zeros(n, n)], -1).reshape(-1, 3)
    a = (torch.arange(n - 1)[:, None] * n + torch.arange(n - 1)).reshape(-1)
    F = torch.cat([torch.stack([a, a + n, a + 1], -1), torch.stack([a + 1, a + n, a + n + 1], -1)])
    return V, F


def rotation(angle: float) -> torch.Tensor:
    c, s = math.cos(angle), math.sin(angle)
    return torch.tensor([[c, -s, 0], [s, c, 0], [0, 0, 1]], dtype=torch.float64)


def test_angle_of_one_triangle():
    # angles 90, 45, 45 in space, 60, 60, 60 in the tangent plane: (30 + 15 + 15) / 3
    log = torch.tensor([[0.0, 0], [1, 0], [0.5, math.sqrt(0.75)]], dtype=torch.float64)
    assert metrics.angle_error(TRIANGLE, FACE, log, ALL).item() == pytest.approx(20.0)


def test_angle_of_a_collapsed_triangle_is_sixty_degrees():
    assert metrics.angle_error(TRIANGLE, FACE, TRIANGLE * 0, ALL).item() == pytest.approx(60.0)


def test_distance_of_one_edge():
    log = torch.tensor([[0.0, 0], [0.8, 0], [9, 9]], dtype=torch.float64)
    valid = torch.tensor([True, True, False])
    error = metrics.distance_distortion(TRIANGLE, FACE, log, valid)
    assert error.item() == pytest.approx(1 / 0.8 - 1)


def test_distance_of_a_longer_edge_counts_as_positive():
    log = torch.tensor([[0.0, 0], [2, 0], [9, 9]], dtype=torch.float64)
    valid = torch.tensor([True, True, False])
    assert metrics.distance_distortion(TRIANGLE, FACE, log, valid).item() == 0.5


def test_shared_edges_count_once():
    V, F = grid(2)  # two triangles, five edges
    log = V.clone()
    log[1, 2] = math.sqrt(8) / 4  # the three edges at vertex 1, of 1/4, 1/4 and sqrt(2)/4, grow
    short, long = math.sqrt(1 + 8), math.sqrt(2 + 8) / math.sqrt(2)
    expected = (2 * (1 - 1 / short) + (1 - 1 / long)) / 5
    valid = torch.ones(4, dtype=torch.bool)
    assert len(metrics.mesh_edges(F)) == 5
    assert metrics.distance_distortion(V, F, log, valid).item() == pytest.approx(expected)


def test_edges_of_no_faces_are_none():
    assert metrics.mesh_edges(torch.zeros(0, 3, dtype=torch.long)).shape == (0, 2)


def test_collapsed_edge_is_infinite_and_clips_to_one():
    log = TRIANGLE.clone()
    log[1] = log[0]
    assert metrics.distance_distortion(TRIANGLE, FACE, log, ALL).isinf()
    others = metrics.edge_distortion(TRIANGLE, torch.tensor([[0, 2], [1, 2]]), log)
    clipped = (1 + others.sum()) / 3
    assert metrics.distance_distortion(TRIANGLE, FACE, log, ALL, clip=1) == clipped
    assert metrics.distance_distortion(TRIANGLE, FACE, log, ALL, clip=1).isfinite()


def test_edge_of_no_length_costs_nothing_unless_it_grows():
    V = TRIANGLE.clone()
    V[1] = V[0]
    valid = torch.tensor([True, True, False])
    assert metrics.distance_distortion(V, FACE, V, valid).item() == 0
    assert metrics.distance_distortion(V, FACE, TRIANGLE, valid).item() == 1


@pytest.mark.parametrize("source", [0, 7, 12])
def test_floor_of_a_plane_is_exactly_zero(source):
    V, F = grid()
    valid = torch.ones(len(V), dtype=torch.bool)
    log = V - V[source]
    assert metrics.angle_error(V, F, log, valid).item() == 0
    assert metrics.distance_distortion(V, F, log, valid).item() == 0
    assert metrics.angle_error(V, F, log[:, :2], valid).item() == 0


def test_a_turned_frame_changes_nothing():
    V, F = grid()
    log = V @ torch.diag(torch.tensor([1.3, 0.7, 1.0], dtype=torch.float64))
    valid = torch.ones(len(V), dtype=torch.bool)
    for metric in (metrics.angle_error, metrics.distance_distortion):
        turned = metric(V, F, log @ rotation(0.7), valid)
        torch.testing.assert_close(metric(V, F, log, valid), turned)


def test_a_scaled_log_keeps_angles_and_scales_lengths():
    V, F = grid()
    valid = torch.ones(len(V), dtype=torch.bool)
    assert metrics.angle_error(V, F, 0.5 * V, valid).item() == pytest.approx(0, abs=1e-12)
    assert metrics.distance_distortion(V, F, 0.5 * V, valid).item() == 1


def test_in_plane_leaves_planar_vectors_and_takes_the_rest_off():
    axes = torch.linalg.qr(torch.randn(3, 3, dtype=torch.float64))[0]
    planar, valid = torch.randn(50, 2, dtype=torch.float64) @ axes[:2], torch.rand(50) < 0.9
    torch.testing.assert_close(metrics.in_plane(planar, valid), planar)
    lifted = planar + 0.3 * axes[2]
    torch.testing.assert_close(metrics.in_plane(lifted, valid, axes[2]), planar)
    with pytest.raises(ValueError, match="`log` must be finite"):
        metrics.in_plane(planar * torch.nan, valid)


def test_numpy_arrays_will_do():
    V, F = grid()
    valid = torch.rand(len(V)) < 0.8
    log = V + 0.1 * torch.rand_like(V)
    for metric in (metrics.angle_error, metrics.distance_distortion):
        arrays = metric(V.numpy(), F.numpy().astype(np.int32), log.numpy(), valid.numpy())
        assert arrays == metric(V, F, log, valid)


def test_what_is_not_valid_does_not_count():
    V, F = grid()
    log, valid = V.clone(), torch.ones(len(V), dtype=torch.bool)
    log[3], valid[3] = torch.nan, False
    assert metrics.angle_error(V, F, log, valid).item() == 0
    assert metrics.distance_distortion(V, F, log, valid).item() == 0


@pytest.mark.parametrize("metric", [metrics.angle_error, metrics.distance_distortion])
def test_nan_where_valid_is_refused(metric):
    log = TRIANGLE.clone()
    log[2, 0] = torch.nan
    with pytest.raises(ValueError, match="`log` must be finite"):
        metric(TRIANGLE, FACE, log, ALL)


@pytest.mark.parametrize("metric", [metrics.angle_error, metrics.distance_distortion])
def test_an_empty_mask_is_refused(metric):
    with pytest.raises(ValueError, match="valid leaves no"):
        metric(TRIANGLE, FACE, TRIANGLE, ~ALL)


def test_log_of_a_wrong_width_is_refused():
    with pytest.raises(ValueError, match=r"log must have shape \(n, 2\) or \(n, 3\), got \(3, 4\)"):
        metrics.angle_error(TRIANGLE, FACE, torch.zeros(3, 4), ALL)


@pytest.mark.parametrize("metric", [metrics.exp_error, metrics.log_end_error])
class TestMeanDistance:
    def test_by_hand(self, metric):
        truth = torch.zeros(2, 3)
        assert metric(truth, torch.tensor([[3.0, 4, 0], [0, 0, 1]])).item() == 3

    def test_mask(self, metric):
        prediction = torch.tensor([[3.0, 4, 0], [torch.nan, 0, 0]])
        assert metric(torch.zeros(2, 3), prediction, torch.tensor([True, False])).item() == 5

    def test_nan_is_refused(self, metric):
        with pytest.raises(ValueError, match="`prediction` must be finite"):
            metric(torch.zeros(2, 3), torch.tensor([[0.0, 0, 0], [torch.nan, 0, 0]]))

    def test_empty_is_refused(self, metric):
        with pytest.raises(ValueError, match="valid leaves no row"):
            metric(torch.zeros(2, 3), torch.zeros(2, 3), torch.zeros(2, dtype=torch.bool))

    def test_shapes_must_agree(self, metric):
        with pytest.raises(ValueError, match=r"prediction must have shape \(2, 3\), got \(3,\)"):
            metric(torch.zeros(2, 3), torch.zeros(3))


def test_bins_hold_their_lower_bound_and_say_when_they_are_empty():
    error, length = torch.tensor([1.0, 2.0, 4.0]), torch.tensor([0.0, 0.5, 0.25])
    means, counts = metrics.mean_by_length(error, length, torch.tensor([0.0, 0.5, 1.0, 2.0]))
    assert means.tolist() == [2.5, 2.0, 0.0]
    assert counts.tolist() == [2, 1, 0]


def test_zero_point_errors_by_hand():
    p = torch.tensor([1.0, 2, 3])
    errors = metrics.zero_point_errors(
        lambda p, v: p + v + torch.tensor([0.3, 0.4, 0]), lambda p, q: q - p + 2, p
    )
    assert [error.item() for error in errors] == pytest.approx([0.5, math.sqrt(12)])


def test_differential_errors_by_hand():
    # d(Exp) = [[1, 0], [0.5, 1]] and d(Log) = [[0, -1], [1, 0]], a quarter turn
    frame = torch.eye(3, dtype=torch.float64)[:, :2]
    shear, turn = torch.eye(3, dtype=torch.float64), rotation(math.pi / 2)
    shear[1, 0] = 0.5
    errors = metrics.differential_errors(
        lambda p, v: p + v @ shear.T, lambda p, q: (q - p) @ turn.T, torch.ones(3).double(), frame
    )
    assert [error.item() for error in errors] == pytest.approx([0.5, 2.0])


def test_differential_errors_of_a_sphere_vanish_with_the_square_of_the_step():
    """Exp and Log of the unit sphere; Log takes the point back to the sphere first."""

    def exp(p, v):
        r = v.norm(dim=-1, keepdim=True)
        return torch.cos(r) * p + torch.sin(r) * v / r

    def log(p, q):
        q = q / q.norm(dim=-1, keepdim=True)
        across = q - (q @ p)[:, None] * p
        sine = across.norm(dim=-1, keepdim=True)
        return torch.atan2(sine, (q @ p)[:, None]) * across / sine

    p, frame = torch.eye(3).double()[2], torch.eye(3).double()[:, :2]
    coarse = metrics.differential_errors(exp, log, p, frame, step=0.04)
    fine = metrics.differential_errors(exp, log, p, frame, step=0.02)
    for a, b in zip(coarse, fine, strict=True):
        assert 0 < b.item() < 1e-3
        assert (a / b).item() == pytest.approx(4, rel=0.01)


def test_arguments_are_left_alone():
    V, F = grid()
    log, valid = V * 1.1, torch.ones(len(V), dtype=torch.bool)
    before = [x.clone() for x in (V, F, log, valid)]
    metrics.angle_error(V, F, log, valid)
    metrics.distance_distortion(V, F, log, valid, clip=1)
    for x, y in zip(before, (V, F, log, valid), strict=True):
        assert torch.equal(x, y)
