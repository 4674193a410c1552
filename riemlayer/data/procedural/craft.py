"""Planes and boats. x is forward, z up."""

import numpy as np
from manifold3d import CrossSection, Manifold

from riemlayer.data.procedural.solids import (
    Rng,
    any_box,
    ball,
    box,
    chance,
    extrude,
    hull,
    move,
    pick,
    revolve,
    rod,
    segments,
    strut,
    thin,
)

Parts = list[Manifold]


def airfoil(chord: float, thick: float) -> np.ndarray:
    """A symmetric streamlined section (n, 2)."""
    t = np.linspace(0, 1, 14)
    y = thick * (1.48 * np.sqrt(t) - 0.63 * t - 1.76 * t**2 + 1.42 * t**3 - 0.51 * t**4) + 0.012
    half = np.c_[chord * (0.5 - t), y]
    return np.r_[half, (half * (1, -1))[::-1]]


def blade(rng: Rng, span: float, root: float, tip: float, sweep: float, thick: float) -> Manifold:
    """A tapered swept wing along +y from the origin: the hull of two sections."""
    a = extrude(airfoil(root, thick), 0.02).rotate((90, 0, 0))
    b = extrude(airfoil(tip, max(thick * tip / root, 0.025)), 0.02).rotate((90, 0, 0))
    return hull(a, b.translate((-sweep, span, rng.normal(0, 0.08) * span)))


def plane(rng: Rng) -> Parts:
    """An airliner, glider, jet, biplane, rocket or drone."""
    length, r, n = rng.uniform(1.8, 2.6), rng.uniform(0.1, 0.24), segments(rng)
    span, chord = rng.uniform(0.5, 1.3), rng.uniform(0.25, 0.6)
    sweep, thick = rng.uniform(-0.05, 0.7), thin(rng, 0.022, 0.06)
    at, level = rng.uniform(-0.1, 0.2) * length, rng.uniform(-0.7, 0.8) * r
    right = blade(rng, span, chord, chord * rng.uniform(0.3, 0.9), sweep, thick)
    wings = both(right, at, level)
    if chance(rng, 0.15):
        wings += [move(wing, 0, 0, 1.6 * r) for wing in wings]
        for y in (-0.6 * span, 0.6 * span):
            wings.append(strut((at, y, level), (at, y, level + 1.6 * r), 0.03))
    small = blade(rng, span * rng.uniform(0.25, 0.4), chord * 0.5, chord * 0.3, sweep * 0.4, thick)
    fin = blade(rng, rng.uniform(0.25, 0.5), chord * 0.6, chord * 0.35, 0.2, thick)
    wings += both(small, -0.44 * length, rng.uniform(0, 0.5) * r)
    wings.append(move(fin.rotate((90, 0, 0)), -0.44 * length))
    parts = [fuselage(rng, length, r, n), *wings]
    style = pick(rng, "jet", "prop", "none")
    if style == "jet":
        for share in pick(rng, (0.35,), (0.3, 0.6)):
            parts += both(
                rod(0.09, 0.35, (0, share * span, 0), "x", 0.07, n), at + 0.1, level - 0.08
            )
    elif style == "prop":
        count = int(rng.integers(1, 4))
        turns = [box((0.04, 0.7, 0.08)).rotate((180.0 * i / count, 0, 0)) for i in range(count)]
        parts += [move(part, length / 2) for part in [*turns, ball((0.12, 0.07, 0.07))]]
    if chance(rng, 0.35):
        for x, y in ((0.35 * length, 0), (-0.05 * length, 0.2), (-0.05 * length, -0.2)):
            foot = (x, y * 1.2, -r - 0.15)
            parts += [strut((x, y, 0), foot, 0.03), rod(0.08, 0.06, foot, "y", sides=16)]
    if chance(rng, 0.5):
        parts.append(ball((0.25, r * 0.6, r * 0.7), (0.25 * length, 0, r * 0.75)))
    return parts


def both(part: Manifold, x: float, z: float) -> Parts:
    """A part and its mirror image in y, moved."""
    return [move(part, x, 0, z), move(part.mirror((0, 1, 0)), x, 0, z)]


def fuselage(rng: Rng, length: float, radius: float, sides: int) -> Manifold:
    """A body of revolution with a round nose and a tapered tail."""
    nose, end = rng.uniform(0.1, 0.3), rng.uniform(0.3, 0.55)
    x = np.linspace(0, 1, 30)
    front = np.sqrt(np.clip(1 - (1 - x / nose).clip(0) ** 2, 0.01, 1))
    back = np.where(x > 1 - end, 0.25 + 0.75 * ((1 - x) / end).clip(0, 1) ** 0.7, 1)
    outline = np.c_[radius * np.minimum(front, back), length * x]
    body = revolve(np.r_[[[0, 0]], outline, [[0, length]]], sides).rotate((0, -90, 0))
    return body.translate((length / 2, 0, 0)).scale((1, 1, rng.uniform(0.85, 1.3)))


def boat(rng: Rng) -> Parts:
    """A hull, hollow or decked, with cabins, masts, funnels."""
    length, beam, deep = rng.uniform(1.6, 2.6), rng.uniform(0.4, 0.9), rng.uniform(0.25, 0.6)
    s = np.linspace(-1, 1, 24)
    wide = (
        beam / 2 * np.clip(1 - np.abs(s) ** rng.uniform(2, 5), 0, 1) ** rng.uniform(0.5, 0.9) + 0.01
    )
    outline = np.r_[np.c_[s * length / 2, wide], np.c_[s * length / 2, -wide][::-1]][::-1]
    top = CrossSection([outline])
    hull_ = extrude(top, deep, n_divisions=8, scale_top=(1.15, 1.5))
    if chance(rng, 0.55):
        inner = top.offset(-0.06).scale((1.08, 1.35))
        return [hull_ - move(extrude(inner, deep), 0, 0, 0.09), *seats(rng, length, beam)]
    parts, level = [hull_], deep / 2
    long = length * rng.uniform(0.3, 0.6)
    for _ in range(rng.integers(1, 4)):
        tall = rng.uniform(0.1, 0.3)
        parts.append(
            any_box(rng, (long, beam * 0.7, tall), (-0.05 * length, 0, level + tall / 2 - 0.01))
        )
        level, long = level + tall - 0.02, long * rng.uniform(0.5, 0.9)
    for x in rng.uniform(-0.2, 0.2, int(rng.integers(0, 4))) * length:
        tall = rng.uniform(0.3, 1.3)
        parts.append(rod(rng.uniform(0.035, 0.1), tall, (x, 0, level + tall / 2 - 0.05), sides=12))
    if chance(rng, 0.3):
        sail = extrude(np.array([(0, 0), (0.8, 0), (0, 1.4)]), 0.05).rotate((90, 0, 0))
        parts += [move(sail, 0, 0, level - 0.05)]
    return parts


def seats(rng: Rng, length: float, beam: float) -> Parts:
    """Thwarts across an open hull."""
    return [
        box((0.15, beam * 1.05, 0.06), (x * length, 0, 0.05))
        for x in rng.uniform(-0.25, 0.25, int(rng.integers(1, 4)))
    ]
