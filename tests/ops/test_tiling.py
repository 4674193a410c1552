"""Tiles of a scene answer as the scene encoded whole, wherever they meet."""

import contextlib
import math

import pytest
import torch
from references import lumpy, shaken
from torch import Tensor
from torch.nn.functional import normalize

from riemlayer import ExpLogField
from riemlayer.octree import HALF_WIDTH
from riemlayer.ops import TiledSurface, encode_tiled, stitch_log, tiling

CELL = 2 * HALF_WIDTH / 4
"""Side of a coarsest cell of `tiny` and `base`, in the cube."""


@pytest.fixture
def full_precision(monkeypatch):
    """No bfloat16: in half precision a batch equals its shapes to three digits only."""
    monkeypatch.setattr(ExpLogField, "half_precision", lambda self: contextlib.nullcontext())


def ask(surface, p: Tensor, radius: float) -> tuple[Tensor, Tensor]:
    """Exp of tangent fans around each source, and Log of the points near it."""
    generator = torch.Generator().manual_seed(5)
    v = torch.randn(len(p), 12, 3, generator=generator).to(p.dtype)
    v = normalize(surface.project(p[:, None], v), dim=-1)
    v = radius * torch.rand(len(p), 12, 1, generator=generator).to(p.dtype) * v
    near = (surface.points[None] - p[:, None]).norm(dim=-1).argsort(dim=-1)[:, :60:6]
    with torch.no_grad():
        return surface.exp(p[:, None], v), surface.log(p[:, None], surface.points[near])


# ------------------------------------------------------------------------------------- agreement


def test_the_tile_of_the_whole_scene_answers_as_encode(full_precision):
    points, field = torch.cat((lumpy(300), 0.2 * lumpy(99))), shaken("tiny", strength=0.3)
    whole = field.encode(points)
    surface = encode_tiled(field, points, field.config.radius * float(whole.scale))
    central = ((points - whole.centre) / whole.scale).abs().amax(-1) < CELL / 2
    p = points[central][::10]
    for x, y in zip(ask(surface, p, 0.3), ask(whole, p, 0.3), strict=True):
        torch.testing.assert_close(x, y, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_seams_are_within_one_percent_of_the_radius():
    """The shipped weights: every tile but one sees a part of the shape, and answers alike."""
    field = ExpLogField.from_pretrained("base").eval()
    points = lumpy(1500).float()
    with torch.no_grad():
        whole = field.encode(points)
    radius = field.config.radius * float(whole.scale)  # at which it has the same cells
    surface = encode_tiled(field, points, radius)
    centres = surface.tiles.centre[surface.tile(points)]
    cut = ((centres - whole.centre).abs().amax(-1) > 0.1 * radius).nonzero().squeeze(-1)
    assert len(surface) > 20 and len(cut) > 1200
    p = points[cut[::60]]
    for x, y in zip(ask(surface, p, radius), ask(whole, p, radius), strict=True):
        miss = (x - y).norm(dim=-1) / radius
        assert miss.mean() < 0.002 and miss.max() < 0.01


def street(n: int = 3000, length: float = 12.0, dtype: torch.dtype = torch.float64) -> Tensor:
    """(n, 3) points of the plane z = 0, 2 wide."""
    generator = torch.Generator().manual_seed(1)
    x = torch.rand(n, 3, generator=generator, dtype=dtype)
    return x * x.new_tensor([length, 2.0, 0.0])


def test_geodesics_of_a_street_go_straight_through_all_its_tiles():
    """Untrained maps are little more than their priors, which are exact on planes."""
    points = street(1500)
    surface = encode_tiled(ExpLogField.from_preset("tiny").double(), points, radius=0.5)
    p = torch.tensor([[1.0, 1.0, 0.0]]).double()
    v = torch.tensor([[5.0, 0.1, 0.0]]).double()
    shot = surface.shoot(p, v, steps=10)
    assert len(surface.tile(shot.path).unique()) > 8
    assert (shot.point - (p + v)).norm() < 0.05 * v.norm()


def test_charts_are_stitched_over_tiles():
    points = street(1500, 6.0)
    surface = encode_tiled(ExpLogField.from_preset("tiny").double(), points, radius=0.5)
    p = torch.tensor([3.0, 1.0, 0.0]).double()
    stitched = stitch_log(surface, p, points, depth=3)
    away = (points - p).norm(dim=-1)
    far = stitched.covered & (away > 1.0)
    assert far.sum() > 100
    length = stitched.coordinates.norm(dim=-1)
    assert ((length - away).abs()[far] / away[far]).median() < 0.05


# ------------------------------------------------------------------------------------- the tiling


def test_every_point_is_central_in_its_tile():
    points = 5 * lumpy(400)
    surface = encode_tiled(ExpLogField.from_preset("tiny").double(), points, radius=0.5)
    offset = points - surface.tiles.centre[surface.tile(points)]
    assert offset.abs().max() <= surface.step / 2 + 1e-9
    cells = (surface.tiles.centre - surface.tiles.centre[0]) / CELL
    assert (cells - cells.round()).abs().max() < 1e-9  # scale 1: radius 0.5
    assert len(surface.tiles.points) == len(points)
    assert torch.equal(surface.tile(points).unique(), torch.arange(len(surface)))


@pytest.mark.parametrize("overlap, cells", [(0.7, 1), (0.46, 2), (0.5, 1), (0.2, 3), (0.99, 1)])
def test_tiles_overlap_by_whole_cells_and_no_less_than_asked(overlap, cells):
    surface = encode_tiled(
        ExpLogField.from_preset("tiny").double(), street(200), 1.0, overlap=overlap
    )
    assert surface.step == pytest.approx(2 * cells * CELL)


def test_a_base_point_off_every_tile_asks_the_nearest():
    points = torch.cat((street(100, 2.0), street(100, 2.0) + 40))
    surface = encode_tiled(ExpLogField.from_preset("tiny").double(), points, radius=0.5)
    p = torch.tensor([[10.0, 1, 0], [35, 41, 40], [1e6, 0, 0]]).double()
    apart = (p[:, None] - surface.tiles.centre).abs().amax(-1)
    assert torch.equal(surface.tile(p), apart.argmin(-1))
    assert not surface.in_support(p).any() and surface.in_support(points).all()
    assert surface.exp(p, torch.zeros_like(p)).isfinite().all()


def test_lone_points_have_tiles_too():
    points = torch.cat((street(200, 2.0), torch.tensor([[30.0, 0, 0], [60, 0, 0]]).double()))
    surface = encode_tiled(ExpLogField.from_preset("tiny").double(), points, radius=0.5)
    v = torch.tensor([0.1, 0.2, 0.0]).double()
    assert surface.exp(points[-2:], v.expand(2, 3)).isfinite().all()


@pytest.mark.parametrize("s, t", [(1e3, 0.0), (1e-3, 0.0), (1.0, 500.0)])
def test_units_and_origin_carry_through(s, t, full_precision):
    points, field = street(400, 5.0), shaken("tiny", strength=0.3)
    p, v = points[:9], torch.randn(9, 3).double() * 0.2
    one, other = encode_tiled(field, points, 0.5), encode_tiled(field, s * points + t, 0.5 * s)
    q = other.exp(s * p + t, s * v)
    torch.testing.assert_close((q - t) / s, one.exp(p, v), rtol=1e-7, atol=1e-7)
    assert float(other.radius) == pytest.approx(0.5 * s)


@pytest.mark.slow
def test_how_many_tiles_are_encoded_at_once_does_not_matter(full_precision, monkeypatch):
    points, field = 3 * lumpy(300), shaken("base", strength=0.3)
    p, v = points[:20], 0.3 * torch.randn(20, 3).double()
    once = encode_tiled(field, points, 0.5)
    monkeypatch.setattr(tiling, "GROUP", 200)
    split = encode_tiled(field, points, 0.5)
    for a, b in (
        (once.exp(p, v), split.exp(p, v)),
        (once.log(p, p + v), split.log(p, p + v)),
        (once.normal(p), split.normal(p)),
        (once.snap(p), split.snap(p)),
    ):
        torch.testing.assert_close(a, b, rtol=1e-9, atol=1e-9)


# ------------------------------------------------------------------------------------- the surface


@pytest.fixture(scope="module")
def surface() -> TiledSurface:
    torch.manual_seed(0)
    return encode_tiled(ExpLogField.from_preset("tiny").double(), street(600, 6.0), radius=0.5)


def test_it_is_asked_as_an_encoded_surface(surface):
    p = surface.points[:6]
    v = torch.zeros(6, 4, 3).double()
    q, info = surface.exp(p[:, None], v, return_info=True)
    assert torch.equal(q, p[:, None].expand(6, 4, 3)) and info.validity.shape == (6, 4)
    assert info.in_support.all() and (info.cycle_error == 0).all()
    back, info = surface.log(p[:, None], p[None], return_info=True)
    assert back.shape == (6, 6, 3) and info.cycle_error.shape == (6, 6)
    assert torch.allclose(surface.cdist(p, p), torch.cdist(p, p), atol=0.1)
    assert torch.equal(surface.radius_at(p), torch.full((6,), 0.5).double())
    few = surface.at(torch.tensor([3, 1]))
    assert torch.equal(few.points, surface.points[[3, 1]]) and len(few) == len(surface)
    assert surface.to("cpu").exp(p, v[:, 0]).shape == (6, 3)


def test_chunks_do_not_matter_and_nothing_is_changed(surface):
    p = surface.points[:7].clone()
    v = 0.2 * torch.randn(7, 9, 3).double()
    copies = p.clone(), v.clone()
    torch.testing.assert_close(
        surface.exp(p[:, None], v), surface.exp(p[:, None], v, chunk_size=5), rtol=1e-9, atol=1e-9
    )
    assert torch.equal(p, copies[0]) and torch.equal(v, copies[1])


def test_answers_are_differentiable(surface):
    p = surface.points[:4].clone().requires_grad_()
    v = torch.full((4, 3), 0.1).double().requires_grad_()
    surface.exp(p, v).sum().backward()
    assert p.grad is not None and p.grad.isfinite().all()
    assert v.grad is not None and v.grad.abs().sum() > 0


@pytest.mark.parametrize(
    "arguments, words",
    [
        ({"radius": 0.0}, "`radius` must be a positive length"),
        ({"radius": math.inf}, "`radius` must be a positive length"),
        ({"radius": 1e-30}, "`radius` must be larger than 1e-30 for a scene"),
        ({"overlap": 1.0}, r"`overlap` must lie in \[0, 1\), got 1.0"),
        ({"points": torch.zeros(9, 3)}, "`points` must not all be equal"),
        ({"points": torch.rand(9, 3).double()}, "`points` must have dtype torch.float32"),
        ({"origin": torch.zeros(2)}, "`origin`"),
    ],
)
def test_arguments_are_checked(arguments, words):
    field = ExpLogField.from_preset("tiny")
    usual = {"points": torch.rand(50, 3), "radius": 0.5}
    with pytest.raises(ValueError, match=words):
        encode_tiled(field, **(usual | arguments))


def test_wrong_queries_are_refused(surface):
    with pytest.raises(ValueError, match="`v` must have shape"):
        surface.exp(surface.points[:3], torch.zeros(3, 2).double())
    with pytest.raises(ValueError, match="`p` must be finite"):
        surface.log(torch.full((1, 3), math.nan).double(), surface.points[:1])
