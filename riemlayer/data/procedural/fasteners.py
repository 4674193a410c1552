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
    """A threaded screw, nut, wing nut, washer, gear, pulley, hinge or flange."""
    style = pick(rng, "screw", "screw", "nut", "wing", "gear", "pulley")
    n = int(rng.integers(28, 48))
    if style == "screw":
        return screw(rng, n)
    r, tall = rng.uniform(0.4, 0.8), rng.uniform(0.25, 0.8)
    bore = rod(r * rng.uniform(0.4, 0.65), 5, sides=n)
    if style == "nut":
        return [
            rod(r, tall, sides=pick(rng, 4, 6, 6, 8, n))
            + rod(r * 1.3, 0.1, (0, 0, -tall / 2), sides=n)
            - bore
        ]
    if style == "wing":
        body = rod(r * 0.8, tall, top=r * 0.65, sides=n)
        for s in (-1, 1):
            path = smooth_curve(
                [
                    (0, 0, 0),
                    (s * 0.9 * r, 0, 0.1),
                    (s * rng.uniform(1.3, 2.2) * r, 0, rng.uniform(0.3, 1)),
                ],
                20,
            )
            body += tube(path, np.linspace(0.2, 0.34, 20) * r, 14, flat=rng.uniform(0.4, 2.2))
        return [body - bore]
    if style == "gear":
        k = int(rng.integers(8, 22))
        angle = (np.repeat(np.arange(2 * k), 2) + np.tile([-0.36, 0.36], 2 * k)) * np.pi / k
        radius = np.repeat(np.tile([1.0, 1 - 4 / k / 1.6], k), 2) * 0.9
        wheel = CrossSection([radius[:, None] * np.c_[np.cos(angle), np.sin(angle)]])
        spokes, twist = int(rng.integers(0, 6)), rng.uniform(-25, 25) * chance(rng, 0.4)
        solid = extrude(wheel, tall * 0.6, n_divisions=10, twist_degrees=twist)
        for i in range(spokes if k > 11 else 0):
            solid -= rod(
                0.12,
                3,
                (0.42 * np.cos(i * 6.283 / spokes), 0.42 * np.sin(i * 6.283 / spokes), 0),
                sides=16,
            )
        return [solid + rod(0.25, tall, sides=n) - rod(0.14, 3, sides=n)]
    profile = np.array(
        [
            (0.2, 0),
            (r, 0),
            (r, 0.1),
            (r * 0.7, 0.25),
            (r * 0.7, 0.4),
            (r, 0.55),
            (r, 0.65),
            (0.2, 0.65),
        ]
    )
    flange = revolve(profile * (1, rng.uniform(0.7, 2)), n)
    holes = int(rng.integers(0, 7))
    tools = [
        rod(0.07, 9, (0.85 * r * np.cos(a), 0.85 * r * np.sin(a), 0), sides=12)
        for a in np.arange(holes) * 6.283 / max(holes, 1)
    ]
    return [cut(flange, tools if r > 0.5 else [])]


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
