"""Insects, scorpions, crabs and tentacled creatures: many thin limbs."""

import numpy as np

from riemlayer.data.procedural.figures import facing, rotation, unit
from riemlayer.data.procedural.sculpture import Sculpture
from riemlayer.data.procedural.solids import (
    Rng,
    chance,
    smooth_curve,
)


def insect(rng: Rng) -> Sculpture:
    """An insect, spider, crab, lobster or scorpion: segments and many thin legs."""
    clay = Sculpture(rng.uniform(0.02, 0.05))
    count, pairs = int(rng.integers(2, 6)), int(rng.integers(3, 6))
    sizes = rng.uniform(0.12, 0.32, count)
    y = np.cumsum(sizes * 1.3) - sizes[0]
    wide = rng.uniform(0.8, 1.6)
    for i in range(count):
        clay.ball((0, y[i], 0), sizes[i] * np.array([wide, 1.1, rng.uniform(0.5, 0.9)]))
    feet(rng, clay, y[0] + (np.arange(pairs) + 0.5) / pairs * (y[-1] - y[0]) * rng.uniform(0.7, 1))
    front = np.array([0, -sizes[0], 0])
    if chance(rng, 0.55):
        claws(rng, clay, front, sizes[0])
    if chance(rng, 0.45):
        sting(rng, clay, np.array([0, y[-1] + sizes[-1] * 0.7, 0]))
    for s in (-1, 1):
        if chance(rng, 0.35):
            reach = rng.uniform((0.1, 0.3, 0), (0.5, 0.8, 0.5)) * (s, -1, 1)
            knee = front + 0.5 * reach + (0, 0, 0.1)
            clay.chain(smooth_curve([front, knee, front + reach], 5), 0.03)
        if pairs == 3 and chance(rng, 0.4):
            aim = unit([s, rng.uniform(0, 1), 0.2])
            clay.ball((0, y[0], 0.15) + 0.4 * aim, (0.035, 0.2, 0.45), facing(aim, (0, 1, 0)))
    return clay


def feet(rng: Rng, clay: Sculpture, stations: np.ndarray) -> None:
    """Pairs of thin bent legs along the body."""
    reach, rise, r = rng.uniform(0.4, 1.0), rng.uniform(0.0, 0.45), rng.uniform(0.03, 0.05)
    for i, at in enumerate(stations):
        sweep = (i / max(len(stations) - 1, 1) - 0.5) * rng.uniform(0.8, 2)
        for s in (-1, 1):
            wiggle = sweep + rng.normal(0, 0.15)
            out = np.array([s * np.cos(wiggle), np.sin(wiggle), 0])
            root = np.array([s * 0.1, at, 0])
            knee = root + (0.15 + 0.45 * reach) * out + (0, 0, rise)
            foot = root + (0.15 + reach) * out + (0, 0, -rng.uniform(0.1, 0.35))
            shin = (knee + foot) / 2 + 0.08 * out
            clay.chain([root, knee, shin, foot], r * np.array([1.4, 1.1, 1.0, 0.8]))


def sting(rng: Rng, clay: Sculpture, start: np.ndarray) -> None:
    """A tail of beads that curls up and ends in a spike."""
    curl, aim, path = rng.uniform(0.1, 0.45), np.array([0, 1.0, 0]), [start]
    for _ in range(8):
        aim = rotation((1, 0, 0), curl) @ aim
        path.append(path[-1] + rng.uniform(0.11, 0.17) * aim)
    for at in path:
        clay.ball(at, rng.uniform(0.06, 0.09), blend=0.02)
    clay.chain(path, np.linspace(0.09, 0.05, 9))
    clay.cone(path[-1], path[-1] + 0.15 * (rotation((1, 0, 0), 0.8) @ aim), 0.07, 0.03)


def claws(rng: Rng, clay: Sculpture, front, size: float) -> None:
    """Two arms with pincers."""
    long, grip = rng.uniform(0.3, 0.7), rng.uniform(0.12, 0.3)
    for s in (-1, 1):
        elbow = np.add(front, (s * (size + 0.5 * long), 0.0 + rng.normal(0, 0.1), 0.1))
        wrist = elbow + long * unit([s * rng.uniform(-0.4, 0.4), -1, 0])
        clay.chain([front, elbow, wrist], [0.06, 0.055, 0.06])
        aim = unit([rng.normal(0, 0.3), -1, 0])
        clay.ball(wrist + grip * 0.5 * aim, (grip * 0.55, grip * 0.8, grip * 0.35))
        for t in (-1, 1):
            middle = wrist + grip * (1.1 * aim + (t * 0.6, 0, 0))
            clay.chain(
                [wrist + grip * aim, middle, wrist + grip * (2 * aim + (t * 0.12, 0, 0))],
                [0.06, 0.05, 0.03],
                blend=0.01,
            )


def tentacles(rng: Rng) -> Sculpture:
    """A starfish, octopus, jellyfish, snake, worm or coral-like creature."""
    clay = Sculpture(rng.uniform(0.04, 0.1))
    arms = int(rng.integers(1, 10))
    size = rng.uniform(0.2, 0.4)
    if arms > 2:
        clay.ball((0, 0, 0.1), (size, size, rng.uniform(0.15, 0.6)))
    long, steps, curl = rng.uniform(0.8, 1.6) * (2.5 if arms == 1 else 1), 12, rng.uniform(0, 0.35)
    sink = rng.uniform(-0.4, 0.2)
    for i in range(arms):
        angle = 2 * np.pi * (i + rng.uniform(-0.15, 0.15)) / arms
        aim = unit([np.cos(angle), np.sin(angle), sink])
        path = [0.5 * size * aim]
        phase, turn = rng.uniform(0, 6.3), rng.normal(size=3)
        for j in range(steps):
            aim = rotation(np.add(turn, (0, 0, 0.01)), curl * np.sin(phase + 0.7 * j)) @ aim
            path.append(path[-1] + long / steps * aim)
        clay.chain(path, np.linspace(rng.uniform(0.1, 0.18), rng.uniform(0.04, 0.09), steps + 1))
    return clay
