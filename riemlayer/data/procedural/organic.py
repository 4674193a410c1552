"""Growing things: blobs of clay and branching tubes."""

import numpy as np
from manifold3d import Manifold

from riemlayer.data.procedural.sculpture import Sculpture
from riemlayer.data.procedural.solids import (
    Rng,
    ball,
    chance,
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
            clay.ball(at, rng.uniform(0.15, 0.5, 3), rotation=_turn(rng))
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


def _turn(rng: Rng) -> np.ndarray:
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
