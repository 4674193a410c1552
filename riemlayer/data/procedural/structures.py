"""Buildings, bridges, and wire-like things: headphones, glasses, racks, cages, exercise machines."""

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
    hull,
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


def facade(rng: Rng, size, floors: int, columns: int) -> tuple[Parts, Parts]:
    """Recessed panes and raised sills or balconies on the four sides of a box on the ground."""
    wide, deep, tall = size
    panes, sills = [], []
    depth, share = rng.uniform(0.03, 0.09), rng.uniform(0.4, 0.65)
    sill, raised = chance(rng, 0.5), chance(rng, 0.25)
    for axis, (across, out) in enumerate(((wide, deep), (deep, wide))):
        pitch = across / columns
        for side in (-1, 1):
            for i in range(columns * floors):
                u = (i % columns + 0.5) * pitch - across / 2
                z = (i // columns + 0.55) * tall / floors
                pane = box(
                    (share * pitch, 2 * depth, share * tall / floors), (u, side * out / 2, z)
                )
                items = [(pane, sills if raised else panes)]
                if sill:
                    ledge = box(
                        (share * pitch * 1.2, 3 * depth, 0.05),
                        (u, side * out / 2, z - 0.5 * share * tall / floors),
                    )
                    items.append((ledge, sills))
                for item, group in items:
                    group.append(item.rotate((0, 0, 90.0 * axis)))
    return panes, sills


def roof(rng: Rng, wide: float, deep: float, level: float) -> Parts:
    """A gable, hip, flat with parapet, dome or spire."""
    style, over = pick(rng, "gable", "gable", "hip", "flat", "dome", "shed"), rng.uniform(1.0, 1.2)
    wide, deep, tall = wide * over, deep * over, rng.uniform(0.2, 0.8)
    base = box((wide, deep, 0.05), (0, 0, level))
    if style == "flat":
        rim = box((wide, deep, 0.2), (0, 0, level + 0.05)) - box(
            (wide - 0.14, deep - 0.14, 0.2), (0, 0, level + 0.12)
        )
        units = [
            any_box(
                rng,
                rng.uniform(0.1, 0.35, 3),
                (*(rng.uniform(-0.3, 0.3, 2) * (wide, deep)), level + 0.08),
            )
            for _ in range(3)
        ]
        return [rim, *units]
    if style == "dome":
        return [
            ball((wide / 2, deep / 2, tall), (0, 0, level), segments(rng))
            - box((9, 9, 9), (0, 0, level - 4.5))
        ]
    ridge = {"gable": wide, "hip": wide * rng.uniform(0.02, 0.6), "shed": wide}[style]
    top = box((ridge, 0.03, 0.02), (0, deep / 2 if style == "shed" else 0, level + tall))
    parts = [hull(base, top)]
    if chance(rng, 0.5):
        parts.append(box((0.14, 0.14, tall + 0.2), (wide * 0.25, 0.1, level + tall / 2 + 0.1)))
    return parts


def building(rng: Rng) -> Parts:
    """A house, tower block, castle, church or factory of one to four wings."""
    parts: Parts = []
    for index in range(rng.integers(1, 4)):
        wide, deep, tall = rng.uniform(0.5, 1.3, 3) * (1, 1, rng.uniform(0.6, 1.8))
        at = np.zeros(2) if index == 0 else rng.uniform(-0.6, 0.6, 2)
        body = box((wide, deep, tall), (0, 0, tall / 2))
        if chance(rng, 0.15):
            body = rod(wide / 2, tall, (0, 0, tall / 2), sides=segments(rng))
            wing = [body, *roof(rng, wide, wide, tall)]
        else:
            panes, sills = facade(
                rng, (wide, deep, tall), int(rng.integers(1, 5)), int(rng.integers(1, 4))
            )
            wing = [
                cut(body, panes) if chance(rng, 0.85) else body,
                *sills,
                *roof(rng, wide, deep, tall),
            ]
        if chance(rng, 0.5):
            wing.append(box((0.22, 0.2, 0.35), (rng.uniform(-0.2, 0.2) * wide, -deep / 2, 0.17)))
        parts += [move(part, *at, 0) for part in wing]
    if chance(rng, 0.3):
        parts.append(any_box(rng, (2.2, 2.0, 0.1), (0, 0, 0.0)))
    if chance(rng, 0.3):
        parts += [box((0.08, 0.08, 0.6), (x, -0.9, 0.3)) for x in np.linspace(-0.8, 0.8, 4)]
        parts += [box((1.8, 0.6, 0.08), (0, -0.7, 0.6)), box((1.9, 0.7, 0.08), (0, -0.7, 0.02))]
    return parts


def bridge(rng: Rng) -> Parts:
    """An arch bridge, gate, colonnade, stair or pier."""
    long, wide = rng.uniform(1.5, 2.6), rng.uniform(0.3, 0.8)
    style = pick(rng, "arches", "stairs", "columns")
    if style == "stairs":
        steps, rise = int(rng.integers(4, 11)), rng.uniform(0.5, 1.2)
        run = long / steps
        solid = chance(rng, 0.5)
        treads = [
            box(
                (run * 1.02, wide, (i + 1) * rise / steps if solid else 0.1),
                (i * run, 0, (i + 1) * rise / steps / 2 if solid else (i + 1) * rise / steps),
            )
            for i in range(steps)
        ]
        slope = [
            beam((0, s * wide * 0.45, 0.03), (long - run, s * wide * 0.45, rise), 0.1)
            for s in (-1, 1)
        ]
        rails = [
            beam((0, s * wide * 0.46, 0.6), (long - run, s * wide * 0.46, rise + 0.6), 0.06)
            for s in (-1, 1)
        ]
        posts = [
            box((0.06, 0.06, 0.6), (x * (long - run), s * wide * 0.46, x * rise + 0.3))
            for x in (0, 0.5, 1)
            for s in (-1, 1)
        ]
        return [*treads, *slope, *(rails + posts if chance(rng, 0.5) else [])]
    tall, count = rng.uniform(0.5, 1.0), int(rng.integers(1, 5))
    pitch = long / count
    if style == "arches":
        body = box((long, wide, tall), (0, 0, tall / 2))
        holes = []
        for x in (np.arange(count) + 0.5 - count / 2) * pitch:
            r = min(pitch * 0.38, tall * 0.75)
            arch = rod(r, 3, axis="y", sides=segments(rng))
            holes.append(
                move(hull(arch, box((2 * r, 3, 0.1), (0, 0, -1))), x, 0, max(tall - r - 0.12, 0.05))
            )
        parts = [cut(body, holes)]
        if chance(rng, 0.6):
            parts += [
                box((long, 0.08, 0.2), (0, s * (wide / 2 - 0.04), tall + 0.08)) for s in (-1, 1)
            ]
        return parts
    n, r = segments(rng), rng.uniform(0.06, 0.12)
    at = [(x, s * wide / 2) for x in np.linspace(-0.45, 0.45, count + 1) * long for s in (-1, 1)]
    parts = [rod(r, tall, (*p, tall / 2), top=r * 0.85, sides=n) for p in at]
    parts += [box((3 * r, 3 * r, 0.1), (*p, z)) for p in at for z in (0.04, tall - 0.04)]
    return [
        *parts,
        *(box((long + 0.3, wide + 0.4, 0.12), (0, 0, z)) for z in (-0.02, tall + 0.04)),
        *roof(rng, long, wide + 0.2, tall + 0.05),
    ]


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
        parts.append(tube(rim + (side * gap, 0, 0), thick, 10, True))
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
    parts: Parts = []
    flat = chance(rng, 0.4)

    def bar(a, b):
        a, b = np.asarray(a, float), np.asarray(b, float)
        side = abs(b - a)[1] > 0.9 * np.linalg.norm(b - a)
        return strut(a, b, r, sides=n) if not flat or side else beam(a, b, 1.8 * r, 1.8 * r)

    for s in (-1, 1):
        x = s * wide / 2
        lean = rng.uniform(-0.3, 0.3) * deep
        parts += [
            bar((x, -deep / 2, 0), (x, deep / 2, 0.001)),
            bar((x, lean, 0), (x, lean * 0.3, tall)),
        ]
        if chance(rng, 0.6):
            parts.append(bar((x, deep * 0.4, 0), (x, lean * 0.5, tall * rng.uniform(0.4, 0.9))))
        if chance(rng, 0.4):
            path = [
                (x, lean * 0.3, tall),
                (x, lean * 0.3 - 0.2, tall + 0.15),
                (x, lean * 0.3 - 0.5, tall + 0.05),
            ]
            parts.append(tube(smooth_curve(path, 20), r, n))
    levels = rng.uniform(0, 1, int(rng.integers(2, 7)))
    for z in [0.0, 1.0, *levels]:
        y = 0.3 * lean * z + lean * (1 - z)
        parts.append(strut((-wide / 2, y, z * tall), (wide / 2, y, z * tall), r, sides=n))
    if chance(rng, 0.5):
        z, long = tall * rng.uniform(0.3, 0.6), rng.uniform(0.6, 1.4)
        parts.append(soft_box((wide * 1.05, long, 0.12), (0, -long / 2 + lean, z), 0.05))
        parts.append(bar((0, lean - long + 0.1, z), (0.001, lean - long, 0)))
    if chance(rng, 0.35):
        span = wide * rng.uniform(0.7, 1.1)
        parts.append(strut((-span, 0.3 * lean, tall), (span, 0.3 * lean, tall), r, sides=n))
        parts += [
            rod(rng.uniform(0.15, 0.35), 0.1, (s * span * 0.9, 0.3 * lean, tall), "x")
            for s in (-1, 1)
        ]
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
