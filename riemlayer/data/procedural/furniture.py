"""Furniture with sharp or rounded boards: chairs, tables, shelves, lamps, beds and sofas."""

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
    extrude,
    move,
    pick,
    revolve,
    rod,
    segments,
    smooth_curve,
    soft_box,
    strut,
    tube,
)

Parts = list[Manifold]


def legs(rng: Rng, width: float, depth: float, height: float, thick: float) -> Parts:
    """Legs from the floor (z = 0) up to a height: posts, splayed, turned, pedestal, slabs, sled."""
    style = pick(
        rng, "post", "round", "splay", "splay", "pedestal", "slabs", "sled", "cross", "turned"
    )
    x, y, n = width / 2 - thick, depth / 2 - thick, segments(rng)
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    if style == "post":
        return [any_box(rng, (thick, thick, height), (a, b, height / 2)) for a, b in corners]
    if style == "round":
        top = thick * rng.uniform(0.6, 1.2)
        return [rod(thick / 2, height, (a, b, height / 2), top=top, sides=n) for a, b in corners]
    if style == "splay":
        out = rng.uniform(1.0, 1.35)
        r = thick * rng.uniform(0.35, 0.6)
        feet = [strut((a * out, b * out, r), (a, b, height), r, thick * 0.6) for a, b in corners]
        return feet if chance(rng, 0.6) else feet + stretchers(rng, corners, height, thick, out)
    if style == "pedestal":
        foot = rng.uniform(0.3, 0.55) * min(width, depth)
        parts = [rod(thick * rng.uniform(0.6, 1.4), height, (0, 0, height / 2), sides=n)]
        if chance(rng, 0.5):
            return [*parts, rod(foot, thick, (0, 0, thick / 2), top=foot * 0.8, sides=n)]
        angle = np.arange(k := int(rng.integers(3, 6))) * 2 * np.pi / k
        tips = np.stack([foot * np.cos(angle), foot * np.sin(angle), 0 * angle + thick / 2], 1)
        return parts + [strut((0, 0, thick), tip, thick * 0.6, thick * 0.45) for tip in tips]
    if style == "slabs":
        return [
            any_box(rng, (thick, depth * 0.95, height), (s * x, 0, height / 2)) for s in (-1, 1)
        ]
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
    profile = np.r_[[[0, 0]], knots[:, ::-1], [[0, height]]]
    return [move(revolve(profile, n), a, b) for a, b in corners]


def stretchers(rng: Rng, corners, height: float, thick: float, out: float) -> Parts:
    """Bars between neighbouring legs at some height."""
    level, r = rng.uniform(0.2, 0.6), thick * rng.uniform(0.3, 0.45)
    scale = out + (1 - out) * level
    at = [(a * scale, b * scale, level * height) for a, b in corners]
    chosen = [pair for pair in zip(at, at[1:] + at[:1], strict=True) if chance(rng, 0.75)]
    return [strut(a, b, r) for a, b in chosen]


def backrest(rng: Rng, width: float, seat: float, height: float, thick: float) -> Parts:
    """The back of a chair in the plane y = 0, from the seat's level upward, leaning back."""
    style = pick(rng, "panel", "panel", "slats", "ladder", "round", "frame")
    if style == "panel":
        low = rng.uniform(0, 0.3) * height
        parts = [
            any_box(rng, (width, thick, height - low), (0, 0, (height + low) / 2), 0.3 * thick)
        ]
        if low > 0.02:
            parts += [
                box((thick, thick, height), (s * width * 0.35, 0, height / 2)) for s in (-1, 1)
            ]
        if chance(rng, 0.25):
            holes = rng.integers(1, 4)
            size = (width * 0.5, 3 * thick, 0.5 * (height - low) / holes)
            levels = low + (np.arange(holes) + 0.5) / holes * (height - low)
            parts[0] = cut(parts[0], [box(size, (0, 0, z)) for z in levels])
    elif style == "round":
        outline = smooth_curve(
            [
                (-width / 2, 0, 0),
                (-width / 2, 0, 0.7 * height),
                (0, 0, height),
                (width / 2, 0, 0.7 * height),
                (width / 2, 0, 0),
            ],
            32,
        )
        parts = [tube(outline, thick * 0.6, 10)]
        spindles = np.linspace(-0.4, 0.4, int(rng.integers(2, 6))) * width
        parts += [
            rod(thick * 0.4, 0.85 * height, (a, 0, 0.425 * height), sides=8) for a in spindles
        ]
    else:
        parts = [
            box((thick, thick, height), (s * (width - thick) / 2, 0, height / 2)) for s in (-1, 1)
        ]
        parts += [box((width, thick * 0.9, thick * rng.uniform(1, 3)), (0, 0, height - thick / 2))]
        count = int(rng.integers(2, 6))
        if style == "slats":
            size = (width / count * 0.5, thick * 0.7, height)
            parts += [
                box(size, (a, 0, height / 2))
                for a in (np.arange(count) + 0.5) / count * width - width / 2
            ]
        elif style == "ladder":
            levels = (np.arange(count) + 0.5) / count * height
            parts += [box((width, thick * 0.7, height / count * 0.45), (0, 0, z)) for z in levels]
        else:
            parts += [
                any_box(rng, (width * 0.9, thick * 0.5, height * 0.7), (0, 0, height * 0.5), 0.1)
            ]
    lean = rng.uniform(-0.5, 22)
    return [move(part.rotate((-lean, 0, 0)), 0, 0, seat) for part in parts]


def chair(rng: Rng) -> Parts:
    """A chair, armchair or stool."""
    width, depth = rng.uniform(0.7, 1.2, 2)
    thick, leg = rng.uniform(0.05, 0.16), rng.uniform(0.3, 1.2)
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
        bar = rng.uniform(0.045, 0.12)
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
    thick = rng.uniform(0.045, 0.12)
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


def shelf(rng: Rng) -> Parts:
    """A bookcase, rack, cabinet or wardrobe: thin boards, divisions, doors, books."""
    width, depth, height = rng.uniform(0.5, 2.0), rng.uniform(0.25, 0.8), rng.uniform(0.6, 2.2)
    board = rng.uniform(0.022, 0.05) * max(width, height)
    rows, columns = int(rng.integers(1, 7)), int(rng.integers(1, 4))
    side = (board, depth, height)
    parts = [
        any_box(rng, side, (s * (width - board) / 2, 0, height / 2), 0.3 * board) for s in (-1, 1)
    ]
    if chance(rng, 0.2):
        parts = [
            box(
                (board, board, height),
                (s * (width - board) / 2, t * (depth - board) / 2, height / 2),
            )
            for s in (-1, 1)
            for t in (-1, 1)
        ]
    levels = np.linspace(rng.uniform(0, 0.15), 1, rows + 1) * (height - board) + board / 2
    levels[1:-1] += rng.uniform(-0.2, 0.2, rows - 1) * height / rows
    parts += [box((width - board / 2, depth * 0.97, board), (0, 0, z)) for z in levels]
    if chance(rng, 0.6):
        parts.append(
            box((width * 0.99, board, height * 0.99), (0, (depth - board) / 2, height / 2))
        )
    for i in range(rows):
        gap, middle = levels[i + 1] - levels[i], (levels[i + 1] + levels[i]) / 2
        for x in (np.arange(1, columns) / columns - 0.5) * width:
            if chance(rng, 0.8):
                parts.append(box((board, depth * 0.96, gap), (x, 0.003, middle)))
        if chance(rng, 0.25):
            parts += books(rng, width, depth, levels[i] + board * 0.4, gap)
        elif chance(rng, 0.15):
            parts.append(box((width * 0.98, board, gap), (0, -depth / 2 + board * 0.4, middle)))
    if chance(rng, 0.25):
        parts += [move(leg, 0, 0, -0.15) for leg in legs(rng, width, depth, 0.2, 2 * board)]
    return parts


def books(rng: Rng, width: float, depth: float, level: float, gap: float) -> Parts:
    """A row of upright slabs of different sizes."""
    parts, x = [], -width / 2 + 0.1 * width
    while x < width * rng.uniform(0, 0.45):
        size = np.array(
            [rng.uniform(0.05, 0.12), depth * rng.uniform(0.5, 0.9), gap * rng.uniform(0.5, 0.9)]
        )
        parts.append(box(size, (x, 0.02, level + size[2] / 2)))
        x += size[0] * rng.uniform(0.9, 1.5)
    return parts


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
    wall = rng.uniform(0.05, 0.08)
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
        parts.append(move(pillow, *(rng.uniform(-0.4, 0.4, 2) * (width, depth)), top + 0.2))
    if chance(rng, 0.2):
        parts.append(
            soft_box((0.7, depth * 1.8, height), (width / 2, -depth * 0.4, height / 2 + 0.1), r)
        )
    return parts


def furniture_soup(rng: Rng) -> Parts:
    """Overlapping convex boxes and posts on a common frame, as in robot description files."""
    count = int(rng.integers(6, 22))
    parts = [any_box(rng, rng.uniform(0.3, 1.4, 3))]
    for _ in range(count):
        host = np.reshape(parts[int(rng.integers(len(parts)))].bounding_box(), (2, 3))
        at = host[0] + rng.random(3) * (host[1] - host[0])
        axis = int(rng.integers(3))
        at[axis] = host[int(rng.integers(2)), axis]
        size = rng.uniform(0.06, 0.7, 3) * pick(
            rng, (1, 1, 1), (1, 1, 0.15), (0.2, 0.2, 1.5), (1.5, 0.4, 0.1)
        )
        size = np.maximum(size, 0.06)[rng.permutation(3)]
        part = (
            any_box(rng, size)
            if chance(rng, 0.75)
            else rod(size[0] / 2, size[2], axis=pick(rng, "x", "y", "z"))
        )
        if chance(rng, 0.15):
            part = part.rotate(tuple(rng.uniform(-30, 30, 3)))
        parts.append(move(part, *at))
    if chance(rng, 0.3):
        outline = rng.uniform(0.2, 0.5) * np.c_[np.cos(t := np.arange(5) * 1.2566), np.sin(t)]
        parts.append(extrude(outline, 1.5))
    return parts
