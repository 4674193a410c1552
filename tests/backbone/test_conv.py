"""Octree convolutions are dense ones restricted to the occupied nodes, backward too."""

import pytest
import torch
from references import dense_conv, dense_down, dense_up, full_octree, random_octree
from torch.autograd import gradcheck

from riemlayer.backbone import OctreeConv, OctreeDown, OctreeUp

CASES = {
    "conv": (OctreeConv, dense_conv),
    "down": (OctreeDown, dense_down),
    "up": (OctreeUp, dense_up),
}
TREES = {"full": full_octree, "partial": random_octree}


def case(name: str, tree: str):
    """Module, dense reference, its levels, and features of its first level."""
    octree = TREES[tree](3)
    coarse, fine = octree.level(2), octree.level(3)
    levels = {"conv": (fine,), "down": (fine, coarse), "up": (coarse, fine)}[name]
    module, reference = CASES[name]
    module = module(3, 4).double()
    torch.nn.init.normal_(module.bias)
    x = torch.randn(len(levels[0]), 3, dtype=torch.float64, requires_grad=True)
    return module, reference, levels, x


@pytest.mark.parametrize("tree", TREES)
@pytest.mark.parametrize("name", CASES)
def test_values_are_those_of_the_dense_convolution(name, tree):
    module, reference, levels, x = case(name, tree)
    expected = reference(x, module.weight, module.bias, *levels)
    torch.testing.assert_close(module(x, *levels), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("tree", TREES)
@pytest.mark.parametrize("name", CASES)
def test_gradients_are_those_of_the_dense_convolution(name, tree):
    module, reference, levels, x = case(name, tree)
    inputs = (x, module.weight, module.bias)
    grad = torch.randn(len(levels[-1]), 4, dtype=torch.float64)
    own = torch.autograd.grad(module(x, *levels), inputs, grad)
    dense = torch.autograd.grad(reference(*inputs, *levels), inputs, grad)
    for a, b in zip(own, dense, strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-11)


@pytest.mark.parametrize("name", CASES)
def test_gradcheck(name):
    octree = random_octree(2, n=6)
    coarse, fine = octree.level(1), octree.level(2)
    levels = {"conv": (fine,), "down": (fine, coarse), "up": (coarse, fine)}[name]
    module = CASES[name][0](2, 2).double()
    x = torch.randn(len(levels[0]), 2, dtype=torch.float64, requires_grad=True)

    def run(x, weight):
        return torch.func.functional_call(module, {"weight": weight}, (x, *levels))

    assert gradcheck(run, (x, module.weight.detach().requires_grad_()))


@pytest.mark.parametrize("name", CASES)
def test_inputs_without_gradient_cost_none(name):
    module, _, levels, x = case(name, "partial")
    module(x.detach(), *levels).sum().backward()
    assert module.weight.grad is not None and x.grad is None


def test_one_node_alone_sees_the_middle_of_the_kernel():
    octree = random_octree(3, n=1, shapes=1)
    module, x = OctreeConv(2, 3), torch.randn(1, 2)
    torch.testing.assert_close(module(x, octree.level(3)), x @ module.weight[26:28])


@pytest.mark.parametrize("name", CASES)
def test_products_run_in_the_autocast_type_and_agree(name):
    module, _, levels, x = case(name, "partial")
    module, x = module.float(), x.detach().float()
    with torch.autocast("cpu", torch.bfloat16):
        half = module(x, *levels)
    assert half.dtype == torch.bfloat16
    full = module(x, *levels)
    assert (half - full).abs().max() < 0.03 * full.abs().max()


def test_widths_are_printed():
    assert repr(OctreeConv(3, 4)) == "OctreeConv(3 -> 4)"
    assert repr(OctreeDown(3, 4)) == "OctreeDown(3 -> 4)"
    assert repr(OctreeUp(3, 4)) == "OctreeUp(3 -> 4)"
