"""What every layer keeps: order of the points, packing, units, empty neighbourhoods, gradients."""

import pytest
import torch
from nn.geometry import Case, packed, permuted, scaled, sphere, with_invalid, without_edges
from torch import nn
from torch.autograd import gradcheck

from riemlayer.nn import (
    AdaptiveGeodesicConv,
    GeodesicConv,
    HarmonicConv,
    TangentConv,
    VectorPool,
)

LAYERS = {
    "tangent": lambda: TangentConv(3, 2, rings=2, angles=3),
    "geodesic": lambda: GeodesicConv(3, 2, rings=2, angles=3),
    "harmonic": lambda: HarmonicConv(3, 2, orders=2, rings=2),
    "adaptive": lambda: AdaptiveGeodesicConv(3, 2, rings=2, angles=3),
    "vectors": lambda: VectorPool(),
}
pytestmark = pytest.mark.parametrize("name", LAYERS)


def make(name: str) -> nn.Module:
    layer = LAYERS[name]().double()
    for parameter in layer.parameters():
        nn.init.normal_(parameter)
    return layer


def features(name: str, n: int) -> torch.Tensor:
    if name == "harmonic":
        return torch.randn(n, 2, 3, dtype=torch.complex128)
    return torch.randn(n, *((3, 2) if name == "vectors" else (3,)), dtype=torch.float64)


def run(layer: nn.Module, x: torch.Tensor, case: Case) -> torch.Tensor:
    if isinstance(layer, AdaptiveGeodesicConv):
        return layer(x, case.geometry, case.cloud)
    return layer(x, case.geometry)


def test_permuted_points_permute_the_outputs(name):
    case, layer = sphere(), make(name)
    x, order = features(name, 40), torch.randperm(40)
    expected = run(layer, x, case)[order]
    torch.testing.assert_close(run(layer, x[order], permuted(case, order)), expected)


def test_a_packed_batch_is_its_clouds_one_by_one(name):
    together, alone = packed(20, 33, 12)
    layer, x = make(name), features(name, 65)
    parts = [run(layer, y, c) for y, c in zip(x.split((20, 33, 12)), alone, strict=True)]
    torch.testing.assert_close(run(layer, x, together), torch.cat(parts))


def test_the_unit_of_length_does_not_matter(name):
    case, layer, x = sphere(), make(name), features(name, 40)
    torch.testing.assert_close(run(layer, x, scaled(case, 100.0)), run(layer, x, case))


def self_term(layer: nn.Module, x: torch.Tensor) -> torch.Tensor:
    """What a receiver gets that has no neighbour, worked out from the docstring."""
    if isinstance(layer, VectorPool):
        return x
    out = layer.get_submodule("centre")(x)
    if isinstance(layer, AdaptiveGeodesicConv):  # it reads itself in every direction
        turns = [layer.kernel.roll(s, 1).sum((0, 1)) for s in range(layer.kernel.shape[1])]
        out = out + torch.stack([x @ k for k in turns]).amax(0)
    return out


def test_receivers_without_edges_get_their_own_term(name):
    case, layer, x = sphere(), make(name), features(name, 40).requires_grad_()
    case.geometry = without_edges(case)
    y = run(layer, x, case)
    torch.testing.assert_close(y, self_term(layer, x))
    y.abs().square().sum().backward()
    gradients = [y.grad for y in (x, *layer.parameters()) if y.grad is not None]
    assert gradients and all(bool(g.abs().isfinite().all()) for g in gradients)


def test_invalid_edges_are_as_good_as_none(name):
    case, layer, x = sphere(), make(name), features(name, 40)
    lost = (torch.rand(280) < 0.3) | (case.geometry.edge_index[1] == 7)
    marked, removed = with_invalid(case, lost)
    y, z = (run(layer, x, Case(case.cloud, g)) for g in (marked, removed))
    torch.testing.assert_close(y, z)
    torch.testing.assert_close(y[7], self_term(layer, x)[7])


def test_inputs_stay_as_they_were_and_calls_agree(name):
    case, layer, x = sphere(), make(name), features(name, 40)
    held = x.clone(), *(y.clone() for y in case.geometry)
    assert torch.equal(run(layer, x, case), run(layer, x, case))
    assert all(torch.equal(a, b) for a, b in zip(held, (x, *case.geometry), strict=True))


def test_gradients_agree_with_differences(name):
    """In features, logs, transport and parameters; no neighbour lies on the border, a kink."""
    case, layer = sphere(5, 3), make(name)
    g = case.geometry._replace(radius=1.1 * case.geometry.radius)
    x = features(name, 5).requires_grad_()
    names = ("r", "theta", "transport", "weight")
    told = [getattr(g, field).clone().requires_grad_() for field in names]
    parameters = dict(layer.named_parameters())

    def f(x, *inputs):
        geometry = g._replace(**dict(zip(names, inputs[:4], strict=True)))
        weights = dict(zip(parameters, inputs[4:], strict=True))
        extra = (case.cloud,) if name == "adaptive" else ()
        out = torch.func.functional_call(layer, weights, (x, geometry, *extra))
        return torch.view_as_real(out) if out.is_complex() else out

    assert gradcheck(f, (x, *told, *parameters.values()), fast_mode=True)


def test_bad_arguments_are_named(name):
    case, layer = sphere(), make(name)
    with pytest.raises(ValueError, match="`x` must have shape"):
        run(layer, features(name, 39), case)
    if name != "vectors":
        narrow = features(name, 40)[..., :2]
        with pytest.raises(ValueError, match="`x` must have shape"):
            run(layer, narrow, case)
        with pytest.raises(ValueError, match="rings must be at least 1, got 0"):
            type(layer)(3, 4, rings=0)
        with pytest.raises(ValueError, match="inputs must be at least 1, got 0"):
            type(layer)(0, 4)


def cast(case: Case, dtype: torch.dtype) -> Case:
    g = case.geometry
    g = g._make(y.to(dtype) if y.is_floating_point() else y for y in g)
    return Case(type(case.cloud)(case.cloud.points.to(dtype)), g)


def test_autocast_changes_no_more_than_its_rounding(name):
    case, layer, x = sphere(), LAYERS[name](), features(name, 40)
    single = x.to(torch.complex64) if x.is_complex() else x.bfloat16()
    with torch.autocast("cpu", torch.bfloat16):
        y = run(layer, single, cast(case, torch.float32))
    exact = run(layer.double(), single.to(x.dtype), case)
    torch.testing.assert_close(y.to(exact.dtype), exact, rtol=0.05, atol=0.05)
