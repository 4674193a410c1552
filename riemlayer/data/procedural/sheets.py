"""Curved and thin things: landscapes, plates with holes, tubes along knots and springs."""

import numpy as np
from manifold3d import CrossSection, Manifold

from riemlayer.data.procedural.abstract import primitive
from riemlayer.data.procedural.outlines import letter, star
from riemlayer.data.procedural.solids import (
    Rng,
    any_box,
    chance,
    extrude,
    from_arrays,
    move,
    pick,
    rod,
    segments,
    thin,
    tube,
)

Parts = list[Manifold]


def height_field(rng: Rng, n: int = 56) -> tuple[np.ndarray, np.ndarray]:
    """A grid (n, n, 2) in the plane and smooth random heights (n, n)."""
    axis = np.linspace(-1, 1, n)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    z = np.zeros_like(x)
    for _ in range(rng.integers(1, 9)):
        k = rng.normal(size=2) * rng.uniform(0.6, 4)
        z += np.sin(k[0] * x + k[1] * y + rng.uniform(0, 6.3)) / (0.6 + np.linalg.norm(k))
    if chance(rng, 0.3):
        z = np.abs(z) if chance(rng, 0.5) else np.tanh(z * rng.uniform(1.5, 4))
    return np.stack([x, y], -1), z * rng.uniform(0.1, 0.45)


def slab(top: np.ndarray, bottom: np.ndarray) -> Manifold:
    """The closed solid between two grids of points (n, m, 3) with common connectivity."""
    n, m = top.shape[:2]
    index = np.arange(n * m).reshape(n, m)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    up = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
    rim = np.concatenate([index[:-1, 0], index[-1, :-1], index[:0:-1, -1], index[0, :0:-1]])
    after = np.roll(rim, -1)
    side = np.concatenate(
        [np.stack([rim, rim + n * m, after], -1), np.stack([after, rim + n * m, after + n * m], -1)]
    )
    faces = np.concatenate([up, up[:, ::-1] + n * m, side])
    return from_arrays(np.concatenate([top.reshape(-1, 3), bottom.reshape(-1, 3)]), faces)


def terrain(rng: Rng) -> Parts:
    """A thick patch of landscape with a flat bottom, sometimes with blocks on it."""
    plane, z = height_field(rng)
    top = np.concatenate([plane, z[..., None]], -1)
    bottom = np.concatenate(
        [plane, np.full_like(z, z.min() - rng.uniform(0.05, 0.4))[..., None]], -1
    )
    parts = [slab(top, bottom)]
    for _ in range(rng.integers(0, 5)):
        i, j = rng.integers(5, 50, 2)
        parts.append(move(primitive(rng).scale((0.25, 0.25, 0.25)), *top[i, j]))
    return parts


def sheet(rng: Rng) -> Parts:
    """A thin plate, flat, folded or curved, with holes."""
    thick = thin(rng, 0.018, 0.09)
    if chance(rng, 0.45):
        plane, z = height_field(rng, 48)
        plane = plane * (1, rng.uniform(0.4, 1))
        middle = np.concatenate([plane, z[..., None]], -1)
        tangents = np.gradient(middle, axis=(0, 1))
        normal = np.cross(tangents[0], tangents[1])
        normal *= 0.5 * thick / np.linalg.norm(normal, axis=-1, keepdims=True)
        solid = slab(middle + normal, middle - normal)
    else:
        section = CrossSection([star(rng)]) if chance(rng, 0.4) else letter(rng) + letter(rng)
        if chance(rng, 0.4):
            section = CrossSection.square(tuple(rng.uniform(0.6, 2, 2)), True)
        solid = extrude(section, thick)
        if chance(rng, 0.3):
            wing = extrude(CrossSection.square(tuple(rng.uniform(0.5, 1.5, 2))), thick)
            solid += wing.rotate((0, rng.uniform(-110, -40), 0))
    low, high = np.reshape(solid.bounding_box(), (2, 3))
    for _ in range(rng.integers(0, 7)):
        at = low + rng.random(3) * (high - low)
        size = rng.uniform(0.06, 0.25)
        hole = (
            rod(size, 3, sides=segments(rng))
            if chance(rng, 0.6)
            else any_box(rng, (size, 2 * size, 3))
        )
        bitten = solid - move(hole, at[0], at[1], 0)
        if len(bitten.decompose()) == 1 and bitten.volume() > 0.5 * solid.volume():
            solid = bitten
    return [solid]


def room(path: np.ndarray) -> float:
    """The largest radius of a tube about a closed curve (n, 3) that does not touch itself.

    The smaller of the radius of curvature and half the distance between strands.
    """
    n = len(path)
    steps = np.abs(np.arange(n)[:, None] - np.arange(n))
    far = np.minimum(steps, n - steps) > n // 10
    gap = np.linalg.norm(path[:, None] - path, axis=-1)
    before, after = np.roll(path, 1, 0), np.roll(path, -1, 0)
    first, second = (after - before) / 2, after + before - 2 * path
    turn = np.linalg.norm(np.cross(first, second), axis=1)
    radius = np.linalg.norm(first, axis=1) ** 3 / np.maximum(turn, 1e-9)
    return float(min(gap[far].min() / 2, radius.min()))


def knot(rng: Rng) -> Parts:
    """A torus knot, a closed random curve, a spring or a chain link as a tube."""
    t = np.linspace(0, 2 * np.pi, 220, endpoint=False)
    style = pick(rng, "torus", "random", "spring", "link")
    sides = int(rng.integers(5, 20))
    flat = rng.uniform(0.5, 1) if chance(rng, 0.4) else 1.0
    if style == "torus":
        p, q = pick(rng, (2, 3), (3, 2), (2, 5), (3, 4), (1, 4), (1, 2))
        r = 1 + 0.42 * np.cos(q * t)
        path = np.stack([r * np.cos(p * t), r * np.sin(p * t), 0.42 * np.sin(q * t)], 1)
        return [tube(path, rng.uniform(0.06, 0.19), sides, True, flat)]
    if style == "random":
        k = np.arange(1, 4)[:, None] * t
        path, free = np.zeros((220, 3)), 0.0
        while free < 0.05:
            waves = rng.normal(size=(3, 3, 2)) / np.arange(1, 4)[None, :, None]
            path = np.einsum("akc,ckn->na", waves, np.stack([np.cos(k), np.sin(k)]))
            free = room(path)
        return [tube(path, min(rng.uniform(0.08, 0.25), 0.85 * free), sides, True)]
    if style == "spring":
        turns, height = rng.uniform(2, 5), rng.uniform(1, 3)
        s = np.linspace(0, 1, 260)
        angle = 2 * np.pi * turns * s
        wide = 0.6 + rng.uniform(-0.3, 0.3) * s
        path = np.stack([wide * np.cos(angle), wide * np.sin(angle), height * s], 1)
        return [tube(path, min(0.12, 0.35 * height / turns), sides)]
    corner = rng.uniform(0.4, 1, 2)
    path = np.c_[np.cos(t) * np.abs(np.cos(t)) ** -0.4, np.sin(t), 0.2 * np.sin(2 * t)]
    return [tube(path * (*corner, 1), rng.uniform(0.08, 0.2), sides, True, flat)]
