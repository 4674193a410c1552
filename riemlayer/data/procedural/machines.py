"""Mechanical and electric things: robots, pipe networks, circuit boards, guitars."""

import numpy as np
from manifold3d import CrossSection, Manifold

from riemlayer.data.procedural.figures import rotation, unit
from riemlayer.data.procedural.outlines import star
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
    rod,
    segments,
    smooth_curve,
    strut,
    tube,
)

Parts = list[Manifold]


def robot(rng: Rng) -> Parts:
    """A robot or armoured figure of boxes, rods and joints, with two to six limbs."""
    n, parts = segments(rng), []
    body = rng.uniform(0.35, 0.7, 3) * (1.2, 0.8, 1.2)
    parts.append(any_box(rng, body, edge=0.1))
    parts.append(any_box(rng, body * (0.7, 0.7, 0.5), (0, 0, -0.6 * body[2]), 0.06))
    skull = rng.uniform(0.2, 0.4, 3)
    neck = 0.5 * body[2] + rng.uniform(0.03, 0.2)
    parts += [rod(0.1, 2 * neck, (0, 0, neck / 2), sides=n)]
    top = (0, 0, neck + skull[2] / 2)
    parts.append(ball(skull / 1.7, top, n) if chance(rng, 0.4) else any_box(rng, skull, top, 0.08))
    for s in (-1, 1):
        parts.append(rod(0.05, 0.12, (s * 0.08, -skull[1] / 2, top[2]), "y", sides=14))
        if chance(rng, 0.4):
            ear = (s * skull[0] / 2, 0, top[2])
            parts.append(strut(ear, np.add(ear, (s * 0.08, 0, 0.25)), 0.035, sides=8))
        shoulder = np.array([s * (body[0] / 2 + 0.08), 0, body[2] * 0.35])
        hip = np.array([s * body[0] * 0.28, 0, -0.85 * body[2]])
        parts += limb(rng, shoulder, s, rng.uniform(0.05, 2.4), n, pick(rng, "claw", "ball", "box"))
        parts += limb(rng, hip, s, rng.uniform(0, 0.35), n, "foot")
    if chance(rng, 0.4):
        pack = (rng.uniform(0.3, 0.6), rng.uniform(0.15, 0.3), 0.4)
        parts.append(move(any_box(rng, pack), 0, body[1] / 2 + 0.05, 0.1))
    return parts


def limb(rng: Rng, root, side: int, lift: float, sides: int, end: str) -> Parts:
    """Two bars with ball joints and a hand or foot."""
    swing = rng.normal(0, 0.4)
    aim = unit([side * np.sin(lift), np.sin(swing), -np.cos(lift)])
    bent = rotation((1, 0.2 * rng.normal(), 0), rng.uniform(0, 0.9) * (1 if end == "foot" else -1))
    long, r = rng.uniform(0.3, 0.5, 2), rng.uniform(0.07, 0.13)
    middle = root + long[0] * aim
    tip = middle + long[1] * (bent @ aim)
    parts = [ball(r * 1.4, root, 16), ball(r * 1.25, middle, 16)]
    for a, b, size in ((root, middle, r), (middle, tip, r * rng.uniform(0.9, 1.4))):
        boxy = chance(rng, 0.4) and abs((b - a)[1]) < 0.9 * np.linalg.norm(b - a)
        parts.append(beam(a, b, size * 1.7) if boxy else strut(a, b, size, size * 0.9, sides))
    if end == "foot":
        return [*parts, move(any_box(rng, (0.2, 0.36, 0.12)), *np.add(tip, (0, -0.08, -0.03)))]
    if end == "ball":
        return [*parts, ball(r * 1.5, tip, 16)]
    if end == "box":
        return [*parts, move(any_box(rng, (0.2, 0.2, 0.24)), *tip)]
    out = tip + 0.22 * (bent @ aim)
    fork = [unit(rng.normal(size=3)) * 0.1 for _ in range(3)]
    return parts + [strut(tip, out + f, 0.045, 0.035, 8) for f in fork]


def pipes(rng: Rng) -> Parts:
    """A network of straight pipes with elbows, flanges, valves and tanks."""
    r, n = rng.uniform(0.06, 0.14), segments(rng)
    at, axis = np.zeros(3), int(rng.integers(3))
    parts: Parts = [ball(r * 1.2, at, 16)]
    nodes = [at]
    for _ in range(rng.integers(3, 11)):
        axis = (axis + int(rng.integers(1, 3))) % 3
        if chance(rng, 0.25):
            at = nodes[int(rng.integers(len(nodes)))]
        end = at + rng.uniform(0.4, 1.0) * rng.choice([-1.0, 1.0]) * np.eye(3)[axis]
        length = float(np.linalg.norm(end - at))
        parts.append(rod(r, length, (at + end) / 2, "xyz"[axis], sides=n))
        parts.append(ball(r * rng.uniform(1.0, 1.5), end, 16))
        for t in rng.uniform(0.2, 0.8, int(rng.integers(0, 3))):
            ring = rod(r * rng.uniform(1.3, 1.8), rng.uniform(0.06, 0.14), sides=n)
            turned = {0: (0, 90, 0), 1: (-90, 0, 0), 2: (0, 0, 0)}[axis]
            parts.append(move(ring.rotate(turned), *(at + t * (end - at))))
        at = end
        nodes.append(end)
    for end in nodes:
        if chance(rng, 0.15):
            size = rng.uniform(0.25, 0.45)
            parts.append(rod(size, rng.uniform(0.3, 0.9), end, pick(rng, "x", "y", "z"), sides=n))
    if chance(rng, 0.4):
        bore = rod(r * 0.6, 0.5, nodes[0], "xyz"[int(rng.integers(3))], sides=n)
        parts = [cut(part, [bore]) for part in parts]
    return parts


def board(rng: Rng) -> Parts:
    """A plate crowded with parts: a circuit, keyboard, cooker, city block or control panel."""
    size = np.array([rng.uniform(1.2, 2), rng.uniform(0.6, 2), rng.uniform(0.06, 0.25)])
    parts, n = [any_box(rng, size, edge=0.05)], segments(rng)
    rows, columns = rng.integers(2, 7, 2)
    regular, deep = chance(rng, 0.4), rng.uniform(0.05, 0.8)
    holes = []
    for i in range(rows):
        for j in range(columns):
            if chance(rng, 0.25):
                continue
            pitch = size[:2] / (rows, columns)
            wide = pitch * (0.7 if regular else rng.uniform(0.3, 0.95, 2))
            tall = deep * (1 if regular else rng.uniform(0.15, 1)) + 0.05
            x, y = (np.array([i, j]) + 0.5) * pitch - size[:2] / 2
            style = (
                "box" if regular else pick(rng, "box", "box", "box", "can", "fins", "star", "hole")
            )
            z = size[2] / 2 + tall / 2 - 0.02
            if style == "box":
                parts.append(move(any_box(rng, (*wide, tall)), x, y, z))
            elif style == "can":
                parts.append(rod(min(wide) / 2, tall, (x, y, z), sides=n))
            elif style == "star":
                parts.append(move(extrude(star(rng) * min(wide) * 0.6, tall), x, y, z))
            elif style == "hole":
                holes.append(rod(min(wide) / 2, 3, (x, y, 0), sides=n))
            else:
                count = max(int(wide[0] / 0.14), 1)
                at = x + (np.arange(count) + 0.5 - count / 2) * 0.14
                parts += [box((0.06, wide[1], tall), (u, y, z)) for u in at]
    parts[0] = cut(parts[0], holes)
    return parts


def instrument(rng: Rng) -> Parts:
    """A guitar, violin, racket, paddle or mirror: a waisted hollow body, a neck, a head."""
    t = np.arange(64) * 2 * np.pi / 64
    waist, long = rng.uniform(0, 0.35), rng.uniform(0.55, 0.9)
    wide = 0.42 * (1 - waist * np.cos(2 * t) * 0 - waist * np.exp(-((np.cos(t) - 0.1) ** 2) * 18))
    outline = np.c_[long * np.cos(t), (wide - 0.06 * np.cos(t)) * np.sin(t)]
    section, deep = CrossSection([outline]), rng.uniform(0.08, 0.3)
    body = extrude(section, deep)
    parts: Parts = []
    style = pick(rng, "hollow", "racket", "solid")
    if style == "hollow" and deep > 0.19:
        body -= extrude(section.offset(-0.06), deep - 0.12)
        body -= rod(rng.uniform(0.1, 0.2), deep, (rng.uniform(-0.1, 0.25), 0, deep / 2))
    elif style == "racket":
        body -= extrude(section.offset(-0.08), 1)
        gaps = np.linspace(-0.7, 0.7, int(rng.integers(2, 7)))
        parts += [
            box((2 * long * 0.95, 0.05, 0.05), (0, 0.4 * g, 0)) ^ extrude(section, 1) for g in gaps
        ]
        parts += [box((0.05, 1, 0.05), (long * g, 0, 0)) ^ extrude(section, 1) for g in gaps]
    neck, r = rng.uniform(0.5, 1.3), rng.uniform(0.05, 0.09)
    parts += [body, box((neck + 0.3, 2 * r, 1.4 * r), (long + neck / 2 - 0.1, 0, 0))]
    head = (rng.uniform(0.2, 0.4), rng.uniform(0.12, 0.25), 0.08)
    parts.append(move(any_box(rng, head).rotate((0, rng.uniform(-5, 20), 0)), long + neck + 0.1))
    for x in np.linspace(0.02, 0.18, int(rng.integers(0, 4))):
        parts.append(rod(0.035, head[1] + 0.2, (long + neck + x, 0, 0), "y", sides=10))
    if chance(rng, 0.5):
        parts.append(box((0.1, 0.3, 0.1), (-0.4 * long, 0, deep / 2)))
        end = (long + neck * 0.9, 0, r + 0.03)
        parts.append(strut((-0.4 * long, 0, deep / 2 + 0.04), end, 0.03, sides=8))
    return parts


def hook(rng: Rng) -> Parts:
    """A hanger, hook, anchor, umbrella, ring or carabiner: a bent rod with ends."""
    r = rng.uniform(0.05, 0.12)
    style = pick(rng, "hook", "hanger", "anchor", "spiral", "umbrella")
    a = np.linspace(0, rng.uniform(2.5, 4.5), 30)
    arc = np.stack([0.4 * np.sin(a), 0 * a, 0.4 * np.cos(a)], 1)
    parts = [tube(np.r_[smooth_curve([(-1, 0, 0.4), (-0.5, 0, 0.4)], 8), arc], r, 12)]
    if style == "hook":
        parts += [rod(r * 2.5, 0.1, (-1, 0, 0.4), "x"), ball(r * 1.3, arc[-1], 14)]
    elif style == "hanger":
        low = rng.uniform(0.4, 0.8)
        corner = [(-1, 0, 0.4), (-1 - low, 1.1, 0.4), (-1 - low, -1.1, 0.4)]
        pairs = zip(corner, corner[1:] + corner[:1], strict=True)
        parts += [strut(u, v, r, sides=12) for u, v in pairs]
    elif style == "anchor":
        parts += [strut((-1, -0.5, 0.4), (-1, 0.5, 0.4), r), ball(r * 2, (-1, 0, 0.4), 16)]
        parts.append(tube(arc @ rotation((1, 0, 0), np.pi / 2).T + (-0.6, 0.4, 0.4), r, 12))
    elif style == "spiral":
        s = np.linspace(0, 1, 80)
        turn, reach = 2 * np.pi * rng.uniform(1, 2.2) * s, 0.25 + 0.6 * s
        coil = np.stack([reach * np.cos(turn) - 1.25, reach * np.sin(turn), 0.4 + 0 * s], 1)
        parts.append(tube(coil, min(r, 0.08), 12))
    else:
        k = int(rng.integers(6, 12))
        dome = ball((0.9, 0.9, rng.uniform(0.4, 0.8)), sides=4 * k)
        dome -= dome.scale((0.93, 0.93, 0.9)) + box((4, 4, 4), (0, 0, -2.0))
        parts.append(dome.rotate((0, -90, 0)).translate((-1.3, 0, 0.4)))
        parts.append(rod(r * 0.8, 1.2, (-1.5, 0, 0.4), "x", sides=12))
    return parts
