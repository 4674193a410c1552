"""Two procedural domains that the packaged weights were not trained on, to fine-tune to."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from riemlayer.data.procedural.sheets import slab

Array = np.ndarray
GRID = 72
"""Samples along the longest side of a vessel tree's distance grid."""


def vessel_tree(rng: np.random.Generator) -> tuple[Array, Array]:
    """A branching tree of blood vessels that taper and merge smoothly: (n, 3), (m, 3).

    Radii follow Murray's law, r^3 = r_1^3 + r_2^3, at every fork.
    """
    from skimage.measure import marching_cubes

    capsules: list[tuple[Array, Array, float, float]] = []

    def grow(start: Array, direction: Array, length: float, radius: float, left: int) -> None:
        bend = 0.35 * rng.normal(size=3)
        for _ in range(3):
            direction = direction + bend / 3
            direction = direction / np.linalg.norm(direction)
            end, thinner = start + direction * length / 3, radius * 0.96
            capsules.append((start, end, radius, thinner))
            start, radius = end, thinner
        if not left:
            return
        share = rng.uniform(0.3, 0.5)
        side = np.cross(direction, rng.normal(size=3))
        side /= np.linalg.norm(side)
        for part, sign in ((share, 1.0), (1 - share, -1.0)):
            turned = direction + sign * (1 - part) * rng.uniform(1.0, 1.6) * side
            grow(start, turned, length * rng.uniform(0.7, 0.95), radius * part ** (1 / 3), left - 1)

    grow(np.zeros(3), np.array([0.0, 0, 1]), 0.7, rng.uniform(0.11, 0.16), int(rng.integers(2, 4)))
    ends = np.concatenate([[a, b] for a, b, _, _ in capsules])
    low, high = ends.min(0) - 0.3, ends.max(0) + 0.3
    step = (high - low).max() / GRID
    axes = [np.arange(a, b, step) for a, b in zip(low, high, strict=True)]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    away = np.stack([_to_capsule(x, *capsule) for capsule in capsules])
    joined = -0.01 * np.log(np.exp(-away / 0.01).sum(0) + 1e-30)
    vertices, faces, _, _ = marching_cubes(joined, 0.0, spacing=(step,) * 3)
    return vertices + low, faces


def _to_capsule(x: Array, a: Array, b: Array, ra: float, rb: float) -> Array:
    along = ((x - a) @ (b - a) / ((b - a) @ (b - a))).clip(0, 1)
    return np.linalg.norm(x - a - along[..., None] * (b - a), axis=-1) - (ra + along * (rb - ra))


def landscape(rng: np.random.Generator) -> tuple[Array, Array]:
    """Eroded fractal terrain on a slab, with ridges and terraces: (n, 3), (m, 3)."""
    n = 96
    frequency = np.fft.fftfreq(n)
    k = np.hypot(*np.meshgrid(frequency, frequency))
    k[0, 0] = math.inf
    noise = np.fft.fft2(rng.normal(size=(n, n))) * k ** -rng.uniform(1.7, 2.3)
    noise[k > 0.2] = 0
    z = np.fft.ifft2(noise).real
    z = z / np.abs(z).max()
    ridged, terraces = rng.uniform(0, 1), rng.integers(3, 7)
    z = (1 - ridged) * z + ridged * (0.5 - np.abs(z))
    if rng.random() < 0.4:
        z = z + 0.6 * np.sin(2 * math.pi * terraces * z) / (2 * math.pi * terraces)
    axis = np.linspace(-1, 1, n)
    plane = np.stack(np.meshgrid(axis, axis, indexing="ij"), -1)
    z = z * rng.uniform(0.25, 0.5)
    floor = np.full_like(z, z.min() - 0.25)
    solid = slab(np.dstack((plane, z)), np.dstack((plane, floor))).to_mesh()
    return np.asarray(solid.vert_properties[:, :3], float), np.asarray(solid.tri_verts, np.int64)


DOMAINS: dict[str, Callable[[np.random.Generator], tuple[Array, Array]]] = {
    "vessels": vessel_tree,
    "landscapes": landscape,
}


def write_domain(name: str, count: int, folder: str | Path, seed: int = 0) -> list[Path]:
    """Writes `count` meshes of a domain as `folder/<name>-<seed>.ply` (ours).

    Args:
        name: one of `DOMAINS`.
        count: how many; each depends on its own seed alone. Files that are there stay.
        folder: made where missing.
        seed: of the first.

    Raises:
        ValueError: an unknown name.
    """
    import trimesh

    if name not in DOMAINS:
        raise ValueError(f"name must be one of {', '.join(DOMAINS)}, got {name!r}")
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{name}-{s:05d}.ply" for s in range(seed, seed + count)]
    for s, path in enumerate(paths, seed):
        if not path.exists():
            vertices, faces = DOMAINS[name](np.random.default_rng(s))
            trimesh.Trimesh(vertices, faces, process=False).export(path)
    return paths
