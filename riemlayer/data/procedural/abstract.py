"""Abstract solids: random constructive geometry, machined parts, extruded outlines, wire frames."""

import numpy as np
from manifold3d import CrossSection, Manifold

from riemlayer.data.procedural.outlines import letter, profile, star
from riemlayer.data.procedural.solids import (
    Rng,
    any_box,
    ball,
    chance,
    convex,
    cut,
    extrude,
    move,
    pick,
    revolve,
    rod,
    segments,
    strut,
    union,
)

Parts = list[Manifold]


def primitive(rng: Rng) -> Manifold:
    """A convex or round primitive of size about one, freely turned or axis-aligned."""
    size, n = rng.uniform(0.25, 1.0, 3), segments(rng)
    style = pick(rng, "box", "box", "rod", "cone", "ball", "wedge", "torus", "prism", "slab")
    if style in ("box", "slab"):
        size[2] *= 0.2 if style == "slab" else 1
        part = any_box(rng, size * 1.4, edge=0.08)
    elif style in ("rod", "cone"):
        top = size[0] * (rng.uniform(0.1, 0.9) if style == "cone" else 1) / 1.5
        part = rod(size[0] / 1.5, size[2] * 2, top=top, sides=n)
    elif style == "ball":
        part = ball(size * 0.8, sides=n)
    elif style == "wedge":
        part = convex(rng.normal(size=(int(rng.integers(5, 14)), 3)) * size * 0.7)
    elif style == "torus":
        t = np.arange(16) * np.pi / 8
        ring = np.c_[0.55 + 0.18 * np.cos(t), 0.18 * np.sin(t) * rng.uniform(0.6, 2)]
        part = revolve(ring, max(n, 12))
    else:
        part = extrude(star(rng), size[2])
    return part.rotate(tuple(rng.uniform(0, 360, 3))) if chance(rng, 0.5) else part


def csg(rng: Rng) -> Parts:
    """Unions and differences of random primitives."""
    solid = primitive(rng)
    for _ in range(rng.integers(2, 9)):
        low, high = np.reshape(solid.bounding_box(), (2, 3))
        at = low + rng.uniform(0.1, 0.9, 3) * (high - low)
        other = move(primitive(rng).scale((s := rng.uniform(0.4, 1.1), s, s)), *at)
        bitten = solid - other
        kept = bitten.volume() > 0.45 * solid.volume() and len(bitten.decompose()) == 1
        solid = bitten if chance(rng, 0.45) and kept else solid + other
    return [solid]


def extrusion(rng: Rng) -> Parts:
    """An extruded, tapered or twisted outline: letters, gears, stars, profiles, with holes."""
    style = pick(rng, "star", "letter", "profile")
    if style == "star":
        section = CrossSection([star(rng)])
        if chance(rng, 0.5):
            section -= CrossSection([star(rng) * rng.uniform(0.25, 0.5)])
    elif style == "letter":
        section = letter(rng)
    else:
        section = profile(rng)
    if chance(rng, 0.4):
        section = section.offset(r := rng.uniform(0.02, 0.08)).offset(-r)
    height = rng.uniform(0.08, 2.5)
    options: dict = {}
    if chance(rng, 0.35):
        options = {"n_divisions": 24, "twist_degrees": rng.uniform(-150, 150)}
    if chance(rng, 0.3):
        top = rng.uniform(0.4, 1.2, 2)
        options = {"n_divisions": 12, **options, "scale_top": tuple(top)}
    return [extrude(section, height, **options)]


def bracket(rng: Rng) -> Parts:
    """A machined part: plates and bosses with bores and pockets."""
    size = rng.uniform(0.3, 1.0, 3) * (1.6, 1.2, 0.4)
    parts, bores = [any_box(rng, size, edge=0.06)], []
    for _ in range(rng.integers(1, 5)):
        axis = pick(rng, "x", "y", "z")
        at = rng.uniform(-0.5, 0.5, 3) * size
        r, length, n = rng.uniform(0.12, 0.35), rng.uniform(0.3, 1.2), segments(rng)
        parts.append(rod(r, length, at, axis, sides=n))
        if chance(rng, 0.6):
            bores.append(rod(r * rng.uniform(0.4, 0.75), 3, at, axis, sides=n))
    if chance(rng, 0.5):
        bores.append(any_box(rng, size * rng.uniform(0.3, 0.7, 3), (0, 0, size[2] / 2)))
    return [cut(union(parts), bores)]


def wireframe(rng: Rng) -> Parts:
    """A frame of struts: edges of a random polyhedron, a box lattice, or a truss."""
    style = pick(rng, "hull", "lattice", "truss")
    r = rng.uniform(0.035, 0.08)
    if style == "hull":
        points = rng.normal(size=(int(rng.integers(5, 11)), 3))
        points /= np.linalg.norm(points, axis=1, keepdims=True) * rng.uniform(0.8, 1.2)
        faces = np.asarray(convex(points).to_mesh64().tri_verts, int)
        points = np.asarray(convex(points).to_mesh64().vert_properties)
        edges = np.unique(np.sort(np.concatenate([faces[:, :2], faces[:, 1:]]), 1), axis=0)
    else:
        counts = (
            rng.integers(1, 4, 3)
            if style == "lattice"
            else np.array([int(rng.integers(3, 7)), 1, 1])
        )
        grid = np.stack(np.meshgrid(*[np.arange(c + 1.0) for c in counts], indexing="ij"), -1)
        points = grid.reshape(-1, 3) * rng.uniform(0.5, 1, 3)
        r *= max(counts)
        gap = np.abs(grid.reshape(-1, 3)[:, None] - grid.reshape(-1, 3)[None])
        near = (gap.sum(-1) == 1) | ((gap.sum(-1) == 2) & (gap.max(-1) == 1) & (style == "truss"))
        edges = np.argwhere(np.triu(near))
        keep = (gap[edges[:, 0], edges[:, 1]].sum(-1) == 1) | (rng.random(len(edges)) < 0.3)
        edges = edges[keep]
    if chance(rng, 0.5):
        points = points + rng.normal(0, 0.05, points.shape)
    sides = int(rng.integers(5, 14))
    parts = [strut(points[a], points[b], r, sides=sides) for a, b in edges]
    if chance(rng, 0.3):
        parts += [ball(r * rng.uniform(1.3, 2), point, 14) for point in points]
    return parts
