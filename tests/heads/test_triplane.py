"""Sampling of triplanes is `grid_sample`, with a forward mode."""

import pytest
import torch
from references import grid_sample_triplane
from torch.autograd import gradcheck, gradgradcheck

from riemlayer.heads import TriplaneHypernetwork, sample_triplane


def random_planes(s: int = 2, r: int = 5, c: int = 3) -> torch.Tensor:
    return torch.randn(s, 3, r, r, c, dtype=torch.float64)


def queries(s: int = 2, k: int = 50, reach: float = 1.0) -> torch.Tensor:
    return (2 * torch.rand(s, k, 3, dtype=torch.float64) - 1) * reach


@pytest.mark.parametrize("r", [2, 5, 16])
@pytest.mark.parametrize("mode", [torch.enable_grad, torch.no_grad])
def test_values_are_those_of_grid_sample(r, mode):
    planes, x = random_planes(r=r), queries(reach=1.5)
    expected = grid_sample_triplane(planes, x)
    with mode():
        torch.testing.assert_close(sample_triplane(planes, x), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("mode", [torch.enable_grad, torch.no_grad])
def test_forward_mode_works_with_and_without_a_graph(mode):
    planes, x = random_planes(), queries(reach=0.9)
    step = torch.randn_like(x)
    with mode():
        value, tangent = torch.func.jvp(lambda y: sample_triplane(planes, y), (x,), (step,))
    ahead, behind = (sample_triplane(planes, x + e * step) for e in (1e-7, -1e-7))
    torch.testing.assert_close(value, sample_triplane(planes, x))
    torch.testing.assert_close(tangent, (ahead - behind) / 2e-7, rtol=1e-5, atol=1e-5)


def test_gradients_are_those_of_grid_sample():
    inputs = random_planes().requires_grad_(), queries(reach=1.5).requires_grad_()
    grad = torch.randn(2, 50, 9, dtype=torch.float64)
    own = torch.autograd.grad(sample_triplane(*inputs), inputs, grad)
    reference = torch.autograd.grad(grid_sample_triplane(*inputs), inputs, grad)
    for a, b in zip(own, reference, strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-12)


def test_samples_lie_at_the_corners():
    planes = random_planes(1, 3)
    x = torch.tensor([[-1.0, 0, 1], [1.0, -1, 0]], dtype=torch.float64)[None]
    xy, xz, yz = sample_triplane(planes, x)[0, 0].chunk(3)
    assert torch.equal(xy, planes[0, 0, 0, 1])
    assert torch.equal(xz, planes[0, 1, 0, 2])
    assert torch.equal(yz, planes[0, 2, 1, 2])


def test_beyond_the_border_the_border_is_taken():
    planes, x = random_planes(), queries(reach=4.0)
    expected = sample_triplane(planes, x.clamp(-1, 1))
    assert torch.equal(sample_triplane(planes, x), expected)


def test_gradcheck_backward_and_forward():
    inputs = random_planes(1, 3, 2).requires_grad_(), queries(1, 4).requires_grad_()
    assert gradcheck(sample_triplane, inputs, check_forward_ad=True)


def test_forward_mode_has_a_backward():
    """What the geometric losses need: the derivative of a tangent in the planes."""
    planes, x = random_planes(1, 3, 2).requires_grad_(), queries(1, 4)
    axis = torch.randn_like(x)

    def tangent(planes):
        return torch.func.jvp(lambda y: sample_triplane(planes, y), (x,), (axis,))[1]

    assert gradcheck(tangent, planes)


def test_hypernetwork_is_linear_in_the_embedding():
    net = TriplaneHypernetwork(6, resolution=4, channels=2).double()
    z = torch.randn(3, 6, dtype=torch.float64)
    planes = net(z)
    assert planes.shape == (3, 3, 4, 4, 2)
    zero = net(torch.zeros_like(z))
    torch.testing.assert_close(net(2 * z) - zero, 2 * (planes - zero))
    assert "6 -> 3x2x4x4" in repr(net)


@pytest.mark.parametrize("resolution", [4, 5, 16])
@pytest.mark.parametrize("mode", [torch.enable_grad, torch.no_grad])
def test_of_the_planes_only_the_middle_that_queries_need_is_made(resolution, mode):
    """Values are those on whole planes, at any reach; at the borders between samples too."""
    net = TriplaneHypernetwork(6, resolution, channels=2).double()
    z, x = torch.randn(3, 6).double(), queries(3)
    sizes = []
    for reach in sorted((0.0, 1e-3, 1 / (resolution - 1), 0.3, 0.8, 1.0, 2.0)):
        near = (reach * x).clamp(-reach, reach)
        near[0, 0] = reach
        with mode():
            planes = net(z, near)
            sizes.append(planes.shape[2])
            sampled = sample_triplane(planes, near, resolution)
            whole = sample_triplane(net(z), near)
        torch.testing.assert_close(sampled, whole, rtol=0, atol=1e-12)
    assert sizes[0] in (2, 3) and sizes == sorted(sizes) and sizes[-1] == resolution


def test_gradients_do_not_depend_on_how_much_of_the_planes_is_made():
    net, x = TriplaneHypernetwork(6, 16, 2).double(), queries(3, reach=0.2).requires_grad_()
    z = torch.randn(3, 6).double().requires_grad_()
    inputs = [z, x, *net.parameters()]
    weight = torch.randn(3, 50, 6).double()
    middle = (sample_triplane(net(z, x), x, 16) * weight).sum()
    whole = (sample_triplane(net(z), x) * weight).sum()
    for a, b in zip(
        torch.autograd.grad(middle, inputs), torch.autograd.grad(whole, inputs), strict=True
    ):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-11)


def test_reference_sampler_has_the_double_backward_that_ours_replaces():
    inputs = random_planes(1, 3, 1).requires_grad_(), queries(1, 2).requires_grad_()
    assert gradgradcheck(grid_sample_triplane, inputs)
