"""The truth of both maps on a prepared mesh, and the clouds that methods are given of it."""

from __future__ import annotations

import numpy as np

from riemlayer.baselines import MeshHeat
from riemlayer.data.cut_locus import divergence
from riemlayer.data.ground_truth import RADIUS, trace
from riemlayer.data.manifold import vertex_normals
from riemlayer.tables.evaluate import tangent_frame

Array = np.ndarray
Arrays = dict[str, Array]
INPUTS = ("remeshed", "nonuniform", "noisy", "raw")
"""What a method is given (Sec. 4.1): the vertices of the remeshed shape; samples of it whose
density varies about 10:1; its vertices moved by up to `NOISE`; samples of the surface as it was
before it was made watertight, where it had to be."""
NOISE = 0.015
TRACED, KEPT = 2400, 400
"""Vectors a source that the filter sees, and that are kept."""
TAU, TAU_TIGHT = 0.5, 0.1
BLUE_NOISE = 30_000
"""Evenly spread samples that the uneven ones are drawn from."""


def ground_truth(vertices: Array, faces: Array, src: Array, vec: Array) -> Arrays:
    """Exp and Log of a mesh at some of its vertices, and where they can be relied on.

    Exp is traced (straightest geodesics). Log is the vector heat method's `AffineLocal`, which
    far from the source collapses to short vectors: `valid` asks for a short geodesic (fast
    marching) as well. The tight masks hold shortest geodesics alone: Eq. (8) with tau = 0.1, and
    |v| within 0.02 + 10 % of the fast-marching distance (at an end point, of that of the nearest
    vertex, and the way there on top).

    Args:
        vertices, faces: a manifold mesh (n, 3), (m, 3) in the cube.
        src: source vertices (P,).
        vec: tangent vectors (P, T, 3) of length up to `RADIUS`; the filter of appendix E looks at
            all of them together.

    Returns:
        "end" (P, T, 3), "ok", "ok_tight" (P, T), "log" (P, n, 3), "valid", "valid_tight" (P, n).

    Raises:
        ValueError: the truth is not finite.
    """
    from potpourri3d import MeshFastMarchingDistanceSolver
    from scipy.spatial import KDTree

    end, complete = trace(vertices, faces, src, vec)
    heat, marching = MeshHeat(), MeshFastMarchingDistanceSolver(vertices, faces)
    heat.prepare_mesh(vertices, faces)
    log = np.stack([heat.log(vertices[s], vertices) for s in src])
    far = np.stack([np.ravel(marching.compute_distance([[(int(s), [])]])) for s in src])  # (P, n)
    if not (np.isfinite(end).all() and np.isfinite(log).all() and np.isfinite(far).all()):
        raise ValueError("vertices, faces: a geodesic, log map or distance is not finite")
    delta = divergence(end, vec)
    ok = complete & (delta <= TAU)
    length, (gap, near) = np.linalg.norm(vec, axis=-1), KDTree(vertices).query(end)
    off = np.abs(length - far[np.arange(len(src))[:, None], near])
    reach = np.linalg.norm(log, axis=-1)
    spread = divergence(np.broadcast_to(vertices, log.shape), log)
    valid = (reach < RADIUS) & (far < 1.05 * RADIUS) & (spread <= TAU)
    shortest = np.abs(reach - far) <= 0.02 + 0.1 * far
    return {
        "end": end,
        "ok": ok,
        "ok_tight": ok & (delta <= TAU_TIGHT) & (off <= 0.02 + 0.1 * length + gap),
        "log": log,
        "valid": valid,
        "valid_tight": valid & (spread <= TAU_TIGHT) & shortest,
    }


def draw_queries(
    vertices: Array, faces: Array, sources: int, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Random source vertices (P,), their normals (P, 3) and `TRACED` vectors each (P, T, 3).

    The vectors are tangent and uniform by area in the disk of `RADIUS`.
    """
    if not 0 < sources <= len(vertices):
        raise ValueError(f"sources must lie between 1 and {len(vertices)} vertices, got {sources}")
    src = rng.choice(len(vertices), sources, replace=False)
    normal = vertex_normals(vertices, faces)[src]
    share, turn = rng.random((2, sources, TRACED, 1))
    flat = np.concatenate([np.cos(2 * np.pi * turn), np.sin(2 * np.pi * turn)], -1)
    frames = np.stack([tangent_frame(x) for x in normal])
    return src, normal, RADIUS * np.sqrt(share) * flat @ frames.transpose(0, 2, 1)


def shape_arrays(vertices: Array, faces: Array, sources: int, seed: int) -> Arrays:
    """All arrays of a prepared shape but its cloud, of one manifold mesh in the cube (ours).

    What is stored in float32 is what was traced and solved for. `log` is rounded to multiples of
    2^-15, of 2^-7 where it is longer than 0.75 and never counts, so that the file packs well.
    """
    vertices = vertices.astype(np.float32)
    mesh, rng = vertices.astype(float), np.random.default_rng(seed)
    src, normal, vec = draw_queries(mesh, faces, sources, rng)
    vec = vec.astype(np.float32)
    truth = ground_truth(mesh, faces, src, vec.astype(float))
    near = np.linalg.norm(truth["log"], axis=-1, keepdims=True) < 1.5 * RADIUS
    grid = np.where(near, 2.0**15, 2.0**7)
    return {
        "V": vertices,
        "F": faces.astype(np.int32),
        "src": src.astype(np.int32),
        "src_normal": normal.astype(np.float32),
        "vec": vec[:, :KEPT],
        "end": truth["end"][:, :KEPT].astype(np.float32),
        "log": (np.round(truth["log"] * grid) / grid).astype(np.float32),
        **{name: truth[name][:, :KEPT] for name in ("ok", "ok_tight")},
        **{name: truth[name] for name in ("valid", "valid_tight")},
    }


def cloud(name: str, vertices: Array, faces: Array, seed: int) -> Array:
    """The cloud (N, 3) float32 of an input of `INPUTS` other than "raw" (Sec. 4.1).

    Raises:
        ValueError: there is no such input.
    """
    if name == "remeshed":
        return vertices
    if name == "noisy":
        rng = np.random.default_rng(seed)
        direction = rng.normal(size=vertices.shape)
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        length = NOISE * rng.random((len(vertices), 1))
        return (vertices + length * direction).astype(np.float32)
    if name == "nonuniform":
        import torch

        from riemlayer.data import augment

        generator = torch.Generator().manual_seed(seed)
        mesh = torch.from_numpy(vertices), torch.from_numpy(faces)
        points = augment.sample_surface(*mesh, 3 * BLUE_NOISE, generator)
        points = augment.thin_out(points, BLUE_NOISE)
        return points[augment.uneven(points, generator)].numpy()
    raise ValueError(f"inputs must be among {', '.join(INPUTS)}, got {name!r}")
