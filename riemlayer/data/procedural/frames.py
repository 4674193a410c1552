"""Wire-like things: headphones, spectacles, racks, exercise machines, signs."""

import numpy as np
from manifold3d import Manifold

from riemlayer.data.procedural.solids import (
    Rng,
    any_box,
    ball,
    beam,
    chance,
    extrude,
    move,
    pick,
    rod,
    segments,
    smooth_curve,
    soft_box,
    strut,
    tube,
)

Parts = list[Manifold]


def headphones(rng: Rng) -> Parts:
    """A head band with two cups, on thin or wide yokes."""
    r, flat = rng.uniform(0.6, 0.9), rng.uniform(0.6, 3.5)
    a = np.linspace(-0.1, np.pi + 0.1, 44)
    arch = np.stack([r * np.cos(a), 0 * a, r * rng.uniform(0.9, 1.3) * np.sin(a)], 1)
    parts = [tube(arch, rng.uniform(0.04, 0.07), 12, flat=flat)]
    if chance(rng, 0.5):
        inner = arch[8:-8] * 0.93
        parts.append(tube(inner, 0.07, 12, flat=flat * 0.8))
    size, deep, n = rng.uniform(0.22, 0.4), rng.uniform(0.12, 0.3), segments(rng)
    for s in (-1, 1):
        cup = rod(size, deep, axis="x", top=size * rng.uniform(0.7, 1), sides=n)
        if chance(rng, 0.6):
            t = np.arange(36) * np.pi / 18
            pad = tube(
                np.stack([0 * t, size * 0.8 * np.cos(t), size * 0.8 * np.sin(t)], 1), 0.09, 12, True
            )
            cup += move(pad, -0.5 * deep)
            cup -= rod(size * 0.5, 0.3, (-0.5 * deep - 0.05, 0, 0), "x", sides=n)
        cup = cup.scale((1, rng.uniform(0.75, 1), 1)).rotate((0, rng.uniform(-12, 12), 0))
        parts.append(move(cup if s > 0 else cup.mirror((1, 0, 0)), s * r * 0.97, 0, -0.15))
    if chance(rng, 0.3):
        path = smooth_curve([(r, -0.1, -0.3), (r * 0.9, -0.5, -0.4), (r * 0.5, -0.9, -0.4)], 20)
        parts += [tube(path, 0.04, 8), ball(0.08, path[-1], 12)]
    return parts


def spectacles(rng: Rng) -> Parts:
    """Glasses, goggles, handcuffs: two rims, a bridge and temples."""
    w, h, thick = rng.uniform(0.3, 0.42), rng.uniform(0.2, 0.36), rng.uniform(0.04, 0.07)
    t = np.arange(40) * np.pi / 20
    power = rng.uniform(0.5, 1)
    c, s = np.cos(t), np.sin(t)
    rim = np.stack(
        [w * np.sign(c) * np.abs(c) ** power, 0 * t, h * np.sign(s) * np.abs(s) ** power], 1
    )
    rim = smooth_curve(rim, 60, closed=True)
    gap, parts, lenses = w + rng.uniform(0.06, 0.14), [], chance(rng, 0.5)
    for side in (-1, 1):
        parts.append(tube(np.add(rim, (side * gap, 0, 0)), thick, 10, True))
        if lenses:
            parts.append(
                rod(1, 0.05, axis="y", sides=40).scale((w, 1, h)).translate((side * gap, 0, 0))
            )
        long, drop = rng.uniform(0.9, 1.3), rng.uniform(0, 0.3)
        end = side * (gap + w)
        path = [
            (end, 0, 0.1),
            (end * 1.02, 0.3, 0.12),
            (end * 0.98, long, 0.1),
            (end * 0.95, long + 0.25, -drop),
        ]
        parts.append(tube(smooth_curve(path, 30), thick * 0.9, 10, flat=rng.uniform(0.8, 1.4)))
    arch = smooth_curve(
        [(-gap + w * 0.98, 0, 0.05), (0, -0.02, 0.14), (gap - w * 0.98, 0, 0.05)], 14
    )
    return [*parts, tube(arch, thick, 10)]


def rack(rng: Rng) -> Parts:
    """Bent pipes: an exercise machine, bench, ladder, drying rack, trolley, stand, cage."""
    r, n = rng.uniform(0.035, 0.07), int(rng.integers(6, 16))
    wide, tall, deep = rng.uniform(0.5, 1.2), rng.uniform(0.7, 1.8), rng.uniform(0.5, 1.6)
    flat, lean = chance(rng, 0.4), rng.uniform(-0.3, 0.3) * deep
    top = 0.3 * lean

    def bar(a, b) -> Manifold:
        """A square or round pipe; pipes along y are always round."""
        along_y = abs(a[1] - b[1]) > 0.9 * np.linalg.norm(np.subtract(a, b))
        return beam(a, b, 1.8 * r) if flat and not along_y else strut(a, b, r, sides=n)

    parts: Parts = []
    for x in (-wide / 2, wide / 2):
        parts += [bar((x, -deep / 2, 0), (x, deep / 2, 0)), bar((x, lean, 0), (x, top, tall))]
        if chance(rng, 0.6):
            parts.append(bar((x, deep * 0.4, 0), (x, lean * 0.5, tall * rng.uniform(0.4, 0.9))))
        if chance(rng, 0.4):
            path = [(x, top, tall), (x, top - 0.2, tall + 0.15), (x, top - 0.5, tall + 0.05)]
            parts.append(tube(smooth_curve(path, 20), r, n))
    for z in [0.0, 1.0, *rng.uniform(0, 1, int(rng.integers(2, 7)))]:
        y = top * z + lean * (1 - z)
        parts.append(strut((-wide / 2, y, z * tall), (wide / 2, y, z * tall), r, sides=n))
    if chance(rng, 0.5):
        z, long = tall * rng.uniform(0.3, 0.6), rng.uniform(0.6, 1.4)
        parts.append(soft_box((wide * 1.05, long, 0.12), (0, -long / 2 + lean, z), 0.05))
        parts.append(bar((0, lean - long + 0.1, z), (0.001, lean - long, 0)))
    if chance(rng, 0.35):
        span = wide * rng.uniform(0.7, 1.1)
        parts.append(strut((-span, top, tall), (span, top, tall), r, sides=n))
        for x in (-0.9 * span, 0.9 * span):
            parts.append(rod(rng.uniform(0.15, 0.35), 0.1, (x, top, tall), "x"))
    return parts


def signpost(rng: Rng) -> Parts:
    """Plates on posts: signs, easels, monitors, fans, mirrors, flags."""
    tall, r, n = rng.uniform(0.6, 1.8), rng.uniform(0.04, 0.09), segments(rng)
    parts = [rod(r, tall, (0, 0, tall / 2), sides=n)]
    foot = rng.uniform(0.25, 0.6)
    parts.append(
        any_box(rng, (foot, foot, 0.1)) if chance(rng, 0.5) else rod(foot / 2, 0.1, sides=n)
    )
    for _ in range(rng.integers(1, 3)):
        size = (rng.uniform(0.4, 1.4), rng.uniform(0.05, 0.1), rng.uniform(0.3, 1.0))
        k = pick(rng, 3, 6, 8, 40)
        plate = (
            rod(size[2] / 2, size[1], axis="y", sides=k) if chance(rng, 0.4) else any_box(rng, size)
        )
        if chance(rng, 0.5):
            rim = plate.scale((0.85, 1, 0.85)).translate((0, -size[1] * 0.6, 0))
            plate = plate - rim if chance(rng, 0.5) else plate + rim
        plate = plate.rotate((rng.uniform(-25, 25), 0, rng.uniform(-40, 40)))
        parts.append(move(plate, rng.uniform(-0.2, 0.2), 0, tall * rng.uniform(0.75, 1)))
    if chance(rng, 0.2):
        blades = [
            extrude(np.array([(0.05, -0.05), (0.6, -0.15), (0.65, 0.12), (0.05, 0.05)]), 0.06)
            .rotate((15, 0, 0))
            .rotate((0, 0, a))
            .rotate((90, 0, 0))
            for a in (0.0, 120.0, 240.0)
        ]
        parts += [move(b, 0, -r - 0.04, tall) for b in [*blades, rod(0.12, 0.2, axis="y")]]
    return parts
