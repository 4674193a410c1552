"""What layers are not made for is said; what they are given of bad neighbourhoods is finite."""

from types import SimpleNamespace

import pytest
import torch
from nn.geometry import sphere
from references import fibonacci_sphere

from riemlayer import ExpLogField
from riemlayer.nn import (
    AdaptiveGeodesicConv,
    Cells,
    GeodesicConv,
    GeodesicPool,
    GeodesicUnpool,
    HarmonicConv,
    HarmonicGate,
    HarmonicLinear,
    LogMapEdges,
    ParallelTransport,
    TangentConv,
    VectorPool,
    magnitudes,
    to_streams,
)
from riemlayer.ops import local_geometry

CASE = sphere(40)
REAL = {
    "tangent": lambda x: TangentConv(3, 2).double()(x, CASE.geometry),
    "geodesic": lambda x: GeodesicConv(3, 2).double()(x, CASE.geometry),
    "adaptive": lambda x: AdaptiveGeodesicConv(3, 2).double()(x, CASE.geometry, CASE.cloud),
    "pool": lambda x: GeodesicPool(count=5)(x, CASE.geometry),
    "streams": lambda x: to_streams(x, 2),
}
VECTORS = {
    "vector pool": lambda x: VectorPool()(x, CASE.geometry),
    "transport": lambda x: ParallelTransport()(x, CASE.geometry),
}
COMPLEX = {
    "harmonic": lambda x: HarmonicConv(3, 2).double()(x, CASE.geometry),
    "linear": lambda x: HarmonicLinear(3, 2).double()(x),
    "gate": lambda x: HarmonicGate(3).double()(x),
}


@pytest.mark.parametrize("name", [*REAL, *VECTORS])
@pytest.mark.parametrize(
    "change, words",
    [
        (lambda x: x.long(), "`x` must have a floating-point dtype, got torch.int64"),
        (lambda x: torch.complex(x, x), "`x` must have a floating-point dtype, got torch.complex"),
        (lambda x: x.numpy(), "torch.from_numpy"),
        (lambda x: x.tolist(), "`x` must be a torch.Tensor, got list"),
    ],
)
def test_features_of_another_kind_are_refused(name, change, words):
    call, size = (REAL | VECTORS)[name], (40, 3, 2) if name in VECTORS else (40, 3)
    x = torch.randn(*size, dtype=torch.float64)
    with pytest.raises(TypeError, match=words):
        call(change(x))


@pytest.mark.parametrize("name", COMPLEX)
def test_streams_of_another_kind_are_refused(name):
    x = torch.randn(40, 2, 3, dtype=torch.float64)
    with pytest.raises(ValueError, match="make it with to_streams"):
        COMPLEX[name](x)
    with pytest.raises(TypeError, match=r"`x` must be a torch\.Tensor, got list"):
        COMPLEX[name](x.tolist())
    with pytest.raises(ValueError, match="`x` must have shape"):
        COMPLEX[name](torch.complex(x, x)[:, 0])


@pytest.mark.parametrize("name", [*REAL, *VECTORS])
@pytest.mark.parametrize("size", [(40,), (40, 3, 5), (0, 3)])
def test_features_of_another_shape_are_refused(name, size):
    if name == "streams" and size == (0, 3):
        assert to_streams(torch.zeros(0, 3), 2).shape == (0, 2, 3)
        return
    with pytest.raises(ValueError, match="`x` must have shape"):
        (REAL | VECTORS)[name](torch.zeros(*size, dtype=torch.float64))


def test_cells_of_another_cloud_are_refused():
    cells = GeodesicPool(count=5).cells(CASE.geometry)
    other = sphere(30)
    with pytest.raises(ValueError, match="geometry of 30 points, got the cells of 40"):
        GeodesicPool(count=5)(torch.zeros(30, 3).double(), other.geometry, cells)
    with pytest.raises(ValueError, match="`x` must have shape"):
        GeodesicUnpool()(torch.zeros(6, 3), cells)


def test_graphs_that_cannot_be_encoded_are_named():
    transform = LogMapEdges(ExpLogField.from_preset("tiny"), k=8)
    points = fibonacci_sphere(30).float()
    for pos, error, words in (
        (points * torch.nan, ValueError, "`points` must be finite"),
        (points[:3], ValueError, "at least 4 points, got 3"),
        (points[:, :2], ValueError, r"`points` must have shape \(N, 3\)"),
        (points.double(), ValueError, "`points` must have dtype torch.float32"),
        (points[:8], ValueError, "k must be less than the points of a cloud, got 8"),
        (points.numpy(), TypeError, "torch.from_numpy"),
    ):
        with pytest.raises(error, match=words):
            transform(SimpleNamespace(pos=pos))


@pytest.fixture(scope="module", params=["disconnected", "copies", "empty"])
def poor(request):
    """A surface and a geometry of which not every neighbourhood is a good one."""
    field = ExpLogField.from_preset("tiny").eval()
    x = fibonacci_sphere(200).float()
    if request.param == "disconnected":  # ten crumbs of five points beside the sphere
        crumbs = 0.01 * fibonacci_sphere(5).float() + 1.5 * fibonacci_sphere(10).float()[:, None]
        x = torch.cat((x, crumbs.flatten(0, 1)))
    if request.param == "copies":
        x = x[:50].repeat(4, 1)
    with torch.no_grad():
        surface = field.encode(x)
        radius = 1e-5 if request.param == "empty" else None
        return surface, local_geometry(surface, k=8, radius=radius)


@pytest.mark.parametrize("name", ["tangent", "geodesic", "adaptive", "harmonic", "vectors", "pool"])
def test_poor_neighbourhoods_have_finite_outputs_and_gradients(poor, name):
    surface, geometry = poor
    x = torch.randn(geometry.points, 3, requires_grad=True)
    if name == "harmonic":
        y = magnitudes(HarmonicConv(3, 4)(to_streams(x, 2), geometry))
    elif name == "vectors":
        pairs = torch.stack((x, x), -1)
        y = VectorPool()(pairs, geometry)
        assert ParallelTransport()(pairs, geometry).isfinite().all()
    elif name == "pool":
        y, cells = GeodesicPool(ratio=0.2, reduce="attention", channels=3)(x, geometry)
        assert isinstance(cells, Cells) and bool((cells.distance >= 0).all())
    elif name == "adaptive":
        y = AdaptiveGeodesicConv(3, 4)(x, geometry, surface)
    else:
        layer = {"tangent": TangentConv, "geodesic": GeodesicConv}[name]
        y = layer(3, 4)(x, geometry)
    assert bool(y.isfinite().all())
    y.square().sum().backward()
    assert x.grad is not None and bool(x.grad.isfinite().all())
