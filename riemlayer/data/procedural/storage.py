"""Shelves, bookcases, cabinets, and boxes put together at random."""

import numpy as np
from manifold3d import Manifold

from riemlayer.data.procedural.furniture import legs
from riemlayer.data.procedural.solids import (
    Rng,
    any_box,
    box,
    chance,
    extrude,
    move,
    pick,
    rod,
    thin,
)

Parts = list[Manifold]


def shelf(rng: Rng) -> Parts:
    """A bookcase, rack, cabinet or wardrobe: thin boards, divisions, doors, books."""
    width, depth, height = rng.uniform(0.5, 2.0), rng.uniform(0.25, 0.8), rng.uniform(0.6, 2.2)
    board = thin(rng, 0.01, 0.045) * max(width, height)
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
