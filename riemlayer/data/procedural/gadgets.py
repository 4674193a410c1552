"""Hand-sized things: remotes, cameras, phones, boxes with buttons, bulbs, binoculars, shoes."""

import numpy as np
from manifold3d import CrossSection, Manifold

from riemlayer.data.procedural.sculpture import Sculpture
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
    rod,
    segments,
    smooth_curve,
    soft_box,
    thin,
    tube,
    union,
)

Parts = list[Manifold]


def case(rng: Rng, size) -> Manifold:
    """A body: a box with some edge style, a rounded plate, a tapered or lens-shaped bar."""
    style = pick(rng, "box", "box", "plate", "taper", "pillow")
    if style == "box":
        return any_box(rng, size, edge=rng.uniform(0.03, 0.3) * min(size))
    if style == "plate":
        corner = rng.uniform(0.2, 0.49) * min(size[:2])
        flat = CrossSection.square((size[0] - 2 * corner, size[1] - 2 * corner), True)
        return extrude(flat.offset(corner), size[2])
    if style == "taper":
        small = rng.uniform(0.6, 1.0, 3) * size
        return hull(
            any_box(rng, (0.3 * size[0], *size[1:]), (-0.35 * size[0], 0, 0)),
            any_box(rng, (0.3 * size[0], *small[1:]), (0.35 * size[0], 0, 0)),
        )
    return hull(
        ball((*(0.5 * np.asarray(size[:2])), 0.25 * size[2]), (0, 0, 0.2 * size[2])),
        extrude(CrossSection.circle(0.5, 40).scale(tuple(size[:2])), 0.5 * size[2]),
    )


def keys(rng: Rng, size, top: float) -> tuple[Parts, Parts]:
    """Raised buttons and sunk ones on the top face, in rows and columns."""
    rows, columns = int(rng.integers(1, 7)), int(rng.integers(1, 5))
    pitch = np.array([0.85 * size[0] / rows, 0.8 * size[1] / columns])
    share, round_, raised = rng.uniform(0.4, 0.8), chance(rng, 0.4), chance(rng, 0.7)
    up, down = [], []
    tall = rng.uniform(0.04, 0.1)
    for i in range(rows):
        for j in range(columns):
            if chance(rng, 0.15):
                continue
            at = ((i + 0.5 - rows / 2) * pitch[0], (j + 0.5 - columns / 2) * pitch[1], top)
            wide = share * pitch
            key = (
                rod(min(wide) / 2, tall * 2, at, sides=20)
                if round_
                else any_box(rng, (*wide, tall * 2), at, 0.03)
            )
            (up if raised else down).append(key)
    return up, down


def gadget(rng: Rng) -> Parts:
    """A remote, phone, camera, radio, console or clock."""
    size = np.array([rng.uniform(0.8, 2.2), rng.uniform(0.4, 1.2), rng.uniform(0.15, 0.7)])
    body, top = case(rng, size), size[2] / 2
    parts, holes = keys(rng, size, top * 0.98) if chance(rng, 0.65) else ([], [])
    x = rng.uniform(-0.2, 0.2, 2) * size[0]
    if chance(rng, 0.4):
        screen = (size[0] * rng.uniform(0.3, 0.6), size[1] * rng.uniform(0.5, 0.85), 0.1)
        holes.append(move(any_box(rng, screen), x[0], 0, top))
    if chance(rng, 0.45):
        parts += [move(part, x[1], 0, top - 0.02) for part in lens(rng, size)]
    for _ in range(rng.integers(0, 4)):
        at = (rng.uniform(-0.4, 0.4), pick(rng, -0.5, 0.5), rng.uniform(-0.2, 0.2)) * size
        knob = rod(rng.uniform(0.04, 0.15), 0.24, at, "y", sides=segments(rng))
        (parts if chance(rng, 0.7) else holes).append(knob)
    if chance(rng, 0.25):
        loop = smooth_curve([(-0.4, 0, 0), (-0.35, 0.3, 0), (0.35, 0.3, 0), (0.4, 0, 0)], 24)
        parts.append(move(tube(loop, 0.06), 0, size[1] / 2 - 0.02))
    if chance(rng, 0.2):
        tall = rng.uniform(0.3, 1)
        aerial = rod(0.04, tall, (size[0] * 0.45, 0, tall / 2), sides=10)
        parts.append(aerial.rotate((0, rng.uniform(0, 80), 0)))
    if chance(rng, 0.2):
        slot = (0.03, 0.6 * size[1], 0.16)
        holes += [box(slot, (u, 0, -top)) for u in np.linspace(-0.3, 0.3, 6) * size[0]]
    return [cut(body, holes), *parts]


def lens(rng: Rng, size) -> Parts:
    """A stack of rings about z, bored at the end."""
    r, n, parts, z = min(size[:2]) * rng.uniform(0.25, 0.45), segments(rng), [], 0.0
    for _ in range(rng.integers(1, 4)):
        tall = rng.uniform(0.06, 0.35)
        parts.append(rod(r, tall, (0, 0, z + tall / 2 - 0.01), sides=n))
        z, r = z + tall - 0.02, r * rng.uniform(0.75, 0.97)
    if chance(rng, 0.7):
        parts = [union(parts) - rod(r * 0.7, 0.14, (0, 0, z), sides=n)]
    return parts


def appliance(rng: Rng) -> Parts:
    """A stacked round thing: bulb, torch, blender, microphone, binoculars, candle, trophy."""
    n, z, parts = segments(rng), 0.0, []
    r = rng.uniform(0.2, 0.5)
    for _ in range(rng.integers(2, 7)):
        style, tall = pick(rng, "rod", "cone", "ball", "ring"), rng.uniform(0.1, 0.8)
        after = np.clip(r * rng.uniform(0.6, 1.5), 0.08, 0.7)
        if style == "ball":
            parts.append(ball((after, after, tall / 2 + 0.05), (0, 0, z + tall / 2), n))
        elif style == "ring":
            tall = rng.uniform(0.06, 0.15)
            parts.append(rod(after * 1.15, tall, (0, 0, z + tall / 2), sides=n))
        else:
            parts.append(
                rod(r, tall, (0, 0, z + tall / 2), top=after if style == "cone" else r, sides=n)
            )
        z, r = z + tall - 0.015, after
    if chance(rng, 0.3):
        groove = rng.uniform(0.1, 0.9, 3) * z
        radii = [np.ptp(section_ends(parts, z)) / 2 for z in groove]
        rings = [tube(circle(r, z), 0.035, 8, True) for r, z in zip(radii, groove, strict=True)]
        parts += rings
    if chance(rng, 0.3):
        turn = pick(rng, 2, 2, 3)
        gap = max(
            np.ptp(np.reshape(union(parts).bounding_box(), (2, 3))[:, 0]) * rng.uniform(0.75, 1.1),
            0.3,
        )
        twin = [part for i in range(turn) for part in (move(p, i * gap) for p in parts)]
        bridge = any_box(
            rng,
            (gap * (turn - 1), 0.14, 0.25 * z),
            ((turn - 1) * gap / 2, 0, rng.uniform(0.2, 0.8) * z),
        )
        return [*twin, bridge]
    if chance(rng, 0.25):
        path = [(0, 0, 0.1 * z), (0.9, 0, 0.2 * z), (0.9, 0, 0.8 * z), (0, 0, 0.85 * z)]
        parts.append(tube(smooth_curve(path, 30), 0.06, 10))
    return parts


def circle(radius: float, z: float) -> np.ndarray:
    """A closed polygon (36, 3) about the z axis."""
    t = np.arange(36) * np.pi / 18
    return np.stack([radius * np.cos(t), radius * np.sin(t), 0 * t + z], 1)


def section_ends(parts: Parts, z: float) -> np.ndarray:
    """The x coordinates of the section of stacked parts at a height."""
    polygons = union(parts).slice(float(z)).to_polygons()
    return np.concatenate(polygons)[:, 0] if polygons else np.array([-0.3, 0.3])


def shoe(rng: Rng) -> Sculpture:
    """A shoe or boot: a foot-shaped shell, open at the ankle, with a sole and laces."""
    clay = Sculpture(rng.uniform(0.05, 0.12))
    tall, r, toe = rng.uniform(0.25, 1.3), rng.uniform(0.24, 0.34), rng.uniform(0.2, 0.34)
    wall = thin(rng, 0.035, 0.09)
    lean = rng.uniform(-0.05, 0.15)
    ankle = np.array([0, lean, tall])
    bones = [
        ((0, 0, 0.1), (0, -1.1, 0.0), r, toe),
        ((0, 0, 0.15), ankle, r, r * rng.uniform(0.9, 1.2)),
    ]
    for a, b, ra, rb in bones:
        clay.cone(a, b, ra, rb)
    clay.block((0, -0.5, -0.62), (0.6, 1.2, 0.4), removes=True, blend=0.02)
    sole = rng.uniform(0.06, 0.14)
    clay.ball((0, -0.95, -0.2), (toe * 1.15, 0.45, sole), blend=0.03)
    clay.block((0, -0.45, -0.2), (r * 0.9, 0.6, sole), round_=0.05, blend=0.03)
    if chance(rng, 0.4):
        clay.block((0, 0.0, -0.35), (r * 0.7, 0.2, rng.uniform(0.1, 0.3)), round_=0.04, blend=0.02)
    for s in np.linspace(0.15, 0.85, int(rng.integers(0, 6))):
        at = np.array([0, -0.75 + 0.5 * s, 0.15 + 0.35 * s * min(tall, 0.8)])
        clay.cone(at - (0.16, 0, 0), np.add(at, (0.16, 0, 0)), 0.05, blend=0.02)
    for a, b, ra, rb in bones:
        b = np.add(b, (0, 0, rb + 0.1)) if b is ankle else np.asarray(b)
        clay.cone(a, b, ra - wall, rb - wall, removes=True, blend=0.02)
    clay.block(np.add(ankle, (0, 0, r + 0.02)), (1, 1, r), removes=True, blend=0.01)
    if chance(rng, 0.5):
        clay.roughen(rng, rng.uniform(0.005, 0.012), rng.uniform(0.15, 0.5))
    return clay


def tray(rng: Rng) -> Parts:
    """A box, crate, tray or sink: a hollow box with walls, divisions, lid, handles, feet."""
    size = np.array([rng.uniform(0.7, 2.0), rng.uniform(0.5, 1.3), rng.uniform(0.15, 1.3)])
    wall = thin(rng, 0.02, 0.1) * size.max() / 2
    body = any_box(rng, size, edge=0.1)
    hollow = soft_box if chance(rng, 0.4) else box
    body -= hollow(size - (2 * wall, 2 * wall, 0), (0, 0, wall))
    parts = [body]
    for x in rng.uniform(-0.35, 0.35, int(rng.integers(0, 3))) * size[0]:
        parts.append(box((wall, size[1] - wall, size[2] * 0.8), (x, 0, -0.07 * size[2])))
    if chance(rng, 0.4):
        slots = [
            box((0.1, 3, 0.25 * size[2]), (x, 0, 0.1 * size[2]))
            for x in np.linspace(-0.35, 0.35, 4) * size[0]
        ]
        parts[0] = cut(parts[0], slots)
    if chance(rng, 0.4):
        lid = any_box(rng, (size[0] * 1.02, size[1] * 1.02, wall), (0, size[1] / 2, 0), 0.03)
        turn = rng.uniform(-130, 0)
        lid = lid.rotate((-turn, 0, 0)).translate((0, -size[1] / 2, size[2] / 2 - 0.01))
        parts.append(lid)
    if chance(rng, 0.4):
        loop = smooth_curve([(-0.25, 0, 0), (-0.2, 0.2, 0), (0.2, 0.2, 0), (0.25, 0, 0)], 20)
        parts += [
            move(tube(loop * (1, s, 1), 0.05, 10), 0, s * (size[1] / 2 - 0.02), 0.1)
            for s in (-1, 1)
        ]
    return parts
