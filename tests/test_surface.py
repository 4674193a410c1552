"""`EncodedSurface`: the laws of Exp and Log for any weights, and what may be asked of a surface."""

import pytest
import torch
from laws import (
    autograd_jacobians,
    check_anchored,
    check_broadcast,
    check_differentials,
    check_pure,
)
from references import encoded, lumpy, packed, shaken
from torch import Tensor
from torch.autograd import gradcheck

from riemlayer import EncodedSurface, ExpLogField


@pytest.fixture(scope="module")
def surface() -> EncodedSurface:
    torch.manual_seed(0)
    return encoded()


@pytest.fixture(scope="module")
def batch() -> EncodedSurface:
    """Three clouds of different sizes, in one surface."""
    torch.manual_seed(0)
    clouds = lumpy(200), 3 * lumpy(150) + 5, 0.1 * lumpy(100) - 1
    with torch.no_grad():
        return shaken("tiny").encode(*packed(*clouds))


def double(*shape: int) -> Tensor:
    return torch.randn(*shape, dtype=torch.float64)


def vectors(*shape: int, length: float = 0.3) -> Tensor:
    v = double(*shape, 3)
    return length * v / v.norm(dim=-1, keepdim=True)


# ------------------------------------------------------------------------------------ anchors


def test_random_weights_do_change_the_maps(surface):
    """What follows would say little if the corrections were small."""
    p, v = lumpy(300)[:50], vectors(50)
    assert (surface.exp(p, v) - p - v).norm(dim=-1).mean() > 0.1
    assert (surface.log(p, p + v) - v).norm(dim=-1).mean() > 0.1


@pytest.mark.parametrize("preset", ["tiny", "base"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("size, place", [(1.0, 0.0), (37.0, 1000.0)], ids=["cube", "far away"])
def test_anchors_hold_to_rounding_in_any_units(preset, dtype, size, place):
    points = size * lumpy(300, dtype) + place
    surface = shaken(preset, dtype).encode(points).detach()
    p = torch.cat((points[:10], points[10:20] + 0.3 * size))  # on the cloud and off it
    eps = torch.finfo(dtype).eps
    check_anchored(surface.exp, surface.log, p, atol=4 * eps * (size + place))
    assert torch.equal(surface.log(p, p), torch.zeros_like(p))
    for jacobian, x in ((surface.jacobian_exp, torch.zeros_like(p)), (surface.jacobian_log, p)):
        _, J = jacobian(p, x)
        torch.testing.assert_close(J, torch.eye(3, dtype=dtype).expand(20, 3, 3), rtol=0, atol=1e-6)
    check_differentials(surface.exp, surface.log, p, torch.randn_like(p), atol=1e-5)


# ------------------------------------------------------------------------------------ derivatives


def test_jacobians_are_those_of_autograd(surface):
    p, v = lumpy(300)[:6], vectors(6)
    for x, f, jacobian in (
        (v, surface.exp, surface.jacobian_exp),
        (p + v, surface.log, surface.jacobian_log),
    ):
        value, J = jacobian(p, x)
        torch.testing.assert_close(value, f(p, x))
        torch.testing.assert_close(J, autograd_jacobians(f, p, x), rtol=1e-8, atol=1e-10)


def test_jacobians_broadcast_and_take_expanded_queries(surface):
    p, v = lumpy(300)[:4], vectors(5)
    value, J = surface.jacobian_exp(p[:, None], v.expand(4, 5, 3))
    assert value.shape == (4, 5, 3) and J.shape == (4, 5, 3, 3)
    one, K = surface.jacobian_exp(p[1], v[2])
    torch.testing.assert_close(value[1, 2], one)
    torch.testing.assert_close(J[1, 2], K)


@pytest.mark.parametrize("preset", ["tiny", "paper"])
def test_gradcheck_in_base_points_and_queries(preset):
    points = lumpy(60)
    surface = shaken(preset, strength=0.5).encode(points).detach()
    p = (1.02 * points[:2]).requires_grad_()
    v = vectors(2, 2).requires_grad_()
    q = (points[:2, None] + vectors(2, 2)).requires_grad_()
    assert gradcheck(lambda p, v: surface.exp(p[:, None], v), (p, v), atol=1e-4)
    assert gradcheck(lambda p, q: surface.log(p[:, None], q), (p, q), atol=1e-4)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradients_at_the_source_are_finite(dtype):
    field, points = shaken("tiny", dtype), lumpy(200, dtype).requires_grad_()
    surface = field.encode(points)
    p = points.detach()[:8].clone().requires_grad_()
    v, q = torch.zeros_like(p, requires_grad=True), p.detach().clone().requires_grad_()
    (surface.exp(p, v).square().sum() + surface.log(p, q).square().sum()).backward()
    for x in (points, p, v, q, *field.parameters()):
        assert x.grad is None or x.grad.isfinite().all()
    torch.testing.assert_close(v.grad, 2 * p.detach())


def test_gradients_of_jacobians_are_finite_at_the_source():
    field, points = shaken("tiny"), lumpy(200)
    surface, p = field.encode(points), points[:4]
    _, J = surface.jacobian_exp(p, torch.zeros_like(p))
    _, K = surface.jacobian_log(p, p)
    (J.square().sum() + K.square().sum()).backward()
    grads = [x.grad for x in field.parameters() if x.grad is not None]
    assert grads and all(g.isfinite().all() for g in grads)


# ------------------------------------------------------------------------------------ calls


def test_broadcasting_is_a_loop(surface):
    p, v = lumpy(300)[:3], vectors(3, 4)
    check_broadcast(surface.exp, p, v, atol=1e-12)
    check_broadcast(surface.log, p, p[:, None] + v, atol=1e-12)


@pytest.mark.parametrize(
    "p, x", [((3,), (3,)), ((3,), (5, 3)), ((4, 3), (3,)), ((2, 1, 3), (5, 3)), ((0, 3), (0, 3))]
)
def test_any_shapes_that_broadcast_are_answered(surface, p, x):
    p, x = 0.5 * double(*p), 0.2 * double(*x)
    shape = torch.broadcast_shapes(p.shape, x.shape)
    for f in (surface.exp, surface.log):
        answer, info = f(p, x, return_info=True)
        assert answer.shape == shape and all(y.shape == shape[:-1] for y in info)
        assert torch.equal(f(p, x), answer)
    for f in (surface.jacobian_exp, surface.jacobian_log):
        value, J = f(p, x)
        assert value.shape == shape and J.shape == (*shape, 3)


@pytest.mark.parametrize("chunk_size", [1, 7, 64])
def test_chunks_do_not_change_answers(surface, chunk_size):
    p, v = lumpy(300)[:5, None], vectors(5, 9)
    for f, x in ((surface.exp, v), (surface.log, p + v)):
        whole, in_parts = f(p, x), f(p, x, chunk_size=chunk_size)
        torch.testing.assert_close(in_parts, whole, rtol=0, atol=1e-12)


def test_calls_are_pure(surface):
    p, v = lumpy(300)[:5], vectors(5)
    check_pure(surface.exp, p, v)
    check_pure(surface.log, p, p + v)
    check_pure(lambda p, v: surface.jacobian_exp(p, v)[1], p, v)
    check_pure(lambda p, v: surface.exp(p, v, return_info=True)[1].cycle_error, p, v)


def test_info(surface):
    p, v = lumpy(300)[:20], vectors(20)
    q, info = surface.exp(p, v, return_info=True)
    assert ((info.validity > 0) & (info.validity < 1)).all() and info.in_support.all()
    torch.testing.assert_close(info.cycle_error, (surface.log(p, q) - v).norm(dim=-1))
    u, info = surface.log(p, q, return_info=True)
    torch.testing.assert_close(info.cycle_error, (surface.exp(p, u) - q).norm(dim=-1))


# ------------------------------------------------------------------------------------ off limits


def test_base_points_off_the_support_are_answered_and_marked(surface):
    near = lumpy(300)[:3]
    p = torch.cat((near, torch.tensor([[0.0, 0, 0], [0.99, 0.99, 0.99], [40.0, -3, 8]]).double()))
    for f, x in ((surface.exp, vectors(6)), (surface.log, p + vectors(6))):
        answer, info = f(p, x, return_info=True)
        assert info.in_support.tolist() == [True, True, True, False, False, False]
        assert answer.isfinite().all() and (answer != 0).any(-1).all()
        assert all(y.isfinite().all() for y in info)


def test_beyond_the_cube_answers_stay_within_reach(surface):
    """No extrapolation by negative weights: the answer stays of the size of the query."""
    wall = torch.tensor([1.06, 1.0624999, 1.1, 1.2, 3.0]).double()
    p = torch.stack((wall, 0.3 * wall, -wall), -1)
    q = p + vectors(5)
    assert (surface.log(p, q).norm(dim=-1) < 30).all()
    assert (surface.exp(p, q - p) - p).norm(dim=-1).max() < 30


def test_long_vectors_are_answered_with_low_validity(surface):
    p = lumpy(300)[:10]
    for reach in (1.5, 3.0, 100.0):
        q, info = surface.exp(
            p, vectors(10, length=reach * float(surface.radius)), return_info=True
        )
        assert q.isfinite().all() and (info.validity < 1e-3).all()
    v, info = surface.log(p, p + vectors(10, length=100.0), return_info=True)
    assert v.isfinite().all() and (info.validity[v.norm(dim=-1) > 1] < 1e-3).all()


@pytest.mark.parametrize("which", ["exp", "log"])
@pytest.mark.parametrize(
    "p, x, error, words",
    [
        (torch.zeros(2, 3), double(2, 3), ValueError, "`p` must have dtype torch.float64"),
        (double(2, 3), torch.zeros(2, 3), ValueError, "`[vq]` must have dtype torch.float64"),
        (double(2, 3), torch.zeros(2, 3).long(), TypeError, "`[vq]` must have a floating-point"),
        (double(2, 2), double(2, 3), ValueError, r"`p` must have shape \(..., 3\), got \(2, 2\)"),
        (double(2, 3), double(2, 4), ValueError, r"`[vq]` must have shape \(..., 3\)"),
        (double(2, 3), double(2, 3) / 0, ValueError, "`[vq]` must be finite"),
        (double(2, 3) * torch.nan, double(2, 3), ValueError, "`p` must be finite"),
        (double(4, 3), double(4, 7, 3), ValueError, r"`p` and `[vq]` must broadcast.*p\[:, None\]"),
        (double(2, 3).to("meta"), double(2, 3), ValueError, "`p` must be on device cpu, got meta"),
        ([0.0, 0, 0], double(3), TypeError, "`p` must be a torch.Tensor, got list"),
        (double(3), double(3).numpy(), TypeError, "torch.from_numpy"),
    ],
)
def test_bad_queries_are_named(surface, which, p, x, error, words):
    for call in (getattr(surface, which), getattr(surface, f"jacobian_{which}")):
        with pytest.raises(error, match=words) as raised:
            call(p, x)
        letter = "v" if which == "exp" else "q"
        assert "`p`" in str(raised.value) or f"`{letter}`" in str(raised.value)


# ------------------------------------------------------------------------------------ batches


def test_a_batch_is_its_shapes(batch):
    assert len(batch) == 3 and [len(one) for one in batch] == [1, 1, 1]
    p, v = 0.5 * double(3, 4, 3), vectors(3, 4)
    shape = torch.arange(3)[:, None]
    p = p * batch.scale[shape][..., None] + batch.centre[shape]
    v = v * batch.scale[shape][..., None]
    together = batch.exp(p, v, shape=shape), batch.log(p, p + v, shape=shape)
    for i, one in enumerate(batch):
        torch.testing.assert_close(together[0][i], one.exp(p[i], v[i]))
        torch.testing.assert_close(together[1][i], one.log(p[i], p[i] + v[i]))
    torch.testing.assert_close(torch.stack([one.radius for one in batch]), batch.radius)


def test_shape_broadcasts_with_base_points(batch):
    """Also where `p` alone is smaller than `shape`, or the other way round."""
    centre = batch.centre[:, None]
    v = vectors(3, 5, length=0.05)
    shape = torch.arange(3)[:, None]
    q, info = batch.exp(centre, v, shape=shape, return_info=True)
    assert q.shape == (3, 5, 3) and info.in_support.shape == (3, 5)
    p = torch.tensor([0.1, 0.2, 0.3]).double()
    q, info = batch.exp(p, 0 * p, shape=torch.arange(3), return_info=True)
    assert q.shape == (3, 3) and info.in_support.shape == (3,)
    _, J = batch.jacobian_log(centre, centre + v, shape=shape)
    assert J.shape == (3, 5, 3, 3)
    spread = centre.expand(3, 5, 3)
    _, info = batch.log(spread, spread + v, shape=shape, return_info=True)
    assert info.in_support.shape == (3, 5)


def test_indices(batch, surface):
    with pytest.raises(IndexError, match="surface 3 of a batch of 3"):
        batch[3]
    p, v = double(2, 3) * 0.1, vectors(2)
    torch.testing.assert_close(batch[-1].exp(p, v), batch[2].exp(p, v))
    torch.testing.assert_close(surface[0].exp(p, v), surface.exp(p, v))
    torch.testing.assert_close(batch[1][0].exp(p, v), batch[1].exp(p, v))
    with pytest.raises(IndexError, match="surface 1 of a batch of 1"):
        batch[1][1]


@pytest.mark.parametrize(
    "shape, error, words",
    [
        (None, ValueError, r"`shape` must say which of the 3 clouds .* surface\[i\]"),
        (torch.tensor([0, 3]), ValueError, r"`shape` must lie in \[0, 3\)"),
        (torch.tensor([0, -1]), ValueError, r"`shape` must lie in \[0, 3\)"),
        (torch.tensor([0.0, 1.0]), TypeError, "`shape` must be a torch.int64 tensor"),
        (torch.tensor([0, 1, 2]), ValueError, "`shape` and `p` must broadcast"),
    ],
)
def test_bad_shape_indices_are_named(batch, shape, error, words):
    with pytest.raises(error, match=words):
        batch.exp(double(2, 3), vectors(2), shape=shape)


def test_detach_and_to(surface):
    field = ExpLogField.from_preset("tiny").double()
    live = field.encode(lumpy(100))
    p, v = double(3, 3), vectors(3)
    assert live.embedding.z.requires_grad and not live.detach().embedding.z.requires_grad
    for copy in (live.detach(), live.to("cpu")):
        torch.testing.assert_close(copy.exp(p, v), live.exp(p, v))
        assert copy.field is field
