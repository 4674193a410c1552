"""Growing things: blobs of clay, trees, plants, fruit."""

import numpy as np
from manifold3d import Manifold

from riemlayer.data.procedural.figures import facing, rotation, unit
from riemlayer.data.procedural.sculpture import Sculpture
from riemlayer.data.procedural.solids import (
    Rng,
    ball,
    chance,
    pick,
    rod,
    segments,
    smooth_curve,
    tube,
)

Parts = list[Manifold]


def blob(rng: Rng) -> Sculpture:
    """Metaballs or a noise-displaced ellipsoid, sometimes with bites and tunnels."""
    clay = Sculpture(rng.uniform(0.03, 0.35))
    if chance(rng, 0.35):
        clay.ball((0, 0, 0), rng.uniform(0.5, 1.0, 3))
        clay.roughen(rng, rng.uniform(0.03, 0.14), rng.uniform(0.35, 1.4))
    else:
        at = np.zeros(3)
        for _ in range(rng.integers(2, 14)):
            clay.ball(at, rng.uniform(0.15, 0.5, 3), rotation=random_rotation(rng))
            at = at + rng.normal(0, 0.3, 3)
            if chance(rng, 0.2):
                at = np.zeros(3)
        if chance(rng, 0.3):
            clay.roughen(rng, 0.03, rng.uniform(0.2, 0.6))
    for _ in range(rng.integers(0, 3)):
        a, b = rng.normal(0, 0.5, 3), rng.normal(0, 0.5, 3)
        r = rng.uniform(0.08, 0.25)
        clay.cone(a, b, r, r, removes=True, blend=0.06)
    return clay


def random_rotation(rng: Rng) -> np.ndarray:
    """A rotation (3, 3), all equally likely."""
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def branches(rng: Rng) -> Parts:
    """A tree, coral or pipe network of branching smooth tubes."""
    parts: Parts = []
    spread, shrink = rng.uniform(0.5, 1.1), rng.uniform(0.6, 0.85)

    def grow(start: np.ndarray, direction: np.ndarray, length: float, r: float, depth: int) -> None:
        bend = direction + rng.normal(0, 0.3, 3)
        end = start + length * bend / np.linalg.norm(bend)
        middle = start + 0.5 * length * direction + rng.normal(0, 0.06, 3) * length
        parts.append(
            tube(smooth_curve([start, middle, end], 14), np.linspace(r, r * shrink, 14), 9)
        )
        parts.append(ball(r * shrink, end, 10))
        if depth == 0:
            if chance(rng, 0.15):
                parts.append(ball(rng.uniform(0.1, 0.3, 3), end, 12))
            return
        for _ in range(rng.integers(1, 4)):
            turn = bend / np.linalg.norm(bend) + rng.normal(0, spread, 3)
            grow(
                end,
                turn / np.linalg.norm(turn),
                length * rng.uniform(0.6, 0.95),
                max(r * shrink, 0.055),
                depth - 1,
            )

    grow(np.zeros(3), np.array([0, 0, 1.0]), 0.8, rng.uniform(0.08, 0.16), int(rng.integers(2, 4)))
    if chance(rng, 0.5):
        pot = rng.uniform(0.3, 0.6)
        parts.append(rod(pot, pot, (0, 0, -pot * 0.3), top=pot * 1.2, sides=segments(rng)))
    return parts


def plant(rng: Rng) -> Sculpture:
    """A plant with flat leaves or petals, a cactus, a mushroom or a flower, in a pot or not."""
    clay = Sculpture(rng.uniform(0.02, 0.05))
    tall, count = rng.uniform(0.3, 1.2), int(rng.integers(3, 13))
    style = pick(rng, "leaves", "leaves", "flower", "cactus", "mushroom")
    lean = rng.normal(0, 0.1, 2) * tall
    top = np.array([*lean, tall])
    if chance(rng, 0.6):
        pot = rng.uniform(0.25, 0.45)
        clay.cone((0, 0, -pot), (0, 0, 0), pot * 0.75, pot)
        clay.block((0, 0, pot + 0.1), (2 * pot, 2 * pot, pot), removes=True, blend=0.02)
    stem = smooth_curve(np.outer([0.0, 0.5, 1.0], top) * [[1, 1, 1], [0.4, 0.4, 1], [1, 1, 1]], 7)
    if style == "mushroom":
        clay.chain(stem, rng.uniform(0.08, 0.2))
        cap = rng.uniform(0.35, 0.8)
        clay.ball(top, (cap, cap, cap * rng.uniform(0.4, 0.9)))
        clay.ball(top - (0, 0, cap * 0.45), (cap * 0.9, cap * 0.9, cap * 0.45), removes=True)
        clay.chain(stem, rng.uniform(0.08, 0.15))
    elif style == "cactus":
        clay.chain(stem, rng.uniform(0.15, 0.25))
        for _ in range(rng.integers(1, 5)):
            start, turn = stem[int(rng.integers(2, 6))], rng.uniform(0, 6.3)
            out = start + 0.45 * np.array([np.cos(turn), np.sin(turn), 0.1])
            clay.chain([start, out, np.add(out, (0, 0, rng.uniform(0.2, 0.6)))], [0.12, 0.12, 0.1])
    else:
        clay.chain(stem, np.linspace(0.07, 0.045, 7))
        for i in range(count):
            foot = top if style == "flower" else stem[int(rng.integers(1, 7))]
            turn = 2.4 * i if style == "leaves" else 2 * np.pi * i / count
            leaf(rng, clay, foot, turn, rng.uniform(0.3, 0.7))
        if style == "flower":
            clay.ball(top, (0.15, 0.15, 0.1))
    return clay


def leaf(rng: Rng, clay: Sculpture, foot, turn: float, size: float) -> None:
    """A flat leaf that rises and droops, of two ellipsoids on a stalk."""
    rise = rng.uniform(-0.2, 1.0)
    aim = unit([np.cos(turn), np.sin(turn), rise])
    end = foot + 0.35 * aim
    clay.cone(foot, end, 0.04, 0.035)
    side = np.cross(aim, (0, 0, 1.0))
    wide = rng.uniform(0.2, 0.5) * size
    for bend in (0.0, rng.uniform(0.1, 0.9)):
        aim = unit(aim - (0, 0, bend))
        clay.ball(end + 0.4 * size * aim, (0.035, wide, 0.55 * size), facing(aim, side), blend=0.03)
        end = end + 0.7 * size * aim


def fruit(rng: Rng) -> Sculpture:
    """An apple, pear, pumpkin, pepper, banana, bean or nut: ribs, dimples, a stalk, a bite."""
    clay = Sculpture(rng.uniform(0.1, 0.3))
    style = pick(rng, "round", "ribbed", "long", "bunch")
    if style == "long":
        a = np.linspace(-1, 1, 9) * rng.uniform(0.2, 1.2)
        path = np.stack([np.cos(a), np.sin(a), 0 * a], 1) / max(abs(a[0]), 0.3)
        clay.chain(
            path, 0.25 * np.sqrt(np.clip(1.05 - np.linspace(-1, 1, 9) ** 2, 0.06, 1)), blend=0.1
        )
        return clay
    if style == "ribbed":
        k, flat = int(rng.integers(4, 12)), rng.uniform(0.5, 1.2)
        for angle in np.arange(k) * 2 * np.pi / k:
            at = 0.4 * np.array([np.cos(angle), np.sin(angle), 0])
            clay.ball(at, (0.55, 0.3, 0.6 * flat), rotation((0, 0, 1), angle), blend=0.06)
    elif style == "bunch":
        for _ in range(rng.integers(5, 20)):
            at = rng.normal(0, 0.4, 3) * (0.7, 0.7, 1.2)
            clay.ball(at, rng.uniform(0.2, 0.32), blend=0.03)
            clay.cone(at, (0, 0, at[2]), 0.08, 0.08, blend=0.03)
        clay.cone((0, 0, -1), (0, 0, 1.2), 0.08, 0.06, blend=0.03)
        return clay
    else:
        clay.ball((0, 0, -0.1), rng.uniform(0.55, 0.8, 3))
        clay.ball((0, 0, rng.uniform(0.2, 0.6)), rng.uniform(0.3, 0.5))
    clay.ball((0, 0, 0.85), (0.25, 0.25, 0.4), removes=True, blend=0.2)
    clay.chain(
        smooth_curve([(0, 0, 0), (0, 0, 0.7), (*rng.normal(0, 0.2, 2), 1)], 5), 0.06, blend=0.03
    )
    if chance(rng, 0.3):
        clay.ball(rng.normal(size=3) * (1, 1, 0.2), 0.5, removes=True, blend=0.03)
    return clay
