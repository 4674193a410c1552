"""Encoding: what a surface does not depend on, what it is differentiable in, what is refused."""

import contextlib
from dataclasses import replace

import pytest
import torch
from laws import check_pure
from references import fibonacci_sphere, lumpy, packed, shaken
from torch import Tensor
from torch.autograd import gradcheck

from riemlayer import ExpLogField
from riemlayer import field as field_module
from riemlayer.config import FieldConfig
from riemlayer.surface import EncodedSurface


def queries(points: Tensor) -> tuple[Tensor, Tensor]:
    """Sources of a cloud, a little off it, and vectors of half its trained radius."""
    generator = torch.Generator().manual_seed(3)
    v = torch.randn(10, 4, 3, generator=generator).to(points.dtype)
    size = float(points.amax(0).sub(points.amin(0)).max()) / 2
    return 1.001 * points[:10, None], 0.25 * size * v / v.norm(dim=-1, keepdim=True)


def answers(surface: EncodedSurface, p: Tensor, v: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Exp, Log and validity, without a graph."""
    with torch.no_grad():
        q, info = surface.exp(p, v, return_info=True)
        return q, surface.log(p, p + v), info.validity


def same(a: tuple[Tensor, ...], b: tuple[Tensor, ...], tolerance: float) -> None:
    for x, y in zip(a, b, strict=True):
        torch.testing.assert_close(x, y, rtol=tolerance, atol=tolerance)


@pytest.fixture
def full_precision(monkeypatch):
    """No bfloat16: in half precision a batch equals its shapes to three digits only."""
    monkeypatch.setattr(ExpLogField, "half_precision", lambda self: contextlib.nullcontext())


# ------------------------------------------------------------------------------------ invariances


@pytest.mark.parametrize("preset", ["tiny", "paper"])
@pytest.mark.parametrize("dtype, tolerance", [(torch.float64, 1e-9), (torch.float32, 2e-4)])
def test_a_batch_is_its_shapes_one_by_one(preset, dtype, tolerance, full_precision):
    clouds = lumpy(200, dtype), 3 * lumpy(150, dtype) + 5, 0.1 * lumpy(80, dtype)
    field = shaken(preset, dtype, strength=0.5)
    together = field.encode(*packed(*clouds))
    for i, points in enumerate(clouds):
        p, v = queries(points)
        same(answers(together[i], p, v), answers(field.encode(points), p, v), tolerance)


@pytest.mark.parametrize("preset", ["tiny", "base"])
def test_a_shift_by_a_coarsest_cell_changes_nothing(preset):
    """Inside the cube, where a cloud keeps its size: only local offsets enter the network."""
    points, field = 0.4 * lumpy(250), shaken(preset)
    p, v = queries(points)
    zero = torch.zeros(250, dtype=torch.long)
    expected = answers(field.encode_in_cube(points, zero), p, v)
    cell = 2.125 / 4  # both presets go down to 4 cells along the cube
    for shift in ([cell, 0, 0], [-cell, cell, -cell]):
        t = torch.tensor(shift).double()
        q, log, validity = answers(field.encode_in_cube(points + t, zero), p + t, v)
        same((q - t, log, validity), expected, 1e-5)


@pytest.mark.parametrize("preset", ["tiny", "paper"])
@pytest.mark.parametrize("s, t", [(1.0, 7.0), (40.0, 0.0), (1e-3, -300.0)])
def test_scale_and_translation_carry_through(preset, s, t):
    points, field = lumpy(250), shaken(preset, strength=0.5)
    p, v = queries(points)
    q, log, validity = answers(field.encode(points), p, v)
    moved = answers(field.encode(s * points + t), s * p + t, s * v)
    expected = (s * q + t, s * log, validity)
    for x, y in zip(moved, expected, strict=True):
        torch.testing.assert_close(x, y, rtol=1e-7, atol=1e-7 * s)


@pytest.mark.parametrize("preset", ["tiny", "paper"])
def test_order_of_the_points_does_not_matter(preset):
    points, field = lumpy(250), shaken(preset)
    p, v = queries(points)
    shuffled = points[torch.randperm(250)]
    same(answers(field.encode(shuffled), p, v), answers(field.encode(points), p, v), 1e-9)


def test_calls_are_pure():
    points, batch = packed(lumpy(80), lumpy(60))
    field = shaken("tiny", torch.float32)
    check_pure(lambda points, batch: field.encode(points, batch).embedding.z, points.float(), batch)
    p, v = queries(points.float())
    check_pure(lambda points, p, v: field(points, p, v=v).exp, points.float(), p, v)


def test_training_mode_makes_no_difference():
    points, field = lumpy(100), shaken("tiny")
    p, v = queries(points)
    expected = answers(field.eval().encode(points), p, v)
    same(answers(field.train().encode(points), p, v), expected, 0)


# ------------------------------------------------------------------------------------ gradients


def test_gradcheck_in_the_points():
    points = lumpy(40)
    p, v = (x[:3, :2].clone() for x in queries(points))
    field = shaken("tiny", strength=0.5)

    def ask(points: Tensor) -> Tensor:
        surface = field.encode(points)
        return torch.stack((surface.exp(p, v), surface.log(p, p + v)))

    assert gradcheck(ask, points.requires_grad_(), atol=1e-4, fast_mode=True)


def test_gradients_reach_every_weight_but_those_of_validity():
    points, field = lumpy(100), shaken("tiny")
    p, v = queries(points)
    out = field(points, p, v=v, q=p + v)
    (out.exp.square().sum() + out.log.square().sum()).backward()
    missing = [n for n, x in field.named_parameters() if x.grad is None or not x.grad.any()]
    assert missing == [f"{h}_head.valid.{k}" for h in ("exp", "log") for k in ("weight", "bias")]


# ------------------------------------------------------------------------------------ the call


def test_forward_is_encode_then_exp_and_log():
    points, batch = packed(lumpy(80), lumpy(60))
    field = shaken("tiny")
    p, v = queries(points)
    shape = torch.zeros(10, 1, dtype=torch.long)
    out = field(points, p, v=v, q=p + v, batch=batch, shape=shape)
    surface = field.encode(points, batch)[0]
    torch.testing.assert_close(out.exp, surface.exp(p, v))
    torch.testing.assert_close(out.log, surface.log(p, p + v))
    assert field(lumpy(80), p).exp is None and field(lumpy(80), p, v=v).log is None


def test_half_precision_stays_near_full_precision(monkeypatch):
    """Where the processor has bfloat16: answers are float32 and three digits agree."""
    points, field = lumpy(300, torch.float32), ExpLogField.from_preset("base").eval()
    p, v = queries(points)
    monkeypatch.setattr(field_module, "_has_bfloat16", lambda device: True)
    half = answers(field.encode(points), p, v)
    monkeypatch.setattr(field_module, "_has_bfloat16", lambda device: False)
    full = answers(field.encode(points), p, v)
    assert all(x.dtype == torch.float32 for x in half)
    same(half[:2], full[:2], 5e-3)


@pytest.mark.parametrize(
    "points",
    [
        torch.eye(4)[:, :3],
        torch.linspace(-1, 1, 50)[:, None] * torch.tensor([1.0, 0, 0]),
        torch.rand(50, 3) * torch.tensor([1.0, 1, 0]),
        torch.eye(3).repeat(20, 1),
        torch.cat((torch.rand(50, 3), torch.tensor([[1e4, 0, 0]]))),
        1e-12 * torch.rand(50, 3),
        1e12 * torch.rand(50, 3),
    ],
    ids=["tetrahedron", "line", "plane", "duplicates", "outlier", "minute", "huge"],
)
@pytest.mark.parametrize("preset", ["tiny", "paper"])
def test_odd_clouds_have_finite_answers_and_gradients(points, preset):
    field = shaken(preset, torch.float32, strength=0.5)
    points = points.clone().requires_grad_()
    surface = field.encode(points)
    p, v = points.detach()[:4], 0.3 * surface.detach().scale * torch.randn(4, 3)
    q, log = surface.exp(p, v), surface.log(p, p + v)
    assert q.isfinite().all() and log.isfinite().all()
    ((q / surface.scale).sum() + (log / surface.scale).sum()).backward()
    grads = [points.grad, *(x.grad for x in field.parameters())]
    assert all(g is None or g.isfinite().all() for g in grads)


# ------------------------------------------------------------------------------------ bad input


CLOUD = lumpy(30, torch.float32)


def with_value(value: float) -> Tensor:
    points = CLOUD.clone()
    points[7, 1] = value
    return points


@pytest.mark.parametrize(
    "points, error, words",
    [
        (CLOUD[:0], ValueError, "at least 4 points, got 0"),
        (CLOUD[:3], ValueError, "at least 4 points, got 3"),
        (with_value(torch.nan), ValueError, "`points` must be finite, got NaN or infinity in 1"),
        (with_value(torch.inf), ValueError, "`points` must be finite"),
        (CLOUD[:, :2], ValueError, r"`points` must have shape \(N, 3\), got \(30, 2\)"),
        (CLOUD[None], ValueError, "pass `batch`"),
        (CLOUD.long(), TypeError, r"points.float\(\)"),
        (CLOUD.double(), ValueError, r"`points` must have dtype torch.float32 .*torch.float64"),
        (CLOUD.to("meta"), ValueError, "`points` must be on device cpu, got meta"),
        (CLOUD.numpy(), TypeError, "torch.from_numpy"),
        (torch.ones(9, 3), ValueError, "not all be equal"),
    ],
)
def test_bad_clouds_are_named(points, error, words):
    field = ExpLogField.from_preset("tiny")
    with pytest.raises(error, match=words) as raised:
        field.encode(points)
    assert "`points`" in str(raised.value)


@pytest.mark.parametrize(
    "batch, error, words",
    [
        ([1] * 15 + [0] * 15, ValueError, "sorted"),
        ([-1] * 15 + [0] * 15, ValueError, "negative"),
        ([0] * 29, ValueError, r"shape \(30,\)"),
        ([0] * 27 + [1] * 3, ValueError, "at least 4 points, got 3 in shape 1"),
        ([0.0] * 30, TypeError, "int64"),
    ],
)
def test_bad_batches_are_named(batch, error, words):
    with pytest.raises(error, match=words) as raised:
        ExpLogField.from_preset("tiny").encode(CLOUD, torch.tensor(batch))
    assert "`batch`" in str(raised.value)


# ---------------------------------------------------------------------------------------- normals


def test_normals_of_one_side_or_the_other_give_the_same_maps():
    """On a closed surface whose sides are far apart, which side they are on has no say."""
    points = fibonacci_sphere(2000).double()
    field, (p, v) = shaken("tiny"), queries(points)
    plain = answers(field.encode(points), p, v)
    same(plain, answers(field.encode(points, normals=points), p, v), 1e-9)
    same(plain, answers(field.encode(points, normals=-points), p, v), 1e-9)


def test_a_field_for_normals_needs_and_uses_them():
    config = FieldConfig.tiny()
    config = replace(config, backbone=replace(config.backbone, normals=True))
    field, points = ExpLogField(config).double(), fibonacci_sphere(500).double()
    with pytest.raises(ValueError, match="`normals` must be given"):
        field.encode(points)
    inward, outward = (field.encode(points, normals=n).embedding.z for n in (-points, points))
    assert (inward - outward).abs().max() > 1e-3
    with pytest.raises(ValueError, match="set kind='octree' and stem > 0"):
        replace(config.backbone, stem=0)


@pytest.mark.parametrize(
    "normals, message",
    [
        (torch.zeros(500, 3).double(), "length 1 within 1%, got 0"),
        (torch.ones(400, 3).double(), r"shape of `points` \(500, 3\), got \(400, 3\)"),
        (torch.full((500, 3), torch.nan).double(), "finite"),
    ],
)
def test_bad_normals_are_named(normals, message):
    field, points = ExpLogField.from_preset("tiny").double(), fibonacci_sphere(500).double()
    with pytest.raises(ValueError, match=f"`normals`.*{message}"):
        field.encode(points, normals=normals)
