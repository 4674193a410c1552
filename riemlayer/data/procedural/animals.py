"""Animals as smooth limbs: quadrupeds, birds and fish.

x is left to right, -y forward, z up.
"""

import numpy as np

from riemlayer.data.procedural.figures import facing, rotation, unit
from riemlayer.data.procedural.sculpture import Sculpture
from riemlayer.data.procedural.solids import (
    Rng,
    chance,
    pick,
    smooth_curve,
)


def quadruped(rng: Rng) -> Sculpture:
    """A dog, cat, horse, cow, elephant, lizard or dinosaur-like animal in some pose."""
    clay = Sculpture(rng.uniform(0.04, 0.12))
    length, girth, tall = rng.uniform(0.5, 1.0), rng.uniform(0.13, 0.34), rng.uniform(0.3, 0.9)
    pitch = pick(rng, 0.0, 0.0, 0.0, rng.uniform(-0.3, 0.3), rng.uniform(0.5, 1.2))
    sway = rng.normal(0, 0.2)
    frame = rotation((1, 0, 0), -pitch)
    hips = np.zeros(3)
    chest = frame @ rotation((0, 0, 1), sway) @ np.array([0, -length, 0])
    middle = (hips + chest) / 2 + (0, 0, rng.normal(0, 0.05))
    clay.chain([hips, middle, chest], girth * rng.uniform([0.8, 0.75, 0.85], [1.1, 1.2, 1.3]))
    for s in (-1, 1):
        for root, knee_side in ((hips, 1), (chest, -1)):
            free = rng.normal(0, 0.35) + (pitch if root is chest else 0.0)
            hoof(rng, clay, root, s, girth, tall, free, knee_side)
    skull = snout(rng, clay, chest, girth, frame)
    tail(rng, clay, np.add(hips, (0, girth * 0.7, 0)), girth)
    if chance(rng, 0.1):
        back = [
            np.add(hips, (0, 0, girth)),
            np.add(middle, (0, 0, girth * 1.3)),
            np.add(chest, (0, 0, girth)),
        ]
        for at in smooth_curve(back, int(rng.integers(4, 9))):
            clay.cone(at, np.add(at, (0, 0.05, rng.uniform(0.1, 0.25))), 0.05, 0.02, blend=0.02)
    if chance(rng, 0.15):
        clay.ball((chest + skull) / 2, girth * rng.uniform(1.1, 1.5))
    if chance(rng, 0.4):
        clay.roughen(rng, rng.uniform(0.004, 0.02), rng.uniform(0.06, 0.35))
    return clay


def hoof(rng, clay, root, side, girth, tall, swing, knee_side) -> None:
    """A leg of two or three bones with a foot."""
    r = rng.uniform(0.2, 0.38) * girth + 0.02
    hip = root + np.array([side * girth * 0.65, 0, -girth * 0.3])
    down = rotation((1, 0, 0), swing) @ np.array([side * rng.uniform(0, 0.15), 0, -1.0])
    bend = rng.uniform(0.1, 0.5) * knee_side
    knee = hip + 0.5 * tall * (rotation((1, 0, 0), -bend) @ down)
    ankle = knee + 0.5 * tall * (rotation((1, 0, 0), bend) @ down)
    clay.chain([hip, knee, ankle], [r * 1.7, r * 1.05, r * 0.85])
    clay.ball(
        np.add(ankle, (0, -0.6 * r, 0)),
        np.array([1.1, 1.5, 0.8]) * r * rng.uniform(0.9, 1.3),
        blend=0.03,
    )


def snout(rng: Rng, clay: Sculpture, chest, girth: float, frame) -> np.ndarray:
    """Neck, head, muzzle or trunk, ears, horns; returns the head's centre."""
    lift, reach = rng.uniform(-0.2, 1.3), rng.uniform(0.15, 0.8)
    ahead = np.array([rng.normal(0, 0.2), -np.cos(lift), np.sin(lift)])
    skull = chest + (girth * 0.8 + reach) * unit(frame @ ahead)
    size = girth * rng.uniform(0.55, 1.0)
    clay.cone(chest + girth * 0.4 * unit(ahead), skull, girth * 0.7, size * 0.65)
    clay.ball(skull, size * np.array([0.9, 1.05, 0.95]))
    look = unit([rng.normal(0, 0.25), -1, rng.uniform(-0.6, 0.1)])
    long = rng.uniform(0.5, 1.8) * size
    tip = skull + (0.6 * size + long) * look
    clay.cone(skull + 0.5 * size * look, tip, size * 0.6, size * rng.uniform(0.25, 0.5))
    if chance(rng, 0.3):
        jaw = unit(np.add(look, (0, 0, -0.5)))
        clay.cone(skull, skull + (0.5 * size + long) * jaw, size * 0.35, size * 0.22, blend=0.02)
    if chance(rng, 0.1):
        end = skull + (size + long) * look
        trunk = smooth_curve([skull + size * look, end, end - (0, 0, 0.5)], 7)
        clay.chain(trunk, np.linspace(0.4, 0.2, 7) * size)
    ears(rng, clay, skull, size)
    return skull


def ears(rng: Rng, clay: Sculpture, skull, size: float) -> None:
    """Two ears, flat or pointed, and sometimes two horns."""
    ear, out = rng.uniform(0.3, 1.4) * size, rng.uniform(0.3, 1.5)
    flat, horned = chance(rng, 0.5), chance(rng, 0.25)
    curve = rng.normal(0, 0.5, 3) * size
    for s in (-1, 1):
        aim = unit([s * out, rng.uniform(-0.1, 0.4), rng.uniform(0.2, 1)])
        root = skull + 0.75 * size * unit([s * 0.7, 0.1, 0.8])
        if flat:
            thin_ear = (0.4 * ear, 0.03, 0.7 * ear)
            clay.ball(root + 0.5 * ear * aim, thin_ear, facing(aim, (0, 1, 0)), blend=0.03)
        else:
            clay.cone(root, root + ear * aim, 0.28 * size, 0.06, blend=0.03)
        if horned:
            turn = np.array([s, 1, 1])
            start = skull + size * unit([s * 0.4, -0.1, 0.9])
            middle = start + turn * (0.4, 0.1, 0.8) * size
            tip = start + turn * (0.6, 0.4, 1.5) * size + turn * curve
            clay.chain(smooth_curve([start, middle, tip], 6), np.linspace(0.2, 0.08, 6) * size)


def tail(rng: Rng, clay: Sculpture, root, girth: float) -> None:
    """A stub, or a long curved tail, sometimes with a tuft."""
    if chance(rng, 0.15):
        clay.ball(root, girth * rng.uniform(0.3, 0.6))
        return
    long, steps = rng.uniform(0.3, 1.3), 8
    aim, turn = unit([0, 1, rng.uniform(-0.8, 0.6)]), rng.normal(0, 0.25, 2)
    path = [np.asarray(root, float)]
    for _ in range(steps):
        aim = rotation((1, 0, 0), turn[0]) @ rotation((0, 0, 1), turn[1]) @ aim
        path.append(path[-1] + long / steps * aim)
    thick = girth * rng.uniform(0.15, 0.6)
    clay.chain(path, np.linspace(thick, max(0.3 * thick, 0.02), steps + 1))
    if chance(rng, 0.25):
        clay.ball(path[-1], rng.uniform(0.05, 0.12))


def bird(rng: Rng) -> Sculpture:
    """A bird, penguin or duck: body, neck, beak, wings spread or folded, tail fan, thin legs."""
    clay = Sculpture(rng.uniform(0.03, 0.1))
    fat, tilt = rng.uniform(0.22, 0.45), rng.uniform(-0.1, 1.3)
    frame = rotation((1, 0, 0), -tilt)
    clay.ball((0, 0, 0), (fat, 0.6, fat * rng.uniform(0.85, 1.1)), frame)
    neck = frame @ np.array([0, -0.5, 0.1])
    skull = (
        neck
        + rng.uniform(0.1, 0.6) * unit([0, -rng.uniform(0.1, 1), 1])
        + (rng.normal(0, 0.05), 0, 0)
    )
    size = fat * rng.uniform(0.45, 0.8)
    clay.chain(
        smooth_curve([frame @ (0, -0.3, 0), neck, skull], 6), np.linspace(fat * 0.7, size * 0.7, 6)
    )
    clay.ball(skull, size)
    beak = unit([rng.normal(0, 0.2), -1, rng.uniform(-0.5, 0.2)])
    clay.cone(
        skull + 0.7 * size * beak,
        skull + (size + rng.uniform(0.1, 0.5)) * beak,
        size * 0.4,
        0.03,
        blend=0.03,
    )
    spread = chance(rng, 0.5)
    for s in (-1, 1):
        wing(rng, clay, s, fat, frame, spread)
        if chance(rng, 0.85):
            stand(rng, clay, s, fat)
    fan = frame @ unit([0, 1, rng.uniform(-0.2, 0.5)])
    clay.ball(frame @ (0, 0.5, 0) + 0.25 * fan, (rng.uniform(0.1, 0.3), 0.035, 0.3), facing(fan))
    if chance(rng, 0.2):
        clay.cone(np.add(skull, (0, 0, size)), np.add(skull, (0, 0.15, size + 0.15)), 0.06, 0.03)
    return clay


def wing(rng, clay, side, fat, frame, spread) -> None:
    """A flat wing of two parts."""
    root = frame @ np.array([side * fat * 0.8, -0.15, 0.1])
    if not spread:
        clay.ball(root + frame @ (side * 0.05, 0.2, -0.05), (0.06, 0.45, 0.22), frame, blend=0.03)
        return
    rise, span = rng.uniform(-0.3, 0.9), rng.uniform(0.4, 0.8)
    elbow = root + span * frame @ unit([side, 0.1, rise])
    tip = elbow + span * frame @ unit([side, rng.uniform(0, 0.7), rise - rng.uniform(-0.3, 0.8)])
    for a, b, deep in ((root, elbow, 0.26), (elbow, tip, 0.2)):
        turn = facing(b - a, frame @ (0, 1, 0))
        clay.ball((a + b) / 2, (0.04, deep, 0.62 * span), turn, blend=0.05)


def stand(rng, clay, side, fat) -> None:
    """A thin leg with toes."""
    hip = np.array([side * fat * 0.45, 0.05, -fat * 0.6])
    foot = np.add(
        hip, (side * rng.uniform(0, 0.1), rng.uniform(-0.1, 0.1), -rng.uniform(0.15, 0.6))
    )
    clay.cone(hip, foot, 0.06, 0.035)
    for angle in (-0.5, 0.0, 0.5):
        clay.cone(
            foot,
            foot + 0.18 * np.array([np.sin(angle), -np.cos(angle), 0]),
            0.035,
            0.025,
            blend=0.02,
        )


def fish(rng: Rng) -> Sculpture:
    """A fish, shark, whale or ray: a tapered body with thin fins."""
    clay = Sculpture(rng.uniform(0.03, 0.08))
    wide, tall = rng.uniform(0.15, 0.4), rng.uniform(0.2, 0.55)
    bend = rng.normal(0, 0.25)
    stations = np.linspace(-0.9, 0.8, 9)
    for y in stations:
        size = max(1 - ((y + 0.25) / 1.15) ** 2, 0.08) ** rng.uniform(0.6, 0.8)
        clay.ball((bend * y * y, y, 0), (wide * size, 0.24, tall * size), blend=0.15)
    end = np.array([bend * 0.7, 0.85, 0])
    upright = chance(rng, 0.75)
    for s in (-1, 1):
        aim = unit([0, rng.uniform(0.4, 1.2), s] if upright else [s, rng.uniform(0.4, 1.2), 0])
        side = (1, 0, 0) if upright else (0, 0, 1)
        flat = facing(aim, side)
        clay.ball(end + 0.22 * aim, (0.13, 0.035, 0.3), flat, blend=0.04)
        fin = unit([s, rng.uniform(0.1, 1), rng.uniform(-0.8, 0.2)])
        size = rng.uniform(0.15, 0.55)
        clay.ball(
            (s * wide * 0.7, -0.35, -0.1) + 0.6 * size * fin,
            (0.12, 0.035, size),
            facing(fin, (0, 0, 1)),
            blend=0.04,
        )
    for z, y in ((1, rng.uniform(-0.3, 0.3)), (-1, rng.uniform(0, 0.5))):
        if chance(rng, 0.8):
            aim = unit([0, rng.uniform(0, 1), z])
            clay.ball(
                (bend * y * y, y, z * tall * 0.75) + 0.1 * aim,
                (0.18, 0.035, 0.25),
                facing(aim, (1, 0, 0)),
                blend=0.03,
            )
    if chance(rng, 0.3):
        clay.cone((bend, -1.3, -0.05), (bend, -0.7, -0.05), 0.12, 0.1, removes=True)
    for s in (-1, 1):
        clay.ball((s * wide * 0.55, -0.75, 0.08), 0.07, blend=0.02)
    return clay
