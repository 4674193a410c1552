"""Exact solids with sharp edges (manifold3d): boxes, prisms, revolved profiles, swept tubes.

Solids are closed `Manifold`s; z is up. A list of them is a list of overlapping parts.
"""

from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np
from manifold3d import CrossSection, FillRule, Manifold, Mesh64, OpType
from numpy.typing import ArrayLike

Rng = np.random.Generator
AXES = {"x": (0.0, 90.0, 0.0), "y": (-90.0, 0.0, 0.0), "z": (0.0, 0.0, 0.0)}


def chance(rng: Rng, probability: float) -> bool:
    """True with the given probability (ours)."""
    return bool(rng.random() < probability)


def pick(rng: Rng, *options):
    """One of the options, all equally likely (ours)."""
    return options[int(rng.integers(len(options)))]


def thin(rng: Rng, low: float, high: float) -> float:
    """A thickness between two bounds, its logarithm uniform: real walls are mostly thin."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def segments(rng: Rng) -> int:
    """Number of sides of a round part: mostly smooth, sometimes low-poly as game assets are."""
    return int(rng.integers(24, 56)) if chance(rng, 0.8) else int(rng.integers(6, 13))


def union(parts: Sequence[Manifold]) -> Manifold:
    """The union of closed parts (ours)."""
    return parts[0] if len(parts) == 1 else Manifold.batch_boolean(list(parts), OpType.Add)


def cut(solid: Manifold, tools: Sequence[Manifold]) -> Manifold:
    """The solid without the tools (ours)."""
    return Manifold.batch_boolean([solid, *tools], OpType.Subtract) if len(tools) else solid


def move(solid: Manifold, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Manifold:
    """The solid shifted."""
    return solid.translate((float(x), float(y), float(z)))


def box(size: ArrayLike, centre: ArrayLike = (0, 0, 0)) -> Manifold:
    """An axis-aligned box with sharp edges, (3,) side lengths."""
    sides, middle = np.asarray(size, float), np.asarray(centre, float)
    return Manifold.cube(tuple(sides), True).translate(tuple(middle))


def convex(points: ArrayLike) -> Manifold:
    """The convex hull of points (n, 3)."""
    return Manifold.hull_points(cast(Any, np.asarray(points, float)))


def soft_box(size: ArrayLike, centre: ArrayLike = (0, 0, 0), radius: float = 0.05) -> Manifold:
    """A box with rounded edges: the hull of eight small spheres."""
    half = np.asarray(size, float) / 2
    radius = float(min(radius, 0.95 * half.min()))
    ball = np.asarray(Manifold.sphere(radius, 16).to_mesh64().vert_properties)
    corners = np.stack(np.meshgrid(*[(-1, 1)] * 3, indexing="ij"), -1).reshape(8, 3)
    points = (corners * (half - radius))[:, None] + ball[None]
    return convex(points.reshape(-1, 3)).translate(tuple(np.asarray(centre, float)))


def chamfered_box(size: ArrayLike, centre: ArrayLike = (0, 0, 0), edge: float = 0.05) -> Manifold:
    """A box whose edges are cut flat."""
    half = np.asarray(size, float) / 2
    edge = float(min(edge, 0.9 * half.min()))
    corners = np.stack(np.meshgrid(*[(-1, 1)] * 3, indexing="ij"), -1).reshape(8, 3)
    points = [corners * (half - edge * (1 - np.eye(3)[axis])) for axis in range(3)]
    return convex(np.concatenate(points)).translate(tuple(np.asarray(centre, float)))


def any_box(rng: Rng, size: ArrayLike, centre: ArrayLike = (0, 0, 0), edge: float = 0.04):
    """A box with sharp, cut or round edges, at random."""
    style = rng.random()
    if style < 0.5:
        return box(size, centre)
    return (soft_box if style < 0.8 else chamfered_box)(size, centre, edge)


def rod(
    radius: float,
    length: float,
    centre: ArrayLike = (0, 0, 0),
    axis: str = "z",
    top: float | None = None,
    sides: int = 32,
) -> Manifold:
    """A cylinder or cone frustum about an axis, centred; `top` is the radius at its far end."""
    solid = Manifold.cylinder(length, radius, radius if top is None else top, sides, True)
    return solid.rotate(AXES[axis]).translate(tuple(np.asarray(centre, float)))


def ball(radii: ArrayLike, centre: ArrayLike = (0, 0, 0), sides: int = 32) -> Manifold:
    """An ellipsoid."""
    scale = np.broadcast_to(np.asarray(radii, float), 3)
    return (
        Manifold.sphere(1.0, sides).scale(tuple(scale)).translate(tuple(np.asarray(centre, float)))
    )


def revolve(profile: ArrayLike, sides: int = 40) -> Manifold:
    """The solid of revolution about z of a closed polygon (n, 2) of (radius, height)."""
    return CrossSection([np.asarray(profile, float)], FillRule.NonZero).revolve(sides)


def extrude(outline: ArrayLike | CrossSection, height: float, **options) -> Manifold:
    """A prism over a polygon (n, 2), centred in z."""
    if not isinstance(outline, CrossSection):
        outline = CrossSection([np.asarray(outline, float)], FillRule.NonZero)
    return outline.extrude(height, **options).translate((0.0, 0.0, -height / 2))


def hull(*solids: Manifold) -> Manifold:
    """The convex hull of solids."""
    return Manifold.batch_hull(list(solids))


def strut(a: ArrayLike, b: ArrayLike, ra: float, rb: float | None = None, sides: int = 12):
    """A straight bar with round ends from a to b: the hull of two spheres."""
    rb = ra if rb is None else rb
    return hull(ball(ra, a, sides), ball(rb, b, sides))


def beam(a: ArrayLike, b: ArrayLike, width: float, depth: float | None = None) -> Manifold:
    """A straight bar of rectangular section from a to b (not along y)."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    along = (b - a) / np.linalg.norm(b - a)
    side = np.cross(along, (0.0, 1.0, 0.0))
    side /= np.linalg.norm(side)
    frame = np.stack([side, np.cross(along, side), along], 1)
    matrix = np.concatenate([frame, ((a + b) / 2)[:, None]], 1)
    size = (width, width if depth is None else depth, float(np.linalg.norm(b - a)))
    return box(size).transform(matrix)


def transport_frames(path: np.ndarray, closed: bool) -> tuple[np.ndarray, np.ndarray]:
    """Two unit normals along a curve (n, 3) without twist; a closed curve spreads the rest."""
    around = np.roll(path, -1, 0) - np.roll(path, 1, 0)
    tangent = around if closed else np.gradient(path, axis=0)
    tangent = tangent / np.linalg.norm(tangent, axis=1, keepdims=True)
    normal = np.empty_like(path)
    start = np.eye(3)[np.argmin(np.abs(tangent[0]))]
    for i, t in enumerate(tangent):
        previous = start if i == 0 else normal[i - 1]
        projected = previous - (previous @ t) * t
        normal[i] = projected / np.linalg.norm(projected)
    binormal = np.cross(tangent, normal)
    if closed:
        last = normal[-1] - (normal[-1] @ tangent[0]) * tangent[0]
        turn = -np.arctan2(last @ binormal[0], last @ normal[0]) * np.arange(len(path)) / len(path)
        c, s = np.cos(turn)[:, None], np.sin(turn)[:, None]
        normal, binormal = c * normal + s * binormal, -s * normal + c * binormal
    return normal, binormal


def tube(
    path: ArrayLike,
    radius: float | ArrayLike | Callable[[np.ndarray], np.ndarray],
    sides: int = 12,
    closed: bool = False,
    flat: float = 1.0,
) -> Manifold:
    """A tube about a smooth curve (n, 3): flat caps, or closed to a ring.

    Args:
        path: (n, 3) points of the curve, bending less than the radius allows.
        radius: A number, (n,) values, or a function of the parameter in [0, 1].
        sides: Corners of the section.
        closed: The last point joins the first.
        flat: Ratio of the section's two axes.
    """
    path = np.asarray(path, float)
    n = len(path)
    radii = radius(np.linspace(0, 1, n)) if callable(radius) else radius
    radii = np.broadcast_to(np.asarray(radii, float), n)[:, None, None]
    normal, binormal = transport_frames(path, closed)
    angle = np.arange(sides) * 2 * np.pi / sides
    ring = (
        np.cos(angle)[:, None] * normal[:, None] + flat * np.sin(angle)[:, None] * binormal[:, None]
    )
    vertices = (path[:, None] + radii * ring).reshape(-1, 3)
    rows = np.arange(n if closed else n - 1)[:, None] * sides
    here, beside = np.arange(sides), (np.arange(sides) + 1) % sides
    above = (rows + sides) % (n * sides)
    a, b, c, d = rows + here, rows + beside, above + beside, above + here
    faces = [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    if not closed:
        fan = np.arange(1, sides - 1)
        faces.append(np.stack([np.zeros_like(fan), fan + 1, fan], -1))
        faces.append(np.stack([np.zeros_like(fan), fan, fan + 1], -1) + (n - 1) * sides)
    return from_arrays(vertices, np.concatenate(faces))


def from_arrays(vertices: np.ndarray, faces: np.ndarray) -> Manifold:
    """A `Manifold` from a closed triangle mesh; its status says whether it is one."""
    return Manifold(
        Mesh64(np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(faces, np.uint64))
    )


def to_arrays(solid: Manifold) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) float64 and faces (m, 3) int64 of a solid."""
    mesh = solid.to_mesh64()
    return np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, np.int64)


def smooth_curve(points: ArrayLike, count: int = 48, closed: bool = False) -> np.ndarray:
    """A cubic spline through control points (k, 3), sampled at `count` points."""
    from scipy.interpolate import CubicSpline

    points = np.asarray(points, float)
    if closed:
        points = np.concatenate([points, points[:1]])
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1) ** 0.5
    knots = np.concatenate([[0.0], np.cumsum(steps)]) / steps.sum()
    spline = CubicSpline(knots, points, bc_type="periodic" if closed else "natural")
    return spline(np.linspace(0, 1, count, endpoint=not closed))
