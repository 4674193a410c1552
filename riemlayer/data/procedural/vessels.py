"""Vessels with real walls: cups, vases, bottles, bowls, wine glasses, with handles."""

import numpy as np
from manifold3d import Manifold

from riemlayer.data.procedural.solids import (
    Rng,
    ball,
    chance,
    cut,
    extrude,
    move,
    pick,
    revolve,
    rod,
    segments,
    smooth_curve,
    thin,
    tube,
)

Parts = list[Manifold]


def outline(rng: Rng, style: str) -> tuple[np.ndarray, float]:
    """Outer radius and height (n, 2) of a vessel from foot to lip, and its floor's level."""
    if style == "cup":
        r, h = rng.uniform(0.35, 0.7), rng.uniform(0.5, 1.3)
        bulge = rng.uniform(-0.15, 0.25)
        knots = [(r * rng.uniform(0.6, 1.05), 0), (r * (1 + bulge), h * 0.45), (r, h)]
    elif style == "bowl":
        r, h = rng.uniform(0.7, 1), rng.uniform(0.15, 0.6)
        knots = [(r * rng.uniform(0.3, 0.8), 0), (r * rng.uniform(0.75, 0.98), h * 0.4), (r, h)]
    elif style == "bottle":
        neck, h = rng.uniform(0.1, 0.2), rng.uniform(1.2, 2.2)
        body, shoulder = rng.uniform(0.3, 0.5), rng.uniform(0.45, 0.75)
        knots = [
            (body, 0),
            (body * rng.uniform(0.85, 1.05), 0.25 * h),
            (body, shoulder * h * 0.9),
            (neck, (shoulder + 0.15) * h),
            (neck, h),
        ]
    elif style == "glass":
        stem, h = rng.uniform(0.05, 0.09), rng.uniform(1.4, 2.2)
        foot, bowl = rng.uniform(0.3, 0.45), rng.uniform(0.3, 0.6)
        start = rng.uniform(0.35, 0.6)
        knots = [
            (foot, 0),
            (foot * 0.9, 0.04),
            (stem, 0.14),
            (stem, start * h * 0.9),
            (bowl * 0.8, (start + 0.12) * h),
            (bowl, (start + 0.25) * h),
            (bowl * rng.uniform(0.6, 1.1), h),
        ]
        return resample(knots), start * h + 0.05
    else:
        h, count = rng.uniform(0.8, 2.2), int(rng.integers(3, 7))
        radii = rng.uniform(0.18, 0.7, count)
        knots = list(zip(radii, np.linspace(0, 1, count) * h, strict=True))
    return resample(knots), thin(rng, 0.025, 0.1)


def resample(knots, count: int = 40) -> np.ndarray:
    """A smooth monotone-height profile through knots of (radius, height)."""
    from scipy.interpolate import PchipInterpolator

    knots = np.asarray(knots, float)
    height = np.linspace(0, knots[-1, 1], count)
    return np.c_[PchipInterpolator(knots[:, 1], knots[:, 0])(height), height]


def shell(outer: np.ndarray, floor: float, wall: float, sides: int) -> Manifold:
    """The outline revolved, hollowed above the floor by walls of constant horizontal thickness."""
    inside = outer[outer[:, 1] > floor]
    inside = np.c_[np.maximum(inside[:, 0] - wall, 0.01), inside[:, 1]]
    profile = np.r_[[[0, 0]], outer, inside[::-1], [[0, inside[0, 1]]]]
    return revolve(profile, sides)


def handle(rng: Rng, outer: np.ndarray, sides: int = 12) -> Manifold:
    """A tube handle on the +x side, both ends sunk in the wall."""
    h = outer[-1, 1]
    low, high = h * rng.uniform(0.1, 0.35), h * rng.uniform(0.65, 0.95)
    r = rng.uniform(0.045, 0.09)
    at = np.interp([low, high], outer[:, 1], outer[:, 0]) - 0.02
    reach = max(at) + rng.uniform(0.2, 0.5)
    path = [
        (at[0] - 0.03, 0, low),
        (reach * 0.92, 0, low + 0.12 * (high - low)),
        (reach, 0, (low + high) / 2 + rng.uniform(-0.1, 0.2) * (high - low)),
        (reach * 0.92, 0, high),
        (at[1] - 0.03, 0, high),
    ]
    return tube(smooth_curve(path, 40), r, sides, flat=rng.uniform(0.6, 1.6))


def vessel(rng: Rng) -> Parts:
    """A cup, bowl, bottle, stemmed glass, vase or pot."""
    style = pick(rng, "cup", "cup", "bowl", "bottle", "glass", "vase", "vase")
    outer, floor = outline(rng, style)
    sides, half = segments(rng), max(outer[:, 0].max(), outer[-1, 1] / 2)
    wall = thin(rng, 0.018, 0.1) * half
    solid = style == "bottle" and chance(rng, 0.5)
    body = revolve(np.r_[[[0, 0]], outer, [[0, outer[-1, 1]]]], sides) if solid else None
    body = body or shell(outer, floor, wall, sides)
    if style in ("vase", "cup") and chance(rng, 0.2):
        body = polygonal(rng, outer, wall, floor)
    count = pick(rng, 1, 1, 2) if style == "cup" else int(chance(rng, 0.3)) * 2
    if style == "glass":
        count = 0
    parts = [body]
    if count:
        grip = handle(rng, outer)
        inner = np.r_[
            [[0, floor]], np.c_[outer[:, 0] - 0.6 * wall, outer[:, 1]][outer[:, 1] > floor]
        ]
        hollow = revolve(np.r_[inner, [[0, outer[-1, 1] + 1]]][:, :], sides)
        parts += [cut(grip.rotate((0, 0, 180.0 * i)), [hollow]) for i in range(count)]
    if solid and chance(rng, 0.7):
        parts.append(rod(outer[-1, 0] * 1.2, 0.2, (0, 0, outer[-1, 1]), sides=sides))
        if chance(rng, 0.4):
            parts.append(tube([(0, 0, outer[-1, 1]), (0, 0, outer[-1, 1] + 0.25)], 0.06))
    if style == "vase" and chance(rng, 0.3):
        parts += flowers(rng, outer)
    return parts


def polygonal(rng: Rng, outer: np.ndarray, wall: float, floor: float) -> Manifold:
    """A square or star-shaped vessel, straight or twisted."""
    k, h, r = int(rng.integers(3, 9)), outer[-1, 1], outer[:, 0].mean()
    angle = np.arange(k) * 2 * np.pi / k
    section = r * np.c_[np.cos(angle), np.sin(angle)]
    options = {
        "n_divisions": 16,
        "twist_degrees": rng.uniform(-60, 60),
        "scale_top": (s := rng.uniform(0.6, 1.4), s),
    }
    body = extrude(section, h, **options)
    hollow = extrude(section * (1 - 1.3 * wall / r), h, **options)
    return move(cut(body, [move(hollow, 0, 0, floor + 0.03)]), 0, 0, h / 2)


def flowers(rng: Rng, outer: np.ndarray) -> Parts:
    """Stems out of a vase with heads, standing on its floor."""
    h, reach = outer[-1, 1], outer[:, 0].min() * 0.5
    parts = []
    for _ in range(rng.integers(1, 4)):
        a, b = rng.uniform(-1, 1, (2, 2)) * reach
        top = np.r_[b * 4, h * rng.uniform(1.3, 1.9)]
        parts.append(tube(smooth_curve([(*a * 0.5, 0.03), (*b, h), top], 24), 0.045, 8))
        parts.append(ball(rng.uniform(0.08, 0.25, 3), top, 14))
    return parts
