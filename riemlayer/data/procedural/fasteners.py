"""Screws, nuts, gears and pulleys."""

import numpy as np
from manifold3d import CrossSection, Manifold

from riemlayer.data.procedural.solids import (
    Rng,
    ball,
    box,
    chance,
    cut,
    extrude,
    move,
    pick,
    revolve,
    rod,
    smooth_curve,
    tube,
)

Parts = list[Manifold]


def fastener(rng: Rng) -> Parts:
    """A threaded screw, nut, wing nut, gear or pulley."""
    return pick(rng, screw, screw, nut, wing_nut, gear, pulley)(rng, int(rng.integers(28, 48)))


def nut(rng: Rng, n: int) -> Parts:
    """A square, hexagonal or round nut with a collar."""
    r, tall = rng.uniform(0.4, 0.8), rng.uniform(0.25, 0.8)
    body = rod(r, tall, sides=pick(rng, 4, 6, 6, 8, n))
    if chance(rng, 0.7):
        body += rod(r * rng.uniform(1.1, 1.4), 0.1, (0, 0, -tall / 2), sides=n)
    return [body - rod(r * rng.uniform(0.4, 0.65), 5, sides=n)]


def wing_nut(rng: Rng, n: int) -> Parts:
    """A bored cone with two wings."""
    r, tall = rng.uniform(0.4, 0.8), rng.uniform(0.25, 0.8)
    parts, flat = [rod(r * 0.8, tall, top=r * 0.65, sides=n)], rng.uniform(0.4, 2.2)
    out, up = rng.uniform(1.3, 2.2) * r, rng.uniform(0.3, 1)
    for s in (-1, 1):
        path = smooth_curve([(0, 0, 0), (s * 0.9 * r, 0, 0.1), (s * out, 0, up)], 20)
        parts.append(tube(path, np.linspace(0.2, 0.34, 20) * r, 14, flat=flat))
    bore = rod(r * rng.uniform(0.3, 0.5), 5, sides=n)
    return [cut(part, [bore]) for part in parts]


def gear(rng: Rng, n: int) -> Parts:
    """A straight or helical gear with a hub, a bore and lightening holes."""
    tall, k = rng.uniform(0.25, 0.8), int(rng.integers(8, 22))
    angle = (np.repeat(np.arange(2 * k), 2) + np.tile([-0.36, 0.36], 2 * k)) * np.pi / k
    radius = np.repeat(np.tile([1.0, 1 - 2.5 / k], k), 2) * 0.9
    section = CrossSection([radius[:, None] * np.c_[np.cos(angle), np.sin(angle)]])
    twist = rng.uniform(-25, 25) * chance(rng, 0.4)
    solid = extrude(section, tall * 0.6, n_divisions=10, twist_degrees=twist)
    count = int(rng.integers(0, 6)) if k > 11 else 0
    holes = [rod(0.12, 3, (*(0.42 * at), 0), sides=16) for at in circle(count)]
    return [cut(solid + rod(0.25, tall, sides=n), [rod(0.14, 3, sides=n), *holes])]


def pulley(rng: Rng, n: int) -> Parts:
    """A grooved wheel or flange with bolt holes."""
    r = rng.uniform(0.4, 0.8)
    height = np.array([0, 0, 0.1, 0.25, 0.4, 0.55, 0.65, 0.65]) * rng.uniform(0.7, 2)
    radius = np.array([0.2 / r, 1, 1, 0.7, 0.7, 1, 1, 0.2 / r]) * r
    holes = [
        rod(0.07, 9, (*(0.85 * r * at), 0), sides=12) for at in circle(int(rng.integers(0, 7)))
    ]
    return [cut(revolve(np.c_[radius, height], n), holes if r > 0.5 else [])]


def circle(count: int) -> np.ndarray:
    """Points (count, 2), evenly spread on the unit circle."""
    angle = np.arange(count) * 2 * np.pi / max(count, 1)
    return np.c_[np.cos(angle), np.sin(angle)]


def screw(rng: Rng, n: int) -> Parts:
    """A screw: an off-centre section twisted along z makes the thread."""
    r, long, turns = rng.uniform(0.16, 0.3), rng.uniform(0.8, 2.0), rng.uniform(3, 7)
    section = CrossSection.circle(r, n).translate((rng.uniform(0.12, 0.25) * r, 0))
    tip = rng.uniform(0.5, 1.0)
    steps = int(turns * 14)
    shaft = extrude(
        section, long, n_divisions=steps, twist_degrees=360 * turns, scale_top=(tip, tip)
    )
    head = pick(rng, "hex", "dome", "flat", "ring")
    wide, tall = r * rng.uniform(1.6, 2.4), rng.uniform(0.12, 0.35)
    if head == "ring":
        t = np.arange(32) * np.pi / 16
        eye = np.stack([wide * np.cos(t), 0 * t, wide * np.sin(t)], 1)
        return [shaft, move(tube(eye, r * 0.6, 12, True), 0, 0, -long / 2 - wide)]
    if head == "dome":
        cap = ball((wide, wide, tall * 1.3), sides=n) - box((4, 4, 4), (0, 0, 2))
    else:
        cap = rod(
            wide,
            tall,
            (0, 0, -tall / 2),
            sides=6 if head == "hex" else n,
            top=wide if head == "hex" else r,
        )
    if chance(rng, 0.6):
        cap -= box((3, 0.1, tall), (0, 0, -1.3 * tall if head == "dome" else -tall))
    return [shaft, move(cap, 0, 0, -long / 2 + 0.02)]
