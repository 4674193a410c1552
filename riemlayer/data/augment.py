"""From a prepared shape to a training sample: what a scanner or a modeller might hand over."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from riemlayer.losses import Truth
from riemlayer.numerics import normalise

LONGEST = 0.53
"""Longer vectors, in the normalised cube, are not trained on."""
PATCH = (0.02, 0.08)
"""Range of the sizes of patches in which the errors of a depth camera are alike."""


@dataclass(frozen=True)
class Augmentation:
    """How often and how strongly clouds are changed; all lengths in the normalised cube."""

    as_meshed: float = 0.35
    """Probability that the cloud is the mesh's vertices as they are."""
    soup: float = 0.6
    """Probability that samples of the raw surface are used where there are any."""
    uneven: float = 0.25
    """Probability of a density that varies about 10:1."""
    noise: float = 0.35
    """Probability of noise of up to `noise_size`."""
    noise_size: float = 0.02
    cut: float = 0.2
    """Probability of holes, or of an open patch seen from one side."""
    points: tuple[int, int] = (4000, 15000)
    """Range of the number of points that are sampled."""
    smallest: float = 0.6
    """Shapes are scaled by a factor in [smallest, 1]."""
    turn_freely: float = 0.5
    """Probability of a uniform rotation; otherwise axes are permuted, with a small tilt."""
    normals: bool = False
    """Whether clouds come with outward normals, which noise leaves as they are. Raw surfaces, whose
    normals have no side, are not drawn then."""

    @classmethod
    def none(cls, normals: bool = False) -> Augmentation:
        """Vertices as they are, upright: for validation."""
        return cls(1, 0, 0, 0, cut=0, smallest=1, turn_freely=-1, normals=normals)


@dataclass(frozen=True)
class TrainingSample:
    """A cloud in the cube, and the ground truth that goes with it."""

    points: Tensor
    """(N, 3)"""
    truth: Truth
    normals: Tensor | None = None
    """(N, 3), where they were asked for."""


def training_sample(
    sample: Mapping[str, Tensor],
    how: Augmentation,
    generator: torch.Generator,
    sources: int = 13,
    vectors: int = 768,
    tau: float = 0.5,
) -> TrainingSample:
    """Draw a cloud and `sources` x `vectors` queries from a prepared shape (Sec. 3.3).

    Args:
        sample: tensors of a sample file.
        how: what may happen to the cloud.
        generator: every draw comes from it.
        sources, vectors: S and K; pairs (i, i + K/2) stay pairs.
        tau: threshold of the filter, Eq. (8).
    """
    cloud = draw_points(sample, how, generator)
    s = torch.randperm(len(sample["p"]), generator=generator)[:sources]
    half = sample["v"].shape[1] // 2
    k = torch.randperm(half, generator=generator)[: vectors // 2]
    k = torch.cat((k, k + half))
    p, v, q = sample["p"][s], sample["v"][s][:, k], sample["q"][s][:, k]
    valid = sample["divergence"][s][:, k] < tau
    known = sample["complete"][s][:, k].bool()
    if _chance(how.cut, generator):
        on_path = torch.stack((p[:, None].expand_as(q), half_way(v, q), q))  # (3, S, K, 3)
        cloud, kept = cut_open(cloud, on_path, generator)
        known = known & kept.all(0)
    turn = rotation(how.turn_freely, generator) if how.turn_freely >= 0 else torch.eye(3)
    points, *normals, p, v, q = (x @ turn.T for x in (*cloud.split(3, -1), p, v, q))
    low, high = points.amin(0), points.amax(0)
    scale = _uniform(how.smallest, 1, generator) * 2 / (high - low).max()
    points, p, q = ((x - (low + high) / 2) * scale for x in (points, p, q))
    v = v * scale
    known = known & (v.norm(dim=-1) <= LONGEST)
    truth = Truth(p, v, q, valid, known, torch.zeros(len(p)).long())
    return TrainingSample(points, truth, normalise(normals[0]) if normals else None)


def draw_points(
    sample: Mapping[str, Tensor], how: Augmentation, generator: torch.Generator
) -> Tensor:
    """A cloud (N, 3) of the shape: vertices, surface samples or soup, uneven, noisy.

    With `how.normals` it is (N, 6): points, and what is nearly their normals.
    """
    vertices, faces = sample["vertices"], sample["faces"]
    if how.normals:
        from riemlayer.data.manifold import vertex_normals  # needs the extra `data`

        normals = vertex_normals(vertices.double().numpy(), faces.long().numpy())
        vertices = torch.cat((vertices, torch.from_numpy(normals).to(vertices)), -1)
    if "soup" in sample and not how.normals and _chance(how.soup, generator):
        points = sample["soup"]
    elif _chance(how.as_meshed, generator):
        points = vertices
    else:
        n = int(_uniform(*how.points, generator))
        points = thin_out(sample_surface(vertices, faces, 3 * n, generator), n)
    if _chance(how.uneven, generator):
        points = points[uneven(points[:, :3], generator)]
    if _chance(how.noise, generator):
        x, *rest = points.split(3, -1)
        x = x + noise_like(x, _uniform(0, how.noise_size, generator), generator)
        points = torch.cat((x, *rest), -1)
    return points


def sample_surface(vertices: Tensor, faces: Tensor, n: int, generator: torch.Generator) -> Tensor:
    """(n, 3) independent points, uniform by area; further columns of `vertices` go with them."""
    corners = vertices[faces.long()]  # (m, 3, 3 or more)
    a, b, c = corners[..., :3].unbind(1)
    normal = torch.linalg.cross(b - a, c - a)
    area = normal.norm(dim=-1).double().cumsum(0)
    at = torch.searchsorted(area, torch.rand(n, generator=generator).double() * area[-1])
    a, b = torch.rand(2, n, 1, generator=generator)
    a = a.sqrt()
    c = corners[at.clamp_max(len(corners) - 1)]
    return (1 - a) * c[:, 0] + a * (1 - b) * c[:, 1] + a * b * c[:, 2]


def thin_out(points: Tensor, n: int) -> Tensor:
    """About n of the rows, whose points are spread more evenly: the first in each of about n grid
    cells (ours)."""
    side, x = 0.1, points[:, :3]
    for _ in range(4):  # the number of occupied cells falls with the square of their side
        cells = torch.unique((x / side).floor().long() @ _CELL)
        side *= math.sqrt(len(cells) / n)
    _, cell = torch.unique((x / side).floor().long() @ _CELL, return_inverse=True)
    first = torch.full((int(cell.max()) + 1,), len(points)).scatter_reduce(
        0, cell, torch.arange(len(points)), "amin"
    )
    return points[first]


_CELL = torch.tensor([1, 1 << 12, 1 << 24])


def uneven(points: Tensor, generator: torch.Generator) -> Tensor:
    """(M,) indices of a subset whose density varies smoothly by about 10:1."""
    waves = torch.randn(4, 3, generator=generator) * 2
    phase = torch.rand(4, generator=generator) * (2 * math.pi)
    field = torch.sin(points @ waves.T + phase).sum(-1)
    rank = field.argsort().argsort() / len(field)
    keep = torch.rand(len(points), generator=generator) < 10 ** (-rank)
    return keep.nonzero().squeeze(-1)


def noise_like(points: Tensor, size: float, generator: torch.Generator) -> Tensor:
    """Displacements in random directions, of length uniform in [0, size] (Sec. 4.1); or Gaussian;
    or those of a depth camera (ours).

    The latter two have a standard deviation of size / 3 along each of their directions.
    """
    normal = torch.randn(points.shape, generator=generator)
    kind = _uniform(0, 3, generator)
    if kind < 1:
        return normal * (size / 3)
    if kind < 2:
        return depth_noise(points, generator) * (size / 3)
    length = torch.rand(len(points), 1, generator=generator) * size
    return torch.nn.functional.normalize(normal, dim=-1) * length


def depth_noise(points: Tensor, generator: torch.Generator) -> Tensor:
    """Displacements along one random direction, whose standard deviation is 1 (ours).

    Part of them, a random share, is alike among neighbours, in patches of a random size.

    Args:
        points: (N, 3) within a distance of 2 from the origin.
    """
    camera, share = rotation(1, generator), _uniform(0, 1, generator)
    pixels = 4 / _uniform(*PATCH, generator)
    image = torch.randn(1, 1, *[math.ceil(pixels)] * 2, generator=generator)
    at = (points @ camera[:2].T / 2)[None, None]
    alike = torch.nn.functional.grid_sample(image, at, "bicubic", "border", align_corners=False)
    alike = alike.flatten() / alike.square().mean().sqrt()
    alone = torch.randn(len(points), generator=generator)
    return (share**0.5 * alike + (1 - share) ** 0.5 * alone)[:, None] * camera[2]


def cut_open(cloud: Tensor, queries: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Removes holes, all beyond a plane, or what a camera would not see (ours).

    Returns:
        The rows of the cloud, (N, 3) or more, that stay, and which `queries` (..., 3) lie where
        something stayed.
    """
    points, flat = cloud[:, :3], queries.flatten(0, -2)
    if _chance(0.5, generator):
        centre = points[torch.randint(len(points), (4,), generator=generator)]
        radius = _uniform(0.05, 0.25, generator)
        keep, kept = (torch.cdist(x, centre).amin(-1) > radius for x in (points, flat))
    elif _chance(0.5, generator):
        normal = torch.nn.functional.normalize(torch.randn(3, generator=generator), dim=0)
        level = torch.quantile(points @ normal, _uniform(0, 0.5, generator))
        keep, kept = points @ normal > level, flat @ normal > level
    else:
        keep, kept = seen(points, flat, rotation(1, generator))
    if int(keep.sum()) < 1000:
        return cloud, torch.ones(queries.shape[:-1], dtype=torch.bool)
    return cloud[keep], kept.view(queries.shape[:-1])


def seen(
    points: Tensor, queries: Tensor, camera: Tensor, cell: float = 0.03, slack: float = 0.12
) -> tuple[Tensor, Tensor]:
    """Which points and queries an orthographic camera sees, (N,) and (M,) bool (ours).

    A point is seen unless one is more than `slack` nearer within the 3 x 3 cells around it.

    Args:
        points, queries: (N, 3) and (M, 3) within a distance of 2 from the origin.
        camera: (3, 3) rotation; its last row points at the camera.
        cell: side of a pixel, about the spacing of the points.
        slack: depth of the layer that counts as the surface; with slack = 4 cells the surface is
            seen at up to about 60 degrees from the direction of view.
    """
    size = math.ceil(4 / cell)

    def pixel(x: Tensor) -> Tensor:
        row, column = ((x @ camera[:2].T + 2) / cell).long().clamp(0, size - 1).unbind(-1)
        return row * size + column

    height = points @ camera[2]
    top = torch.full((size * size,), -4.0).scatter_reduce(0, pixel(points), height, "amax")
    top = torch.nn.functional.max_pool2d(top.view(1, 1, size, size), 3, 1, 1).flatten()
    return height > top[pixel(points)] - slack, queries @ camera[2] > top[pixel(queries)] - slack


def half_way(v: Tensor, q: Tensor) -> Tensor:
    """About the middle of each geodesic, (S, K, 3): the q_j whose v_j is nearest to v_i / 2 (ours).

    A quarter of the vectors are candidates, so that this stays cheap.
    """
    few = slice(None, None, 4)
    nearest = torch.cdist(v / 2, v[:, few]).argmin(-1, keepdim=True)  # (S, K, 1)
    return q[:, few].gather(1, nearest.expand_as(q))


def rotation(freely: float, generator: torch.Generator) -> Tensor:
    """(3, 3) rotation: uniform with that probability, else of the cube's group, slightly tilted."""
    if _chance(freely, generator):
        return _orthogonal(torch.randn(3, 3, generator=generator))
    turned = torch.eye(3)[torch.randperm(3, generator=generator)]
    flips = torch.randint(0, 2, (3,), generator=generator) * 2.0 - 1
    tilt = torch.eye(3) + 0.05 * torch.randn(3, 3, generator=generator)
    return _orthogonal(tilt) @ _proper(turned * flips)


def _orthogonal(m: Tensor) -> Tensor:
    q, r = torch.linalg.qr(m)
    return _proper(q * r.diagonal().sign())


def _proper(m: Tensor) -> Tensor:
    return m * torch.tensor([1.0, 1.0, float(torch.linalg.det(m).sign())])


def _chance(probability: float, generator: torch.Generator) -> bool:
    return float(torch.rand((), generator=generator)) < probability


def _uniform(low: float, high: float, generator: torch.Generator) -> float:
    return low + (high - low) * float(torch.rand((), generator=generator))
