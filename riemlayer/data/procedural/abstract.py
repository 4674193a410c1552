"""Abstract solids: random constructive geometry, extruded outlines, sheets, knots, terrain, frames."""

import numpy as np
from manifold3d import CrossSection, Manifold

from riemlayer.data.procedural.sculpture import Sculpture
from riemlayer.data.procedural.solids import (
    Rng,
    any_box,
    ball,
    chance,
    cut,
    extrude,
    from_arrays,
    move,
    pick,
    revolve,
    rod,
    segments,
    smooth_curve,
    strut,
    tube,
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
        part = Manifold.hull_points(rng.normal(size=(int(rng.integers(5, 14)), 3)) * size * 0.7)
    elif style == "torus":
        t = np.arange(16) * np.pi / 8
        ring = np.c_[0.55 + 0.18 * np.cos(t), 0.18 * np.sin(t) * rng.uniform(0.6, 2)]
        part = revolve(ring, max(n, 12))
    else:
        part = extrude(star(rng), size[2])
    return part.rotate(tuple(rng.uniform(0, 360, 3))) if chance(rng, 0.5) else part


def star(rng: Rng) -> np.ndarray:
    """A star-shaped polygon (n, 2): gear, star, blob, regular or irregular."""
    k = int(rng.integers(3, 14))
    style = pick(rng, "regular", "star", "gear", "blob", "rough")
    if style == "gear":
        k = int(rng.integers(6, 16))
        radius = np.tile([1, 1, rng.uniform(0.65, 0.88)], k)
        radius = np.repeat(np.tile([1.0, rng.uniform(0.65, 0.88)], k), 2)
        angle = (np.repeat(np.arange(2 * k), 2) + np.tile([-0.38, 0.38], 2 * k)) * np.pi / k
    elif style == "blob":
        angle = np.arange(48) * 2 * np.pi / 48
        a, p = rng.normal(0, 0.12, 4), rng.uniform(0, 6.3, 4)
        radius = 1 + (a[:, None] * np.cos(np.arange(2, 6)[:, None] * angle + p[:, None])).sum(0)
        radius = np.maximum(radius, 0.3)
    else:
        k = 2 * k if style == "star" else k
        angle = np.arange(k) * 2 * np.pi / k
        radius = np.ones(k)
        if style == "star":
            radius[1::2] = rng.uniform(0.35, 0.8)
        elif style == "rough":
            radius = rng.uniform(0.4, 1, k)
    return 0.8 * radius[:, None] * np.c_[np.cos(angle), np.sin(angle)]


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


def letter(rng: Rng) -> CrossSection:
    """Strokes on a small grid of nodes, joined: letters, runes, pipes in a plane."""
    nodes = np.stack(np.meshgrid([-0.6, 0, 0.6], [-0.9, 0, 0.9]), -1).reshape(-1, 2)
    width = rng.uniform(0.1, 0.28)
    at = int(rng.integers(9))
    section = CrossSection()
    for _ in range(rng.integers(2, 8)):
        to = int(rng.integers(9))
        if to != at:
            a, b = nodes[at], nodes[to]
            side = np.array([-(b - a)[1], (b - a)[0]]) / np.linalg.norm(b - a) * width / 2
            along = (b - a) / np.linalg.norm(b - a) * width / 2
            corners = [a - along - side, b + along - side, b + along + side, a - along + side]
            section += CrossSection([np.array(corners)])
            at = to
    return section if not section.is_empty() else CrossSection.square((1, 0.3), True)


def profile(rng: Rng) -> CrossSection:
    """Structural sections: I, L, T, U, C, hollow box, hollow tube."""
    w, h, t = rng.uniform(0.5, 1.2), rng.uniform(0.5, 1.2), rng.uniform(0.06, 0.16)

    def bar(a, b, x, y):
        return CrossSection.square((a, b), True).translate((x, y))

    style = pick(rng, "I", "L", "T", "U", "box", "tube", "E")
    base, post = bar(w, t, 0, -h / 2), bar(t, h + t, 0, 0)
    if style == "tube":
        return CrossSection.circle(w / 2, 40) - CrossSection.circle(w / 2 - t, 40)
    if style == "box":
        return bar(w, h, 0, 0) - bar(w - 2 * t, h - 2 * t, 0, 0)
    if style == "T":
        return base + post
    if style == "I":
        return base + post + bar(w, t, 0, h / 2)
    left = bar(t, h + t, -(w - t) / 2, 0)
    if style == "L":
        return base + left
    if style == "U":
        return base + left + bar(t, h * rng.uniform(0.4, 1), (w - t) / 2, 0)
    return base + left + bar(w, t, 0, h / 2) + bar(w * 0.8, t, -0.1 * w, 0)


def height_field(rng: Rng, n: int = 56) -> tuple[np.ndarray, np.ndarray]:
    """A grid (n, n, 2) in the plane and smooth random heights (n, n)."""
    axis = np.linspace(-1, 1, n)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    z = np.zeros_like(x)
    for _ in range(rng.integers(1, 9)):
        k = rng.normal(size=2) * rng.uniform(0.6, 4)
        z += np.sin(k[0] * x + k[1] * y + rng.uniform(0, 6.3)) / (0.6 + np.linalg.norm(k))
    if chance(rng, 0.3):
        z = np.abs(z) if chance(rng, 0.5) else np.tanh(z * rng.uniform(2, 6))
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
    thick = rng.uniform(0.035, 0.09)
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
        waves = rng.normal(size=(3, 3, 2)) / np.arange(1, 4)[None, :, None]
        k = np.arange(1, 4)[:, None] * t
        path = np.einsum("akc,ckn->na", waves, np.stack([np.cos(k), np.sin(k)]))
        return [tube(path, rng.uniform(0.08, 0.2), sides, True)]
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


def wireframe(rng: Rng) -> Parts:
    """A frame of struts: edges of a random polyhedron, a box lattice, or a truss."""
    style = pick(rng, "hull", "lattice", "truss")
    r = rng.uniform(0.035, 0.08)
    if style == "hull":
        points = rng.normal(size=(int(rng.integers(5, 11)), 3))
        points /= np.linalg.norm(points, axis=1, keepdims=True) * rng.uniform(0.8, 1.2)
        faces = np.asarray(Manifold.hull_points(points).to_mesh64().tri_verts, int)
        points = np.asarray(Manifold.hull_points(points).to_mesh64().vert_properties)
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


def blob(rng: Rng) -> Sculpture:
    """Metaballs or a noise-displaced ellipsoid, sometimes with bites and tunnels."""
    clay = Sculpture(rng.uniform(0.03, 0.35))
    if chance(rng, 0.35):
        clay.ball((0, 0, 0), rng.uniform(0.5, 1.0, 3))
        clay.roughen(rng, rng.uniform(0.03, 0.14), rng.uniform(0.35, 1.4))
    else:
        at = np.zeros(3)
        for _ in range(rng.integers(2, 14)):
            clay.ball(at, rng.uniform(0.15, 0.5, 3), rotation=_turn(rng))
            at = at + rng.normal(0, 0.3, 3)
            if chance(rng, 0.2):
                at = np.zeros(3)
        if chance(rng, 0.3):
            clay.roughen(rng, 0.03, rng.uniform(0.2, 0.6))
    for _ in range(rng.integers(0, 3)):
        a, b = rng.normal(0, 0.5, 3), rng.normal(0, 0.5, 3)
        r = rng.uniform(0.08, 0.25)
        clay.cone(a, b, r, r, removes=True, blend=0.06)
    return clay


def _turn(rng: Rng) -> np.ndarray:
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def branches(rng: Rng) -> Parts:
    """A tree, coral or pipe network of branching smooth tubes."""
    parts: Parts = []
    spread, shrink = rng.uniform(0.5, 1.1), rng.uniform(0.6, 0.85)

    def grow(start: np.ndarray, direction: np.ndarray, length: float, r: float, depth: int) -> None:
        bend = direction + rng.normal(0, 0.3, 3)
        end = start + length * bend / np.linalg.norm(bend)
        middle = start + 0.5 * length * direction + rng.normal(0, 0.06, 3) * length
        parts.append(
            tube(smooth_curve([start, middle, end], 14), np.linspace(r, r * shrink, 14), 9)
        )
        parts.append(ball(r * shrink, end, 10))
        if depth == 0:
            if chance(rng, 0.15):
                parts.append(ball(rng.uniform(0.1, 0.3, 3), end, 12))
            return
        for _ in range(rng.integers(1, 4)):
            turn = bend / np.linalg.norm(bend) + rng.normal(0, spread, 3)
            grow(
                end,
                turn / np.linalg.norm(turn),
                length * rng.uniform(0.6, 0.95),
                max(r * shrink, 0.055),
                depth - 1,
            )

    grow(np.zeros(3), np.array([0, 0, 1.0]), 0.8, rng.uniform(0.08, 0.16), int(rng.integers(2, 4)))
    if chance(rng, 0.5):
        pot = rng.uniform(0.3, 0.6)
        parts.append(rod(pot, pot, (0, 0, -pot * 0.3), top=pot * 1.2, sides=segments(rng)))
    return parts


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
