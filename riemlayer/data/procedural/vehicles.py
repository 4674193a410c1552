"""Vehicles on wheels: cars, trucks, trains, two-wheelers. x is forward, z up."""

import numpy as np
from manifold3d import Manifold

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
    revolve,
    rod,
    segments,
    smooth_curve,
    soft_box,
    strut,
    tube,
)

Parts = list[Manifold]


def wheel(rng: Rng, radius: float, width: float, sides: int) -> Manifold:
    """A wheel about the y axis: a tyre with a sunk or raised hub."""
    tyre = rod(radius, width, axis="y", sides=sides)
    if chance(rng, 0.4):
        tyre = move(revolve(rounded(radius, width), max(sides, 12)), 0, 0, -width / 2).rotate(
            (90, 0, 0)
        )
    style = pick(rng, "plain", "hub", "dish")
    if style == "hub":
        return tyre + rod(radius * 0.4, width * 1.3, axis="y", sides=sides)
    if style == "dish":
        dish = rod(radius * 0.65, width * 0.4, axis="y", sides=sides)
        return tyre - move(dish, 0, width / 2, 0) - move(dish, 0, -width / 2, 0)
    return tyre


def rounded(radius: float, width: float) -> np.ndarray:
    """The half section (n, 2) of a disc with round shoulders."""
    t = np.linspace(-np.pi / 2, np.pi / 2, 9)
    r = 0.35 * width
    rim = np.c_[radius - r + r * np.cos(t), width / 2 + (width / 2) * np.sin(t)]
    return np.r_[[[0, 0]], rim, [[0, width]]]


def wheels(rng: Rng, at, track: float, radius: float) -> Parts:
    """Pairs of wheels at stations along x, with axles."""
    width, n, parts = rng.uniform(0.12, 0.3), segments(rng), []
    for x in at:
        parts.append(rod(radius * 0.25, track, (x, 0, radius), "y", sides=12))
        parts += [move(wheel(rng, radius, width, n), x, s * track / 2, radius) for s in (-1, 1)]
    return parts


def cabin(rng: Rng, length: float, width: float, height: float) -> Manifold:
    """A car's upper body: an extruded or tapered side view."""
    lean = rng.uniform(0, 0.35, 2) * length
    side = np.array(
        [
            (-length / 2, 0),
            (length / 2, 0),
            (length / 2 - lean[0], height),
            (-length / 2 + lean[1], height),
        ]
    )
    base = extrude(side, width).rotate((90, 0, 0))
    low, high = np.reshape(base.bounding_box(), (2, 3))
    top = box(
        (length - lean.sum(), width * rng.uniform(0.7, 1), 0.02), (high[0] + low[0], 0, height)
    )
    return (
        hull(base.scale((1, 1, 0.1)), move(top, (lean[1] - lean[0]) / 2))
        if chance(rng, 0.6)
        else base
    )


def car(rng: Rng) -> Parts:
    """A car, van, bus, pick-up, truck or toy."""
    length, width = rng.uniform(1.6, 3.0), rng.uniform(0.8, 1.1)
    radius, body = rng.uniform(0.17, 0.34), rng.uniform(0.22, 0.5)
    base = radius * rng.uniform(0.6, 1.1)
    hood = any_box(rng, (length, width, body), (0, 0, base + body / 2), rng.uniform(0.04, 0.15))
    style = pick(rng, "car", "car", "van", "truck", "pickup", "open")
    top = base + body - 0.02
    if style == "pickup":
        hood -= box((length * 0.35, width * 0.8, body), (-length * 0.28, 0, base + body * 0.8))
    elif style == "open":
        hood -= box((length * 0.4, width * 0.75, body), (-0.05 * length, 0, base + body * 0.75))
    axles = np.array([-0.32, 0.32]) * length
    if style == "truck" and chance(rng, 0.5):
        axles = np.array([-0.36, -0.2, 0.34]) * length
    if chance(rng, 0.5):
        arch = rod(radius * 1.2, width * 0.35, axis="y")
        hood = cut(hood, [move(arch, x, s * width / 2, radius) for x in axles for s in (-1, 1)])
    upper = [move(part, 0, 0, top) for part in coachwork(rng, style, length, width)]
    trim = [move(part, 0, 0, top) for part in trimmings(rng, length, width, body)]
    return [hood, *upper, *trim, *wheels(rng, axles, width * rng.uniform(0.8, 1.0), radius)]


def coachwork(rng: Rng, style: str, length: float, width: float) -> Parts:
    """What stands on a car's body, z = 0: a cabin, a load, seats."""
    if style in ("car", "van"):
        van = style == "van"
        share, tall = rng.uniform(0.75, 0.98) if van else rng.uniform(0.45, 0.65), 0.35 + 0.35 * van
        roof = cabin(rng, length * share, width * 0.95, tall * rng.uniform(0.7, 1.3))
        return [move(windows(rng, roof), rng.uniform(-0.15, 0.1) * length)]
    if style == "pickup":
        return [move(cabin(rng, length * 0.35, width * 0.95, 0.4), length * 0.1)]
    if style == "open":
        seat = (0.15, width * 0.3, 0.4)
        return [soft_box(seat, (-0.15 * length, s * 0.2, 0), 0.06) for s in (-1, 1)]
    cab = any_box(rng, (length * 0.25, width, rng.uniform(0.4, 0.8)), edge=0.08)
    size = rng.uniform((0.5, 0.9, 0.3), (0.68, 1.15, 1.0)) * (length, width, 1)
    tank = rod(size[1] / 2, size[0], axis="x", sides=segments(rng))
    load = tank if chance(rng, 0.3) else any_box(rng, size)
    return [move(cab, length * 0.36, 0, 0.2), move(load, -length * 0.14, 0, size[2] / 2)]


def trimmings(rng: Rng, length: float, width: float, body: float) -> Parts:
    """Lamps, mirrors, bumpers and a spoiler; z = 0 is the top of the car's body."""
    parts: Parts = []
    for s in (-1, 1):
        if chance(rng, 0.6):
            at = (length / 2, s * width * 0.33, -body * 0.4)
            parts.append(rod(0.08, 0.08, at, "x", sides=16))
        if chance(rng, 0.4):
            at = (length * 0.18, s * (width / 2 + 0.05), 0.02)
            parts.append(any_box(rng, (0.06, 0.16, 0.1), at))
        if chance(rng, 0.6):
            at = (s * length / 2, 0, 0.06 - body)
            parts.append(any_box(rng, (0.12, width * 1.02, 0.1), at))
    if chance(rng, 0.2):
        parts.append(box((0.25, width * 1.1, 0.05), (-length / 2 + 0.1, 0, 0.2)))
        parts.append(box((0.08, width * 0.7, 0.25), (-length / 2 + 0.1, 0, 0.08)))
    return parts


def windows(rng: Rng, roof: Manifold) -> Manifold:
    """A cabin with shallow window recesses on its sides."""
    if chance(rng, 0.4):
        return roof
    low, high = np.reshape(roof.bounding_box(), (2, 3))
    size, count = high - low, int(rng.integers(1, 5))
    panes = [
        box(
            (0.6 * size[0] / count, 0.08, 0.45 * size[2]),
            (low[0] + (0.2 + 0.6 * (i + 0.5) / count) * size[0], y, low[2] + 0.6 * size[2]),
        )
        for i in range(count)
        for y in (low[1], high[1])
    ]
    return cut(roof, panes)


def train(rng: Rng) -> Parts:
    """A locomotive or a tractor: a boiler, a cab, a chimney, many wheels."""
    length, width, n = rng.uniform(1.4, 2.4), rng.uniform(0.6, 0.9), segments(rng)
    r = width * rng.uniform(0.35, 0.5)
    base = rng.uniform(0.25, 0.4)
    parts = [any_box(rng, (length, width, 0.18), (0, 0, base))]
    parts.append(rod(r, length * 0.62, (length * 0.17, 0, base + r), "x", sides=n))
    cab = any_box(rng, (length * 0.3, width, 2.2 * r), (-length * 0.33, 0, base + 1.1 * r))
    if chance(rng, 0.6):
        cab -= box((length * 0.16, 2, 0.7 * r), (-length * 0.33, 0, base + 1.5 * r))
        if chance(rng, 0.5):
            cab -= box(
                (length * 0.3 - 0.14, width - 0.14, 1.9 * r), (-length * 0.33, 0, base + 1.0 * r)
            )
    roof = any_box(rng, (length * 0.36, width * 1.15, 0.08), (-length * 0.33, 0, base + 2.2 * r))
    parts += [cab, roof]
    for x in rng.uniform(0.0, 0.45, int(rng.integers(1, 4))) * length:
        tall = rng.uniform(0.1, 0.4)
        pipe = rod(rng.uniform(0.06, 0.12), tall + r, top=rng.uniform(0.06, 0.2), sides=n)
        parts.append(move(pipe, x, 0, base + r + (tall + r) / 2))
    count = int(rng.integers(2, 5))
    parts += wheels(
        rng,
        np.linspace(-0.4, 0.4, count) * length,
        width * 0.9,
        min(0.45 * length / count, base * 0.9),
    )
    if chance(rng, 0.5):
        parts.append(
            hull(
                box((0.02, width, 0.2), (length / 2, 0, base)),
                box((0.2, width * 0.4, 0.05), (length / 2 + 0.1, 0, base * 0.5)),
            )
        )
    return parts


def two_wheeler(rng: Rng) -> Parts:
    """A bicycle, motorcycle or scooter with spoked or solid wheels."""
    r, base, bar = rng.uniform(0.3, 0.5), rng.uniform(1.0, 1.5), rng.uniform(0.035, 0.06)
    heavy = chance(rng, 0.45)
    parts = [move(part, x) for x in (-base / 2, base / 2) for part in spoked(rng, r, heavy)]
    crank, saddle = np.array([-0.1, 0, r * 0.9]), np.array([-0.3 * base, 0, 2 * r])
    saddle[2] += rng.uniform(0, 0.4)
    steer = np.array([0.35 * base, 0, 2 * r + rng.uniform(0.1, 0.4)])
    rear, front = np.array([-base / 2, 0, r]), np.array([base / 2, 0, r])
    high, low = steer * (1, 1, 0.9), steer * (1, 1, 0.85)
    parts += [
        strut(a, b, bar * 1.1, sides=10) for a, b in ((crank, saddle), (crank, low), (saddle, high))
    ]
    gap = np.array([0, 0.13, 0])
    for a, b in ((rear, crank), (rear, saddle), (front, steer)):
        parts += [strut(a + s * gap, b + s * gap * 0.6, bar, sides=10) for s in (-1, 1)]
        parts += [strut(x - gap, x + gap, bar * 1.1, sides=10) for x in (a, b)]
    parts.append(soft_box((0.35, 0.2, 0.1), np.add(saddle, (0, 0, 0.04)), 0.05))
    s, grip = np.linspace(-1, 1, 9), rng.uniform(0.2, 0.4)
    bars = steer + np.c_[0.1 - 0.2 * s**2, s * grip, 0.05 + 0.1 * abs(s)]
    parts += [tube(smooth_curve(bars, 24), bar, 10), strut(steer, bars[4], bar)]
    if heavy:
        parts.append(any_box(rng, (0.45 * base, 0.28, 0.3), (0, 0, r * 1.2), 0.08))
        parts.append(ball((0.3, 0.17, 0.16), (0.08, 0, 2 * r)))
        if chance(rng, 0.6):
            parts.append(strut((-0.5 * base, 0.17, r), (0.1, 0.17, r * 0.8), 0.07))
    return parts


def spoked(rng: Rng, radius: float, heavy: bool) -> Parts:
    """A wheel in the plane y = 0 that stands on z = 0: a tyre, a hub, spokes or a disc."""
    n, count = int(rng.integers(20, 44)), int(rng.integers(3, 9))
    thick = rng.uniform(0.09, 0.14) if heavy else rng.uniform(0.035, 0.05)
    t = np.arange(n) * 2 * np.pi / n
    rim = np.stack([radius * np.cos(t), 0 * t, radius + radius * np.sin(t)], 1)
    centre = (0, 0, radius)
    parts = [tube(rim, thick, 10, closed=True), rod(0.09, 0.2, centre, "y", sides=16)]
    if heavy and chance(rng, 0.6):
        return [*parts, rod(radius * 0.95, 0.06, centre, "y")]
    angle = np.arange(count) * 2 * np.pi / count + rng.uniform(0, 3)
    ends = [(radius * np.cos(a), 0, radius + radius * np.sin(a)) for a in angle]
    return parts + [strut(centre, end, 0.03, sides=8) for end in ends]
