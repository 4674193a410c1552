"""Depth images rendered in closed form come back as the surface that they show."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.nn.functional import normalize

from riemlayer.data import from_depth

K = torch.tensor([[80.0, 0, 32], [0, 90, 24], [0, 0, 1]], dtype=torch.float64)
CENTRE = torch.tensor([0.1, -0.05, 3.0], dtype=torch.float64)


def rays(height: int = 48, width: int = 64) -> Tensor:
    """(H, W, 3) with z = 1, through the pixels' centres."""
    row, column = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    row, column = row.double(), column.double()
    return torch.stack(((column - 32) / 80, (row - 24) / 90, torch.ones_like(row)), -1)


def sphere(radius: float = 0.5) -> Tensor:
    """Depths of a sphere about CENTRE: the nearer root of |z ray - c| = r; 0 beside it."""
    ray = rays()
    a, b = ray.square().sum(-1), ray @ CENTRE
    root = b.square() - a * (CENTRE.square().sum() - radius**2)
    return torch.where(root > 0, (b - root.clamp_min(0).sqrt()) / a, 0.0)


def plane(normal: Tensor, offset: float) -> Tensor:
    """Depths of normal . x = offset."""
    return offset / (rays() @ normal)


def test_a_sphere_with_normals():
    points, normals, pixels = from_depth(sphere(), K)
    assert ((points - CENTRE).norm(dim=-1) - 0.5).abs().max() < 1e-12
    outward = normalize(points - CENTRE, dim=-1)
    angle = torch.rad2deg((normals * outward).sum(-1).clamp(-1, 1).acos())
    assert angle.median() < 2 and angle.quantile(0.95) < 12 and len(points) > 400
    shown = sphere() > 0
    assert shown[tuple(pixels.T)].all() and len(points) <= int(shown.sum())
    assert torch.equal(points[:, 2], sphere()[tuple(pixels.T)])


def test_a_tilted_plane_has_exact_normals():
    normal = normalize(torch.tensor([0.6, -0.3, -1.0]).double(), dim=0)
    points, normals, _ = from_depth(plane(normal, -2.0), K)
    assert len(points) == 48 * 64
    assert (points @ normal + 2).abs().max() < 1e-12
    assert (normals - normal).abs().max() < 1e-9  # towards the camera, at the border too


def test_four_numbers_are_the_same_camera():
    for intrinsics in ((80, 90, 32, 24), np.array([80, 90, 32, 24.0]), K.tolist()):
        assert torch.equal(from_depth(sphere(), intrinsics).points, from_depth(sphere(), K).points)


def test_holes_are_left_out():
    depth = torch.full((6, 8), 2.0)
    depth[2, 3], depth[0, 0], depth[5, 7], depth[3, 2] = 0, math.nan, math.inf, -1
    points, normals, pixels = from_depth(depth, K)
    assert len(points) == 44 and points.isfinite().all()
    assert (normals - torch.tensor([0.0, 0, -1])).abs().max() < 1e-6
    assert not ((pixels == torch.tensor([2, 3])).all(-1)).any()


def test_flying_pixels_are_removed_and_both_surfaces_kept():
    """A square before a wall, with a rim of depths between the two."""
    depth = torch.full((48, 64), 4.0)
    depth[10:30, 15:45] = 3.0
    depth[11:29, 16:44] = 2.0
    z = from_depth(depth, K).points[:, 2]
    assert sorted(z.unique().tolist()) == [2.0, 4.0]
    assert int((z == 2).sum()) == 16 * 26  # less the pixels beside the rim
    assert len(from_depth(depth, K, steepest=math.inf).points) == 48 * 64


def test_a_steep_surface_is_no_jump():
    slope = math.radians(55)  # seen under up to 77 degrees at the image's border
    normal = torch.tensor([math.sin(slope), 0, -math.cos(slope)]).double()
    assert len(from_depth(plane(normal, -1.0), K).points) == 48 * 64


@pytest.mark.parametrize("kind", [np.uint16, np.int32, np.float32])
def test_millimetres_in_whole_numbers(kind):
    depth = (1000 * sphere()).round().numpy().astype(kind)
    points = from_depth(depth, K, scale=1e-3).points
    assert ((points - CENTRE).norm(dim=-1) - 0.5).abs().max() < 1e-3


def test_a_pose_puts_two_views_together():
    turn = torch.tensor([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]).double()
    pose = torch.eye(4).double()
    pose[:3, :3], pose[:3, 3] = turn, torch.tensor([1.0, 2, 3]).double()
    here, there = from_depth(sphere(), K), from_depth(sphere(), K, pose=pose)
    assert (there.points - (here.points @ turn.T + pose[:3, 3])).abs().max() < 1e-12
    assert (there.normals - here.normals @ turn.T).abs().max() < 1e-12


def test_points_are_differentiable_in_the_depth():
    depth = sphere().requires_grad_()
    from_depth(depth, K).points.square().sum().backward()
    assert depth.grad.isfinite().all() and depth.grad.abs().sum() > 0


@pytest.mark.parametrize(
    "arguments, words",
    [
        ({"depth": torch.zeros(3)}, r"`depth` must have shape \(H, W\), got \(3,\)"),
        ({"depth": torch.zeros(9, 9)}, r"at least 4 pixels .* got 0 of 81 \(0 with a depth\)"),
        ({"intrinsics": (1, 2, 3)}, r"`intrinsics` must be \(3, 3\)"),
        ({"intrinsics": (0, 80, 3, 3)}, "positive focal lengths"),
        ({"intrinsics": (80, math.nan, 3, 3)}, "`intrinsics` must be finite"),
        ({"scale": 0.0}, "must be positive"),
        ({"pose": torch.eye(3)}, r"`pose` must have shape \(4, 4\)"),
    ],
)
def test_arguments_are_checked(arguments, words):
    with pytest.raises(ValueError, match=words):
        from_depth(**({"depth": torch.ones(5, 5), "intrinsics": K} | arguments))
