"""Log maps along given edges of a shape, by the field and by its rivals."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from benchmarks.labelled import Labelled
from riemlayer import ExpLogField
from riemlayer.data.manifold import vertex_normals
from riemlayer.ops import orient

Array = np.ndarray


class Logs(NamedTuple):
    """Log_receiver(neighbour) along the edges of a shape."""

    vector: Tensor
    """(E, 3) ambient."""
    valid: Tensor
    """(E,) bool: the method stands by it."""


Method = Callable[[Labelled, Tensor], Logs]
"""Of a shape and its edges (2, E)."""
Normals = Callable[[Labelled], Tensor]
"""(N, 3) of a shape."""


@torch.inference_mode()
def by_field(shape: Labelled, edges: Tensor, field: ExpLogField, confirmed: bool = False) -> Logs:
    """The field; `confirmed`: Exp has to come back to the neighbour."""
    points = torch.from_numpy(shape.vertices).float()
    surface = field.encode(points)
    sender, receiver = edges
    count = receiver.bincount(minlength=len(points))
    place = torch.arange(len(receiver)) - (count.cumsum(0) - count)[receiver]
    near = torch.arange(len(points))[:, None].repeat(1, int(count.max()))
    near[receiver, place] = sender  # one row of queries a source; filled up with itself
    v, logit = surface.decode_log(points[:, None], points[near])
    valid = logit > 0
    if confirmed:
        valid &= surface.comes_back(points[:, None], points[near], v)
    return Logs(v[receiver, place], valid[receiver, place])


def by_projection(shape: Labelled, edges: Tensor, k: int = 16, chord: bool = False) -> Logs:
    """(I - n n^T)(q - p) with PCA normals of k points; `chord`: stretched to |q - p|."""
    points = torch.from_numpy(shape.vertices)
    sender, receiver = edges
    offset, n = points[sender] - points[receiver], pca(points, k)[0][receiver]
    v = offset - (offset * n).sum(-1, keepdim=True) * n
    if chord:
        v = v * offset.norm(dim=-1, keepdim=True) / v.norm(dim=-1, keepdim=True).clamp_min(1e-9)
    return Logs(v.float(), torch.ones(len(v), dtype=torch.bool))


def on_one_side(shape: Labelled, edges: Tensor, method: Method, normals: Normals) -> Logs:
    """A method's logs, where normals of both ends differ by less than a right angle."""
    normal = normals(shape)
    sender, receiver = edges
    vector, valid = method(shape, edges)
    return Logs(vector, valid & ((normal[sender] * normal[receiver]).sum(-1) > 0))


def cloud_normals(shape: Labelled, k: int = 16) -> Tensor:
    """(N, 3) PCA normals of k points, turned to agree between near points."""
    points = torch.from_numpy(shape.vertices)
    normal, near = pca(points, k)
    return orient(normal, points, near, torch.zeros(len(points), dtype=torch.long))


def mesh_normals(shape: Labelled) -> Tensor:
    """(N, 3) outward."""
    return torch.from_numpy(vertex_normals(shape.vertices, shape.faces))


def at_random(shape: Labelled, edges: Tensor, method: Method) -> Logs:
    """The control: a method's edges and lengths, in directions that say nothing."""
    normal = pca(torch.from_numpy(shape.vertices), 16)[0][edges[1]].float()
    vector, valid = method(shape, edges)
    angle = 2 * torch.pi * torch.rand(len(vector), 1, generator=torch.Generator().manual_seed(0))
    return Logs(angle.cos() * vector + angle.sin() * torch.linalg.cross(normal, vector), valid)


def pca(points: Tensor, k: int) -> tuple[Tensor, Tensor]:
    """Normals (N, 3) without a sign, and the k nearest points (N, k) that they were fitted to."""
    from scipy.spatial import KDTree

    x = points.double().numpy()
    near = torch.from_numpy(KDTree(x).query(x, k=min(k, len(x)))[1])
    offset = points[near] - points[near].mean(1, keepdim=True)
    return torch.linalg.eigh(offset.mT @ offset)[1][..., 0], near


def by_cloud_heat(shape: Labelled, edges: Tensor, t_coef: float = 1.0) -> Logs:
    """`PointCloudHeatSolver` of potpourri3d: one solve a source."""
    import potpourri3d

    solver = potpourri3d.PointCloudHeatSolver(shape.vertices, t_coef)
    return _by_solver(solver.compute_log_map, solver.get_tangent_frames(), edges)


def by_mesh_heat(shape: Labelled, edges: Tensor, strategy: str = "AffineLocal") -> Logs:
    """`MeshVectorHeatSolver` of potpourri3d on the mesh: one solve a source."""
    import potpourri3d

    solver = potpourri3d.MeshVectorHeatSolver(shape.vertices, shape.faces)

    def solve(source: int) -> Array:
        return solver.compute_log_map(source, strategy)

    return _by_solver(solve, solver.get_tangent_frames(), edges)


def _by_solver(solve: Callable[[int], Array], frames: tuple, edges: Tensor) -> Logs:
    sender, receiver = edges.numpy()
    ends = np.searchsorted(receiver, np.arange(receiver.max() + 2))
    out = np.zeros((len(sender), 3))
    for i in np.unique(receiver):
        own = slice(ends[i], ends[i + 1])
        out[own] = np.asarray(solve(int(i)))[sender[own]] @ np.stack([frames[0][i], frames[1][i]])
    vector = torch.from_numpy(out)
    known = vector.isfinite().all(-1)
    return Logs(torch.where(known[:, None], vector, 0).float(), known)


class Settings(NamedTuple):
    """What rivals are set to."""

    k: int = 16
    """Points of the PCA plane."""
    chord: bool = True
    """Projections are stretched to the length of the chord."""
    t_coef: float = 1.0
    """Diffusion time of the heat on the cloud, in squared mean edge lengths."""

    def methods(self, field: ExpLogField) -> dict[str, Method]:
        """Every row of the table."""
        confirmed = partial(by_field, field=field, confirmed=True)
        projection = partial(by_projection, k=self.k, chord=self.chord)
        heat = partial(by_cloud_heat, t_coef=self.t_coef)
        one_side = partial(on_one_side, normals=partial(cloud_normals, k=self.k))
        return {
            "projection": projection,
            "projection, normals within 90°": partial(one_side, method=projection),
            "projection, the mesh's normals within 90°": partial(
                on_one_side, method=projection, normals=mesh_normals
            ),
            "riemlayer": partial(by_field, field=field),
            "riemlayer, Exp comes back": confirmed,
            "riemlayer, Exp comes back, normals within 90°": partial(one_side, method=confirmed),
            "MeshVectorHeatSolver, AffineLocal": by_mesh_heat,
            "control: projection in directions at random": partial(at_random, method=projection),
            "PointCloudHeatSolver": heat,
            "PointCloudHeatSolver, normals within 90°": partial(one_side, method=heat),
        }


def tuned(examples: list[tuple[Labelled, Tensor]], radius: float) -> Settings:
    """Settings with the least mean distance to the mesh's logs, where those are within reach."""
    truth = [by_mesh_heat(*example).vector for example in examples]

    def error(method: Method) -> float:
        return sum(
            float((method(*example).vector - v).norm(dim=-1)[v.norm(dim=-1) < radius].mean())
            for example, v in zip(examples, truth, strict=True)
        )

    planes = [(k, chord) for k in (6, 8, 12, 16, 24) for chord in (False, True)]
    k, chord = min(planes, key=lambda x: error(partial(by_projection, k=x[0], chord=x[1])))
    times = (0.1, 0.25, 0.5, 1.0)
    return Settings(k, chord, min(times, key=lambda t: error(partial(by_cloud_heat, t_coef=t))))
