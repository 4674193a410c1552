"""The tangent plane at a source: what it is chosen from, and that Log's priors lie in it."""

import torch
from references import fibonacci_sphere, lumpy
from torch import Tensor

from riemlayer import ExpLogField
from riemlayer.heads.branch import Embedding, at_sources, sites


def asked(field: ExpLogField, cloud: Tensor) -> tuple[Embedding, Tensor, Tensor]:
    """Embedding, sources and their shapes in the cube."""
    embedding = field.embed(cloud, torch.zeros(len(cloud), dtype=torch.long))
    p = cloud[::60]
    return embedding, p, torch.zeros(len(p), dtype=torch.long)


def normal_of(field: ExpLogField, cloud: Tensor) -> tuple[Tensor, list[Tensor]]:
    """The tangent planes' normals, and what they are a mean of."""
    embedding, p, shape = asked(field, cloud)
    seen = at_sources(embedding.planes, p, shape)
    site = sites(embedding, p, shape, seen)
    assert field.log_head.tangent_plane is not None
    normal = field.log_head.tangent_plane(embedding, p, shape, site, seen)
    near = embedding.points.normals(p, shape, embedding.planes.scales[0].coarse)
    return normal, [n for n, *_ in (*seen, *near)]


def test_untrained_it_is_nearly_a_mean_of_planes_and_of_most_points():
    field = ExpLogField.from_preset("base")
    normal, normals = normal_of(field, 0.9 * lumpy(20_000).float())
    torch.testing.assert_close(normal.norm(dim=-1), torch.ones(len(normal)))
    side = (normals[0] * normals[-1]).sum(-1, keepdim=True).sign()
    mean = torch.nn.functional.normalize(normals[0] + side * normals[-1], dim=-1)
    assert ((normal * mean).sum(-1) > 0.99).all()


def test_where_points_are_too_few_it_is_nearly_that_of_the_first_planes():
    """On a sphere of points further apart than a cell, from half as large planes and finer ones,
    which see a point each: those say nothing, and share a tenth."""
    field = ExpLogField.from_preset("base")
    normal, normals = normal_of(field, fibonacci_sphere(1500).float())
    torch.testing.assert_close(normal.norm(dim=-1), torch.ones(len(normal)))
    assert ((normal * normals[0]).sum(-1) > 0.99).all()


def test_trained_it_is_one_of_a_mean_with_the_sign_of_the_first_planes():
    field = ExpLogField.from_pretrained("base")
    normal, normals = normal_of(field, 0.9 * lumpy(3000).float())
    torch.testing.assert_close(normal.norm(dim=-1), torch.ones(len(normal)))
    assert ((normal * normals[0]).sum(-1) > 0.5).all()


@torch.no_grad()
def test_logs_before_the_correction_lie_in_it():
    """From a few cells on; closer by, chords are answered as they are."""
    field = ExpLogField.from_pretrained("base")
    cloud = 0.9 * lumpy(3000).float()
    embedding, p, shape = asked(field, cloud)
    normal, _ = normal_of(field, cloud)
    q = cloud[None, ::20].expand(len(p), -1, -1)
    prepared = field.log_head.prepare(embedding, p, q, shape)
    assert prepared.prior is not None
    length = prepared.prior.norm(dim=-1)
    beside = (prepared.prior * normal[:, None]).sum(-1).abs() / length.clamp_min(1e-6)
    far = prepared.x.norm(dim=-1) > 4 * embedding.planes.fine.level.cell_size
    assert far.any() and beside[far].max() < 0.05, beside[far].max()


@torch.no_grad()
def test_half_precision_leaves_it_as_it_is():
    """Fans part at rims by little: a degree here was a third of the radius there."""
    field = ExpLogField.from_pretrained("base")
    cloud = 0.9 * lumpy(3000).float()
    normal, _ = normal_of(field, cloud)
    with torch.autocast("cpu", torch.bfloat16):
        half, _ = normal_of(field, cloud)
    assert torch.linalg.cross(normal, half).norm(dim=-1).max() < 1e-5


def test_it_has_gradients_in_its_weights_and_in_the_points():
    field = ExpLogField.from_pretrained("base")
    cloud = (0.9 * lumpy(1500).float()).requires_grad_()
    normal, _ = normal_of(field, cloud)
    plane = field.log_head.tangent_plane
    assert plane is not None
    weights = list(plane.parameters())
    found = torch.autograd.grad(normal.square().sum(0)[0], [cloud, *weights])
    assert all(g.isfinite().all() and g.abs().max() > 0 for g in found)


@torch.no_grad()
def test_frames_of_a_surface_span_the_plane_that_logs_lie_in():
    """On a face of a cube, one point and one and a half away from its edge, where the cloud's
    blended planes lean towards the next face."""
    side = torch.linspace(-1, 1, 41)
    flat = torch.cartesian_prod(side, side)
    square = torch.cat((flat, torch.ones_like(flat[:, :1])), 1)
    faces = [square.roll(i, 1) * (1 if i < 3 else -1) for i in range(6)]
    surface = ExpLogField.from_pretrained("base").encode(torch.cat(faces).unique(dim=0))
    along = torch.linspace(-0.8, 0.8, 17)
    for away in (0.05, 0.075):
        p = torch.stack((along, torch.full_like(along, 1 - away), torch.ones_like(along)), -1)
        tilt = surface.normal(p)[:, :2].norm(dim=-1).mean()
        blended = surface.embedding.planes.normal(p, torch.zeros(len(p), dtype=torch.long))
        assert tilt < 0.02 < blended[:, :2].norm(dim=-1).mean()
        q = p[:, None] + 0.3 * torch.tensor([[1.0, 0, 0], [0, -1, 0], [0.7, -0.7, 0]])
        log = surface.log(p[:, None], q)
        flattened = surface.to_2d(p[:, None], log)
        torch.testing.assert_close(flattened.norm(dim=-1), log.norm(dim=-1), atol=1e-4, rtol=0)
