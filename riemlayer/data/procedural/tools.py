"""Hand tools: hammers, wrenches, pliers, staplers, cutlery."""

import numpy as np
from manifold3d import Manifold

from riemlayer.data.procedural.solids import (
    Rng,
    any_box,
    ball,
    box,
    chance,
    cut,
    extrude,
    hull,
    move,
    pick,
    revolve,
    rod,
    segments,
    smooth_curve,
    soft_box,
    thin,
    tube,
)

Parts = list[Manifold]


def grip(rng: Rng, length: float) -> Manifold:
    """A handle along -x from the origin: bent flat tube, turned, or a box, with bulges."""
    style = pick(rng, "tube", "turned", "box")
    r = rng.uniform(0.06, 0.13)
    if style == "box":
        return any_box(rng, (length, r * 2, r * rng.uniform(1, 2)), (-length / 2, 0, 0), 0.04)
    knots = rng.uniform(0.65, 1.2, 6) * r
    if style == "turned":
        profile = smooth_curve(np.c_[knots, np.linspace(0, length, 6), 0 * knots], 30)[:, :2]
        profile[:, 0] = np.maximum(profile[:, 0], 0.04)
        solid = revolve(np.r_[[[0, 0]], profile, [[0, profile[-1, 1]]]], segments(rng))
        return solid.rotate((0, -90, 0))
    t = np.linspace(0, 1, 30)
    path = np.stack([-length * t, 0 * t, rng.uniform(-0.25, 0.25) * length * t**2], 1)
    waves = 1 + rng.uniform(0, 0.15) * np.sin(2 * np.pi * rng.uniform(2, 6) * t)
    radii = np.maximum(np.interp(t, np.linspace(0, 1, 6), knots) * waves, 0.04)
    return tube(path, radii, 14, flat=rng.uniform(0.6, 1.0))


def tool(rng: Rng) -> Parts:
    """A hammer, axe, wrench, screwdriver, brush, pan, saw or drill on a handle."""
    length = rng.uniform(1.0, 2.0)
    handle = grip(rng, length)
    head = pick(rng, hammer, claw, axe, spanner, driver, brush, pan, blade, drill)
    if head is drill:
        handle = handle.rotate((0, -rng.uniform(60, 100), 0))
    return [handle, *head(rng, segments(rng), length)]


def hammer(rng: Rng, n: int, length: float) -> Parts:
    """A cylinder across the handle, with a block or a wedge."""
    r, wide = rng.uniform(0.12, 0.25), rng.uniform(0.5, 0.9)
    parts = [rod(r, wide, sides=n), any_box(rng, (r * 1.6, r * 1.6, wide * 0.4))]
    if chance(rng, 0.4):
        parts.append(hull(rod(r, 0.1, sides=n), box((0.06, 2 * r, 0.02), (0, 0, wide * 0.8))))
    return parts


def claw(rng: Rng, n: int, length: float) -> Parts:
    """A hammer's face and two bent prongs."""
    r, wide = rng.uniform(0.12, 0.25), rng.uniform(0.5, 0.9)
    parts = [rod(r, wide * 0.5, (0, 0, wide * 0.25), top=r * rng.uniform(0.8, 1.2), sides=n)]
    for s in (-1, 1):
        path = [(0, s * 0.05, 0), (0, s * 0.09, -0.3), (-0.2, s * 0.14, -0.55)]
        parts.append(tube(smooth_curve(path, 20), np.linspace(0.1, 0.045, 20), 12))
    return parts


def axe(rng: Rng, n: int, length: float) -> Parts:
    """A wedge with a straight edge."""
    edge = box((rng.uniform(0.3, 0.6), 0.05, 0.02), (0, 0, rng.uniform(0.4, 0.7)))
    return [hull(box((0.25, 0.2, 0.2)), edge)]


def driver(rng: Rng, n: int, length: float) -> Parts:
    """A round shaft with a flat tip and a collar."""
    r, long = rng.uniform(0.05, 0.08), rng.uniform(0.5, 1.3)
    tip = box((0.2, 0.05, 3 * r), (long, 0, 0))
    return [
        rod(r, long, (long / 2 - 0.05, 0, 0), "x", sides=n),
        tip,
        rod(0.14, 0.1, axis="x", sides=n),
    ]


def brush(rng: Rng, n: int, length: float) -> Parts:
    """Rows of bristles on a block."""
    rows = np.linspace(0, 0.4, int(rng.integers(3, 7)))
    pins = [rod(0.035, 0.35, (x, 0.15, z), "y", sides=8) for x in rows for z in (-0.1, 0, 0.1)]
    return [any_box(rng, (0.5, 0.12, 0.3), (0.2, 0, 0)), *pins]


def pan(rng: Rng, n: int, length: float) -> Parts:
    """A shallow vessel with thin walls."""
    r, tall, wall = rng.uniform(0.35, 0.6), rng.uniform(0.08, 0.3), thin(rng, 0.022, 0.07)
    hollow = rod(r * 0.85 - wall, tall, (0, 0, wall), top=r - wall, sides=n)
    return [move(rod(r * 0.85, tall, top=r, sides=n) - hollow, r * 0.85)]


def blade(rng: Rng, n: int, length: float) -> Parts:
    """A knife, trowel or saw: a thin pointed plate, with or without teeth."""
    long, deep = rng.uniform(0.7, 1.5), rng.uniform(0.15, 0.45)
    x = np.array([-0.1, 0.9 * long, long, 0.8 * long, -0.1])
    y = np.array([-0.5, -0.5, rng.uniform(-0.4, 0.4), 0.5, 0.5]) * deep
    plate = extrude(np.c_[x, y], thin(rng, 0.025, 0.07)).rotate((90, 0, 0))
    teeth = np.linspace(0.1, 0.8, 9) * long if chance(rng, 0.3) else []
    return [cut(plate, [box((0.06, 1, 0.12), (u, 0, -deep / 2)) for u in teeth])]


def drill(rng: Rng, n: int, length: float) -> Parts:
    """A motor housing across the top of the handle, a chuck, a bit and a battery."""
    long = rng.uniform(0.6, 1.0)
    return [
        rod(0.2, long, (0.1, 0, 0.05), "x", sides=n),
        rod(0.12, 0.3, (long / 2 + 0.2, 0, 0.05), "x", top=0.08, sides=n),
        rod(0.04, 0.4, (long / 2 + 0.4, 0, 0.05), "x", sides=10),
        any_box(rng, (0.5, 0.3, 0.2), (-0.25, 0, -0.95 * length)),
    ]


def spanner(rng: Rng, n: int, length: float) -> Parts:
    """Open or ring jaws at one or both ends of a handle."""
    r, thick = rng.uniform(0.2, 0.32), rng.uniform(0.1, 0.18)
    parts = []
    for x in pick(rng, (0.1,), (0.1, -length - 0.1)):
        jaw = rod(r, thick, axis="y", sides=max(n, 16))
        if chance(rng, 0.6):
            gap = box((r * 1.6, 1, r * 0.8), (r * 0.9, 0, 0)).rotate((0, rng.uniform(-25, 25), 0))
            jaw -= gap if x > 0 else gap.mirror((1, 0, 0))
        else:
            jaw -= rod(r * 0.6, 1, axis="y", sides=pick(rng, 6, 12, 30))
        parts.append(move(jaw, x + np.sign(x) * r * 0.7, 0, 0))
    return parts


def pliers(rng: Rng) -> Parts:
    """Pliers, scissors, tongs, clothes peg: two crossed curved bars on a pivot."""
    spread, thick = rng.uniform(0.15, 0.5), rng.uniform(0.05, 0.09)
    long, jaw = rng.uniform(0.9, 1.6), rng.uniform(0.4, 1.1)
    parts, loops = [rod(0.13, 0.26, sides=segments(rng))], chance(rng, 0.5)
    for s in (-1, 1):
        path = [
            (-long, s * spread, 0),
            (-long * 0.5, s * spread * 0.9, 0),
            (0, -s * 0.04, s * 0.05),
        ]
        parts.append(tube(smooth_curve([*path, (0.2, -s * 0.08, s * 0.03)], 30), thick, 10))
        tip = np.array([jaw, -s * rng.uniform(0.03, 0.15), 0])
        parts.append(hull(box((0.1, 0.14, 0.14), (0.15, -s * 0.1, s * 0.03)), ball(0.04, tip, 10)))
        if loops:
            t = np.arange(28) * 2 * np.pi / 28
            at = np.array([-long - 0.18, s * (spread + 0.02), 0])
            parts.append(
                tube(
                    at + 0.22 * np.stack([1.1 * np.cos(t), np.sin(t), 0 * t], 1),
                    thick * 0.9,
                    10,
                    True,
                )
            )
    return parts


def stapler(rng: Rng) -> Parts:
    """Hinged bars: a stapler, punch, clamp, press or laptop."""
    long, wide = rng.uniform(1.2, 2.0), rng.uniform(0.25, 1.2)
    base = any_box(rng, (long, wide, rng.uniform(0.06, 0.15)), edge=0.05)
    top = any_box(
        rng,
        (long * rng.uniform(0.8, 1), wide * rng.uniform(0.7, 1), rng.uniform(0.06, 0.3)),
        edge=0.1,
    )
    low, _ = np.reshape(top.bounding_box(), (2, 3))
    top = top.translate((-low[0], 0, -low[2])).rotate((0, -rng.uniform(3, 100), 0))
    hinge = rod(0.14, wide * 0.9, (-long / 2 + 0.12, 0, 0.08), "y", sides=segments(rng))
    parts = [base, top.translate((-long / 2 + 0.1, 0, 0.06)), hinge]
    if chance(rng, 0.5):
        parts.append(any_box(rng, (0.3, wide * 0.6, 0.25), (long * 0.35, 0, 0.05)))
    if chance(rng, 0.3):
        loop = smooth_curve([(0, -0.12, 0), (0.3, -0.14, 0), (0.3, 0.14, 0), (0, 0.12, 0)], 24)
        parts.append(move(tube(loop, 0.045, 8), long / 2 - 0.05, 0, 0))
    return parts


def cutlery(rng: Rng) -> Parts:
    """A spoon, fork, ladle, comb, rake or key: a thin shaped plate on a stem."""
    stem, r = rng.uniform(0.8, 1.6), rng.uniform(0.045, 0.07)
    t = np.linspace(0, 1, 24)
    path = np.stack([-stem * t, 0 * t, rng.uniform(-0.2, 0.2) * np.sin(np.pi * t)], 1)
    parts = [
        tube(
            path,
            np.interp(t, [0, 0.6, 1], [r, r, r * rng.uniform(1, 2.2)]),
            10,
            flat=rng.uniform(1, 2.0),
        )
    ]
    style = pick(rng, "spoon", "fork", "comb", "key")
    if style == "spoon":
        size = rng.uniform(0.2, 0.5, 3) * (1.2, 1, 0.7)
        bowl = ball(size, (size[0] * 0.85, 0, 0)) - ball(size - 0.06, (size[0] * 0.85, 0, 0.02))
        parts.append(bowl - box((3, 3, 1), (0, 0, 0.5 + 0.06)))
    elif style == "key":
        parts.append(move(cut(rod(0.3, 0.1), [rod(0.18, 1, (0.03, 0, 0))]), 0.25, 0, 0))
        parts += [
            box((0.08, rng.uniform(0.15, 0.4), 0.09), (-x, 0.12, 0))
            for x in rng.uniform(0.6, 1, 4) * stem
        ]
    else:
        count, long = int(rng.integers(3, 8)), rng.uniform(0.3, 0.7)
        wide = 0.14 * count
        parts.append(soft_box((0.25, wide, 0.1), (0.1, 0, 0), 0.04))
        y = (np.arange(count) + 0.5 - count / 2) * 0.14
        parts += [box((long, 0.07, 0.07), (0.2 + long / 2, v, 0)) for v in y]
    return parts
