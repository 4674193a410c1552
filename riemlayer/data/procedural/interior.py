"""Lamps with shades, sofas and beds."""

import numpy as np
from manifold3d import Manifold

from riemlayer.data.procedural.solids import (
    Rng,
    any_box,
    ball,
    beam,
    box,
    chance,
    cut,
    move,
    pick,
    revolve,
    rod,
    segments,
    smooth_curve,
    soft_box,
    strut,
    thin,
    tube,
)

Parts = list[Manifold]


def lamp(rng: Rng) -> Parts:
    """A lamp: a foot, a thin stem, straight or bent, and a shade that is a thin shell."""
    n, height, r = segments(rng), rng.uniform(0.8, 2.2), rng.uniform(0.03, 0.06)
    foot, shade = rng.uniform(0.2, 0.45), rng.uniform(0.2, 0.5)
    base = pick(rng, "disc", "box", "dome", "tripod")
    if base == "tripod":
        angle = np.arange(3) * 2 * np.pi / 3
        tips = np.stack([foot * np.cos(angle), foot * np.sin(angle), 0 * angle], 1) * 1.3
        parts = [strut(tip, (0, 0, height * 0.5), r, r) for tip in tips]
    elif base == "dome":
        parts = [cut(ball((foot, foot, foot * 0.6), sides=n), [box((3, 3, 2), (0, 0, -1))])]
    else:
        size = (2 * foot, 2 * foot, 0.08)
        parts = [rod(foot, 0.08, top=foot * 0.9, sides=n) if base == "disc" else any_box(rng, size)]
    drop = chance(rng, 0.4)
    if drop:
        reach = rng.uniform(0.3, 0.8)
        path = [
            (0, 0, 0),
            (0, 0, height * 0.75),
            (reach * 0.4, 0, height),
            (reach, 0, height * 0.9),
        ]
        parts.append(tube(smooth_curve(path, 40), r, 10))
        end = (reach, 0, height * 0.9)
    else:
        parts.append(rod(r, height, (0, 0, height / 2), sides=n))
        end = (0, 0, height)
    parts += [move(part, *end) for part in lampshade(rng, shade, n, drop)]
    return parts


def lampshade(rng: Rng, size: float, sides: int, drop: bool) -> Parts:
    """A conical or domed shell about z, or a globe, with a holder; the stem ends at the origin."""
    if chance(rng, 0.2):
        return [ball(size * rng.uniform(0.5, 0.9), (0, 0, 0.1 * size), sides)]
    wall = thin(rng, 0.025, 0.08)
    top, tall = size * rng.uniform(0.35, 1.0), size * rng.uniform(0.7, 1.6)
    t = np.linspace(0, 1, 10)
    outer = size + (top - size) * t ** rng.uniform(0.6, 2.5)
    profile = np.r_[np.c_[outer, tall * t], np.c_[outer - wall, tall * t][::-1]]
    profile[:, 0] = np.maximum(profile[:, 0], 0.02)
    shell = move(revolve(profile, sides), 0, 0, -tall * (0.9 if drop else 0.4))
    spokes = [beam((-size, 0, 0), (size, 0, 0), 0.06), beam((0, 0.01, 0), (0.01, size, 0), 0.06)]
    inside = rod(size, tall * 1.05, sides=sides, top=top)
    kept = [(spoke ^ move(inside, 0, 0, tall * (-0.4 if drop else 0.1))) for spoke in spokes[:1]]
    return [shell, *kept, ball(0.1, sides=12)]


def sofa(rng: Rng) -> Parts:
    """A sofa or a bed: rounded blocks, cushions, arms, head board, sometimes a corner part."""
    width, depth, height = rng.uniform(1.2, 2.4), rng.uniform(0.8, 2.0), rng.uniform(0.25, 0.5)
    r = rng.uniform(0.02, 0.12)
    parts = [soft_box((width, depth, height), (0, 0, height / 2 + 0.1), r)]
    feet = rng.uniform(0.05, 0.1)
    parts += [
        rod(feet, 0.3, (s * width * 0.42, t * depth * 0.4, 0.12)) for s in (-1, 1) for t in (-1, 1)
    ]
    back, thick = rng.uniform(0.3, 1.0), rng.uniform(0.06, 0.3)
    if chance(rng, 0.9):
        size = (width * rng.uniform(0.95, 1.1), thick, back + height)
        panel = soft_box(size, (0, 0, size[2] / 2), r).rotate((-rng.uniform(0, 12), 0, 0))
        parts.append(move(panel, 0, depth / 2, 0.05))
    for s in (-1, 1):
        if chance(rng, 0.6):
            size = (rng.uniform(0.1, 0.3), depth, height + rng.uniform(0.1, 0.4))
            parts.append(soft_box(size, (s * width / 2, 0, size[2] / 2 + 0.05), r))
    top = height + 0.1
    count = int(rng.integers(1, 4))
    for i in range(count):
        size = (width / count * rng.uniform(0.85, 0.99), depth * rng.uniform(0.6, 0.98), 0.2)
        parts.append(soft_box(size, (((i + 0.5) / count - 0.5) * width, -0.03, top + 0.05), 0.09))
    for _ in range(rng.integers(0, 4)):
        pillow = soft_box(rng.uniform(0.12, 0.5, 3)).rotate(tuple(rng.uniform(-40, 40, 3)))
        x, y = rng.uniform(-0.4, 0.4, 2) * (width, depth)
        parts.append(move(pillow, x, y, top + 0.2))
    if chance(rng, 0.2):
        parts.append(
            soft_box((0.7, depth * 1.8, height), (width / 2, -depth * 0.4, height / 2 + 0.1), r)
        )
    return parts
