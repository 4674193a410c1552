"""Things modelled in clay: toys, garments with openings, reliefs."""

from typing import Any

import numpy as np
from manifold3d import Manifold

from riemlayer.data.procedural.animals import fish, quadruped
from riemlayer.data.procedural.figures import bust, facing, hand, humanoid, unit
from riemlayer.data.procedural.organic import blob
from riemlayer.data.procedural.sculpture import Sculpture
from riemlayer.data.procedural.sheets import slab
from riemlayer.data.procedural.solids import (
    Rng,
    chance,
    pick,
)

Sleeve = tuple[Any, Any, float, float, bool]
"""Ends, radii at the ends, whether it adds matter; it is hollowed through its second end."""


def toy(rng: Rng) -> Sculpture:
    """A teddy, duck, snowman, gnome or chess piece: few round masses, on a base or not."""
    clay = Sculpture(rng.uniform(0.02, 0.12))
    body, skull = rng.uniform(0.35, 0.55, 3), rng.uniform(0.25, 0.45, 3)
    clay.ball((0, 0, 0), body)
    head = np.array([0, -rng.uniform(0, 0.2), body[2] + 0.6 * skull[2]])
    clay.ball(head, skull)
    clay.ball(np.add(head, (0, -skull[1], -0.08)), rng.uniform(0.06, 0.2, 3), blend=0.03)
    high, low = rng.uniform(-0.6, 0.9), rng.uniform(-0.9, -0.2)
    for s in (-1, 1):
        ear = unit([s * rng.uniform(0.3, 1), 0.1, 1])
        clay.ball(head + 0.9 * skull * ear, rng.uniform(0.06, 0.2, 3), facing(ear), blend=0.02)
        arm = unit([s, -rng.uniform(0, 0.9), high])
        clay.cone((s * 0.3, 0, 0.2), np.add((s * 0.3, 0, 0.2), 0.5 * arm), 0.14, 0.13)
        foot = unit([s * 0.6, -rng.uniform(0.2, 1), low])
        clay.cone((s * 0.2, 0, -0.25), np.add((s * 0.2, 0, -0.25), 0.5 * foot), 0.17, 0.16)
    if chance(rng, 0.35):
        base = rng.uniform(0.5, 0.9)
        clay.block((0, 0, -body[2] - 0.25), (base, base, 0.15), round_=0.05, blend=0.03)
    if chance(rng, 0.3):
        clay.cone(
            np.add(head, (0, 0, 0.6 * skull[2])),
            np.add(head, (0, 0, skull[2] + 0.5)),
            0.25,
            0.05,
            blend=0.02,
        )
    if chance(rng, 0.3):
        clay.ball((0, body[1] + 0.05, -0.2), 0.12)
    return clay


def garment(rng: Rng) -> Sculpture:
    """A hollow thing with openings: shirt, trousers, hat or sack, of an even wall."""
    clay = Sculpture(rng.uniform(0.04, 0.1))
    wall = rng.uniform(0.05, 0.08)
    sleeves = pick(rng, shirt, trousers, hat, sack)(rng)
    for a, b, ra, rb, filled in sleeves:
        if filled:
            clay.cone(a, b, ra, rb)
    if not all(filled for *_, filled in sleeves):
        brim = rng.uniform(0.6, 1.0)
        clay.ball((0, rng.uniform(-0.3, 0), 0.0), (brim, brim, 0.06))
    for a, b, ra, rb, _ in sleeves:
        along = unit(np.subtract(b, a))
        clay.cone(a, np.add(b, 0.5 * along), ra - wall, rb - wall, removes=True, blend=0.02)
        end, cap = np.add(b, (rb + 0.02) * along), (1.3 * rb, 1.3 * rb, rb * 0.9)
        clay.block(end, cap, facing(along, (0, 1, 0)), removes=True, blend=0.01)
    clay.roughen(rng, rng.uniform(0, 0.01), rng.uniform(0.3, 0.8))
    return clay


def shirt(rng: Rng) -> list[Sleeve]:
    """A trunk, two sleeves and a collar."""
    x, _, z = unit([1, 0, -rng.uniform(-0.1, 1.2)]) * rng.uniform(0.5, 1.1)
    wide, long = rng.uniform(0.25, 0.36), rng.uniform(0.5, 1.2)
    trunk = ((0, 0, 0.4), (0, 0, -long), wide, wide * rng.uniform(0.9, 1.6), True)
    arms = [((s * 0.2, 0, 0.45), (s * (0.2 + x), 0, 0.45 + z), 0.2, 0.16, True) for s in (-1, 1)]
    return [trunk, *arms, ((0, 0, 0.4), (0, 0, 0.85), 0.18, 0.14, True)]


def trousers(rng: Rng) -> list[Sleeve]:
    """A waist and two legs."""
    out, long = rng.uniform(0.1, 0.4), rng.uniform(0.4, 1.4)
    tubes = [((s * 0.15, 0, 0.1), (s * (0.15 + out), 0, -long), 0.22, 0.17, True) for s in (-1, 1)]
    return [((0, 0, 0.1), (0, 0, 0.5), 0.34, 0.3, True), *tubes]


def hat(rng: Rng) -> list[Sleeve]:
    """A crown hollowed from below."""
    tall, top = rng.uniform(0.2, 0.8), rng.uniform(0.3, 0.55)
    return [((0, 0, tall), (0, 0, 0), top, 0.5, True), ((0, 0, 0), (0, 0, -0.6), 0.5, 0.5, False)]


def sack(rng: Rng) -> list[Sleeve]:
    """A bag with a narrow or wide mouth."""
    r, mouth = rng.uniform(0.3, 0.6, 2)
    tall = rng.uniform(0.3, 1)
    neck = ((0, 0, tall), (0, 0, tall + rng.uniform(0.3, 0.7)), mouth, mouth * 0.9, True)
    return [((0, 0, 0), (0, 0, tall), r, mouth, True), neck]


def relief(rng: Rng) -> list[Manifold]:
    """The front of a sculpture as a thick plate: a mask, coin, or the wall of a depth scan."""
    from scipy.ndimage import gaussian_filter

    model = pick(rng, bust, quadruped, hand, blob, humanoid, fish, toy)(rng)
    model.cells = 2e5
    values, _, step = model.grid()
    axis = int(rng.integers(3))
    inside = np.moveaxis(values < 0, axis, -1)
    if chance(rng, 0.5):
        inside = inside[..., ::-1]
    count = inside.shape[-1]
    height = np.where(inside.any(-1), count - np.argmax(inside[..., ::-1], -1), 0) * step
    height = gaussian_filter(height * rng.uniform(0.3, 1.0), rng.uniform(0.8, 2.5))
    x, y = (np.arange(n) * step for n in height.shape)
    top = np.stack([*np.meshgrid(x, y, indexing="ij"), height], -1)
    thick = rng.uniform(0.06, 0.4) * max(x[-1], y[-1]) / 2
    bottom = top.copy()
    bottom[..., 2] = -thick
    if chance(rng, 0.3):
        bottom[..., 2] = np.minimum(gaussian_filter(height, 2.0) - 0.1, height) - thick
    return [slab(top, bottom)]
