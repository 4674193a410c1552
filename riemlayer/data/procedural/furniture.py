"""Chairs, stools, tables and desks with sharp or rounded boards."""

import numpy as np
from manifold3d import Manifold

from riemlayer.data.procedural.solids import (
    Rng,
    any_box,
    ball,
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


def legs(rng: Rng, width: float, depth: float, height: float, thick: float) -> Parts:
    """Legs from the floor (z = 0) up to a height: posts, splayed, turned, pedestal, slabs, sled."""
    style = pick(
        rng, "post", "round", "splay", "splay", "pedestal", "slab", "sled", "cross", "turned"
    )
    x, y, n = width / 2 - thick, depth / 2 - thick, segments(rng)
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    if style == "post":
        return [any_box(rng, (thick, thick, height), (a, b, height / 2)) for a, b in corners]
    if style == "round":
        top = thick * rng.uniform(0.6, 1.2)
        return [rod(thick / 2, height, (a, b, height / 2), top=top, sides=n) for a, b in corners]
    if style == "splay":
        out, r = rng.uniform(1.0, 1.35), thick * rng.uniform(0.35, 0.6)
        feet = [strut((a * out, b * out, r), (a, b, height), r, thick * 0.6) for a, b in corners]
        return feet if chance(rng, 0.6) else feet + stretchers(rng, corners, height, thick, out)
    if style == "pedestal":
        return pedestal(rng, rng.uniform(0.3, 0.55) * min(width, depth), height, thick, n)
    if style == "slab":
        size = (thick, depth * 0.95, height)
        return [any_box(rng, size, (s * x, 0, height / 2)) for s in (-1, 1)]
    if style == "sled":
        posts = [box((thick, thick, height), (a, b, height / 2)) for a, b in corners]
        return posts + [box((thick, 2 * y + thick, thick), (s * x, 0, thick / 2)) for s in (-1, 1)]
    if style == "cross":
        pairs = [((a, -y, thick / 2), (a, y, height)) for a in (-x, x)]
        pairs += [((a, y, thick / 2), (a, -y, height)) for a in (-x, x)]
        bar = box((2 * x, thick * 0.7, thick * 0.7), (0, 0, height / 2))
        return [strut(a, b, thick * 0.5) for a, b in pairs] + [bar]
    knots = smooth_curve(np.c_[np.linspace(0, height, 6), rng.uniform(0.3, 0.75, 6) * thick], 20)
    knots[:, 1] = np.maximum(knots[:, 1], 0.25 * thick)
    turned = revolve(np.r_[[[0, 0]], knots[:, ::-1], [[0, height]]], n)
    return [move(turned, a, b) for a, b in corners]


def pedestal(rng: Rng, foot: float, height: float, thick: float, sides: int) -> Parts:
    """One column on a disc or on three to five arms."""
    parts = [rod(thick * rng.uniform(0.6, 1.4), height, (0, 0, height / 2), sides=sides)]
    if chance(rng, 0.5):
        return [*parts, rod(foot, thick, (0, 0, thick / 2), top=foot * 0.8, sides=sides)]
    angle = np.arange(k := int(rng.integers(3, 6))) * 2 * np.pi / k
    tips = np.stack([foot * np.cos(angle), foot * np.sin(angle), 0 * angle + thick / 2], 1)
    return parts + [strut((0, 0, thick), tip, thick * 0.6, thick * 0.45) for tip in tips]


def stretchers(rng: Rng, corners, height: float, thick: float, out: float) -> Parts:
    """Bars between neighbouring legs at some height."""
    level, r = rng.uniform(0.2, 0.6), thick * rng.uniform(0.3, 0.45)
    scale = out + (1 - out) * level
    at = [(a * scale, b * scale, level * height) for a, b in corners]
    chosen = [pair for pair in zip(at, at[1:] + at[:1], strict=True) if chance(rng, 0.75)]
    return [strut(a, b, r) for a, b in chosen]


def backrest(rng: Rng, width: float, seat: float, height: float, thick: float) -> Parts:
    """The back of a chair in the plane y = 0, from the seat's level upward, leaning back."""
    parts = pick(rng, panel, panel, hoop, open_back, open_back, open_back)(
        rng, width, height, thick
    )
    lean = rng.uniform(-0.5, 22)
    return [move(part.rotate((-lean, 0, 0)), 0, 0, seat) for part in parts]


def panel(rng: Rng, width: float, height: float, thick: float) -> Parts:
    """A board, down to the seat or on two posts, sometimes with windows."""
    low = rng.uniform(0, 0.3) * height
    board = any_box(rng, (width, thick, height - low), (0, 0, (height + low) / 2), 0.3 * thick)
    if chance(rng, 0.25):
        holes = int(rng.integers(1, 4))
        size = (width * 0.5, 3 * thick, 0.5 * (height - low) / holes)
        levels = low + (np.arange(holes) + 0.5) / holes * (height - low)
        board = cut(board, [box(size, (0, 0, z)) for z in levels])
    return [board, *posts(width * 0.7 + thick, height, thick)]


def posts(width: float, height: float, thick: float) -> Parts:
    """Two upright posts, `width` apart from outside to outside."""
    x = (width - thick) / 2
    return [box((thick, thick, height), (s * x, 0, height / 2)) for s in (-1, 1)]


def hoop(rng: Rng, width: float, height: float, thick: float) -> Parts:
    """A bent rod with spindles."""
    x = width / 2
    knots = [(-x, 0, 0), (-x, 0, 0.7 * height), (0, 0, height), (x, 0, 0.7 * height), (x, 0, 0)]
    spindles = np.linspace(-0.4, 0.4, int(rng.integers(2, 6))) * width
    rods = [rod(thick * 0.4, 0.85 * height, (a, 0, 0.425 * height), sides=8) for a in spindles]
    return [tube(smooth_curve(knots, 32), thick * 0.6, 10), *rods]


def open_back(rng: Rng, width: float, height: float, thick: float) -> Parts:
    """Two posts and a rail with slats, rungs or an inner panel."""
    rail = box((width, thick * 0.9, thick * rng.uniform(1, 3)), (0, 0, height - thick / 2))
    count = int(rng.integers(2, 6))
    share = (np.arange(count) + 0.5) / count
    style = pick(rng, "slats", "rungs", "panel")
    if style == "slats":
        size = (width / count * 0.5, thick * 0.7, height)
        inner = [box(size, ((t - 0.5) * width, 0, height / 2)) for t in share]
    elif style == "rungs":
        size = (width, thick * 0.7, height / count * 0.45)
        inner = [box(size, (0, 0, t * height)) for t in share]
    else:
        inner = [any_box(rng, (width * 0.9, thick * 0.5, height * 0.7), (0, 0, height * 0.5), 0.1)]
    return [*posts(width, height, thick), rail, *inner]


def chair(rng: Rng) -> Parts:
    """A chair, armchair or stool."""
    width, depth = rng.uniform(0.7, 1.2, 2)
    thick, leg = thin(rng, 0.02, 0.16), rng.uniform(0.3, 1.2)
    seat_z = leg + thick / 2
    if chance(rng, 0.25):
        seat = rod(width / 2, thick, (0, 0, seat_z), sides=segments(rng)).scale(
            (1, depth / width, 1)
        )
    else:
        seat = any_box(rng, (width, depth, thick), (0, 0, seat_z), thick * 0.45)
    parts = [
        seat,
        *legs(rng, width * 0.95, depth * 0.95, leg + thick * 0.4, rng.uniform(0.05, 0.12)),
    ]
    if chance(rng, 0.2):
        parts.append(
            soft_box((width * 0.9, depth * 0.9, thick), (0, 0, seat_z + thick * 0.8), 0.05)
        )
    if chance(rng, 0.85):
        bar = thin(rng, 0.022, 0.12)
        back = backrest(rng, width * rng.uniform(0.8, 1), leg, rng.uniform(0.4, 1.3), bar)
        parts += [move(part, 0, depth / 2 - bar / 2, 0) for part in back]
        if chance(rng, 0.4):
            parts += arms(rng, width, depth, seat_z)
    return parts


def arms(rng: Rng, width: float, depth: float, seat: float) -> Parts:
    """Armrests on posts or as solid sides."""
    height, thick = rng.uniform(0.2, 0.45), rng.uniform(0.05, 0.12)
    if chance(rng, 0.35):
        size = (thick, depth, height + 0.1)
        return [any_box(rng, size, (s * width / 2, 0, seat + height / 2 - 0.05)) for s in (-1, 1)]
    rests = [
        any_box(rng, (thick * 1.2, depth, thick), (s * width / 2, 0, seat + height))
        for s in (-1, 1)
    ]
    posts = [
        box((thick, thick, height), (s * width / 2, -depth * 0.35, seat + height / 2))
        for s in (-1, 1)
    ]
    return rests + posts


def table(rng: Rng) -> Parts:
    """A table or a desk with drawers, sometimes with things on it."""
    width, depth, height = rng.uniform(0.9, 2.2), rng.uniform(0.6, 1.2), rng.uniform(0.25, 1.1)
    thick = thin(rng, 0.02, 0.12)
    top_z = height + thick / 2
    if chance(rng, 0.3):
        top = rod(width / 2, thick, (0, 0, top_z), sides=segments(rng)).scale(
            (1, rng.uniform(0.6, 1), 1)
        )
        depth = width
    else:
        top = any_box(rng, (width, depth, thick), (0, 0, top_z), thick * 0.4)
    parts = [top]
    if chance(rng, 0.35):
        for side in pick(rng, (-1,), (1,), (-1, 1)):
            size = (width * rng.uniform(0.22, 0.35), depth * 0.9, height)
            parts += drawers(rng, size, (side * (width - size[0]) * 0.48, 0, height / 2))
        parts.append(
            box((thick, depth * 0.9, height), (rng.uniform(-0.4, 0.4) * width, 0, height / 2))
        )
    else:
        parts += legs(rng, width * 0.9, depth * 0.9, height + thick / 2, rng.uniform(0.05, 0.14))
        if chance(rng, 0.3):
            skirt = rng.uniform(0.08, 0.2)
            parts.append(
                box((width * 0.75, depth * 0.75, skirt), (0, 0, height - skirt / 2 + 0.01))
            )
    if chance(rng, 0.3):
        parts += clutter(rng, width * 0.7, depth * 0.7, height + thick)
    return parts


def drawers(rng: Rng, size, centre) -> Parts:
    """A chest of drawers: a body, protruding or inset fronts, knobs or bars."""
    width, depth, height = size
    rows, columns = int(rng.integers(1, 5)), int(rng.integers(1, 3))
    body, gap = any_box(rng, size), 0.12 * min(width / columns, height / rows)
    fronts, pockets = [], []
    inset, knob = chance(rng, 0.4), pick(rng, "ball", "bar", "none")
    for i in range(rows * columns):
        x = ((i % columns + 0.5) / columns - 0.5) * width
        z = ((i // columns + 0.5) / rows - 0.5) * height
        face = (width / columns - gap, 0.08, height / rows - gap)
        (pockets if inset else fronts).append(box(face, (x, -depth / 2, z)))
        if knob == "ball":
            fronts.append(ball(0.045, (x, -depth / 2 - 0.05, z), 12))
        elif knob == "bar":
            fronts.append(box((face[0] * 0.4, 0.12, 0.05), (x, -depth / 2 - 0.03, z)))
    return [move(part, *centre) for part in [cut(body, pockets), *fronts]]


def clutter(rng: Rng, width: float, depth: float, level: float) -> Parts:
    """A few small things standing on a plane."""
    parts = []
    for _ in range(rng.integers(1, 6)):
        x, y = rng.uniform(-0.5, 0.5, 2) * (width, depth)
        size = rng.uniform(0.08, 0.3, 3)
        style = pick(rng, "box", "can", "ball", "plate")
        if style == "box":
            part = any_box(rng, size).rotate((0, 0, rng.uniform(0, 90)))
        elif style == "can":
            part = rod(size[0] / 2, size[2], top=size[1] / 2, sides=segments(rng))
        elif style == "ball":
            part = ball(size / 2)
        else:
            size[2] = 0.06
            part = rod(size[0], size[2], sides=segments(rng))
        parts.append(move(part, x, y, level + size[2] / 2 - 0.015))
    return parts
