"""Buildings, bridges, stairs and colonnades."""

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
    hull,
    move,
    pick,
    rod,
    segments,
    thin,
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
        x, y = rng.uniform(-0.6, 0.6, 2) * (index > 0)
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
        parts += [move(part, x, y) for part in wing]
    if chance(rng, 0.3):
        parts.append(any_box(rng, (2.2, 2.0, 0.1), (0, 0, 0.0)))
    if chance(rng, 0.3):
        parts += [box((0.08, 0.08, 0.6), (x, -0.9, 0.3)) for x in np.linspace(-0.8, 0.8, 4)]
        parts += [box((1.8, 0.6, 0.08), (0, -0.7, 0.6)), box((1.9, 0.7, 0.08), (0, -0.7, 0.02))]
    return parts


def bridge(rng: Rng) -> Parts:
    """An arch bridge, gate, colonnade, stair or pier."""
    return pick(rng, arches, stairs, colonnade)(rng, rng.uniform(1.5, 2.6), rng.uniform(0.3, 0.8))


def stairs(rng: Rng, long: float, wide: float) -> Parts:
    """Solid or open steps on two beams, sometimes with rails."""
    steps, rise, solid = int(rng.integers(4, 11)), rng.uniform(0.5, 1.2), chance(rng, 0.5)
    run, parts = long / steps, []
    for i in range(steps):
        z = (i + 1) * rise / steps
        size = (run * 1.02, wide, z if solid else 0.1)
        parts.append(box(size, (i * run, 0, z / 2 if solid else z)))
    railed = chance(rng, 0.5)
    for y in (-0.455 * wide, 0.455 * wide):
        parts.append(beam((0, y, 0.03), (long - run, y, rise), 0.1))
        if railed:
            parts.append(beam((0, y, 0.6), (long - run, y, rise + 0.6), 0.06))
            at = [(t * (long - run), y, t * rise + 0.3) for t in (0, 0.5, 1)]
            parts += [box((0.06, 0.06, 0.6), x) for x in at]
    return parts


def arches(rng: Rng, long: float, wide: float) -> Parts:
    """A wall with arches, with or without parapets."""
    tall, count = rng.uniform(0.5, 1.0), int(rng.integers(1, 5))
    pitch, n = long / count, segments(rng)
    r = min(pitch * 0.38, tall * 0.75)
    hole = hull(rod(r, 3, axis="y", sides=n), box((2 * r, 3, 0.1), (0, 0, -1)))
    level = max(tall - r - 0.12, 0.05)
    holes = [move(hole, (i + 0.5 - count / 2) * pitch, 0, level) for i in range(count)]
    parts = [cut(box((long, wide, tall), (0, 0, tall / 2)), holes)]
    if chance(rng, 0.6):
        y = wide / 2 - 0.04
        parts += [box((long, 0.08, 0.2), (0, s * y, tall + 0.08)) for s in (-1, 1)]
    return parts


def colonnade(rng: Rng, long: float, wide: float) -> Parts:
    """Two rows of columns between a floor and a roof."""
    tall, count, n, r = (
        rng.uniform(0.5, 1),
        int(rng.integers(2, 6)),
        segments(rng),
        thin(rng, 0.05, 0.12),
    )
    parts = []
    for x in np.linspace(-0.45, 0.45, count) * long:
        for y in (-wide / 2, wide / 2):
            parts.append(rod(r, tall, (x, y, tall / 2), top=r * 0.85, sides=n))
            parts += [box((3 * r, 3 * r, 0.1), (x, y, z)) for z in (0.04, tall - 0.04)]
    slabs = [box((long + 0.3, wide + 0.4, 0.12), (0, 0, z)) for z in (-0.02, tall + 0.04)]
    return [*parts, *slabs, *roof(rng, long, wide + 0.2, tall + 0.05)]
