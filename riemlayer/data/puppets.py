"""Articulated bodies with labelled parts, in milliseconds: something to learn segmentation on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

PARTS = ("head", "torso", "arm", "leg")
"""Names of the labels."""


class Rods(NamedTuple):
    """Tubes with round ends."""

    start: NDArray
    """(R, 3)"""
    axis: NDArray
    """(R, 3) unit vectors."""
    length: NDArray
    """(R,) without the round ends."""
    radius: NDArray
    """(R,)"""
    part: NDArray
    """(R,) places in `PARTS`."""


def puppet(
    seed: int, count: int = 1000, turned: bool = True
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Points on a random body in a random pose, and the part each belongs to (ours).

    Rods with round ends make the body; lengths, thicknesses, joints and the rotation of the whole
    are random, and legs are thicker than arms. Points are uniform on the rods but for what lies
    inside another one. A puppet is the same for the same seed and count.

    Args:
        seed: A number of at least 0.
        count: Points of the cloud.
        turned: False leaves it upright: head to z, front to y.

    Returns:
        Points (count, 3), about 1.5 across, and labels (count,), the places in `PARTS`.

    Raises:
        ValueError: For a negative seed or no points.

    Example:
        >>> points, part = puppet(0, 500)
        >>> points.shape, [PARTS[i] for i in np.unique(part)]
        ((500, 3), ['head', 'torso', 'arm', 'leg'])
    """
    if seed < 0 or count < 1:
        raise ValueError(f"seed must be at least 0 and count at least 1, got {seed} and {count}")
    rng = np.random.default_rng(seed)
    rods = _body(rng)
    points, label = np.zeros((0, 3)), np.zeros(0, np.int64)
    while len(points) < count:
        rod, found = _on_rods(rng, 2 * count, rods)
        bare = (_signed_distance(rods, found) > -1e-6).all(1)
        points = np.concatenate([points, found[bare]])[:count]
        label = np.concatenate([label, rods.part[rod[bare]]])[:count]
    if not turned:
        return points.astype(np.float32), label
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn[0] *= np.sign(np.linalg.det(turn))
    return (points @ turn.T).astype(np.float32), label


def _body(rng: np.random.Generator) -> Rods:
    """A body with its hip at 0, its front along y and its head up."""
    rods: list[tuple] = []
    head, torso, arm, leg = range(4)

    def rod(part: int, start: NDArray, aim: NDArray, length: float, radius: float, bend: float):
        axis = aim / np.linalg.norm(aim) + rng.normal(0, bend, 3)
        axis /= np.linalg.norm(axis)
        rods.append((start, axis, length, radius, part))
        return start + length * axis

    hip, up, front = np.zeros(3), np.array([0.0, 0, 1]), np.array([0.0, 1, 0])
    fat, thin = rng.uniform(0.1, 0.15), rng.uniform(0.05, 0.06)
    thick = 1.45 * thin
    neck = rod(torso, hip, up, rng.uniform(0.4, 0.55), fat, 0.2)
    top = neck + fat * neck / np.linalg.norm(neck)
    rod(head, top, neck, rng.uniform(0.12, 0.2), rng.uniform(0.09, 0.12), 0.2)
    for side in (np.array([-1.0, 0, 0]), np.array([1.0, 0, 0])):
        upper, lower = rng.uniform(0.2, 0.3), rng.uniform(0.3, 0.4)
        shoulder, socket = neck + fat * side, hip + 0.7 * fat * side
        elbow = rod(arm, shoulder, side, upper, thin, 0.5)
        wrist = rod(arm, elbow, elbow - shoulder, upper, thin, 0.5)
        rod(arm, wrist, wrist - elbow, 0.07, 1.3 * thin, 0.1)
        knee = rod(leg, socket, 0.3 * side - up, lower, thick, 0.3)
        ankle = rod(leg, knee, knee - socket, lower, thick, 0.3)
        rod(leg, ankle, front, 0.15, thick, 0.2)
    return Rods(*(np.array(values) for values in zip(*rods, strict=True)))


def _on_rods(rng: np.random.Generator, n: int, rods: Rods) -> tuple[NDArray, NDArray]:
    """The rods (n,) and places (n, 3) of points that are uniform by area on all rods."""
    area = rods.radius * (rods.length + 2 * rods.radius)
    rod = rng.choice(len(area), n, p=area / area.sum())
    start, axis, length, radius = (values[rod] for values in rods[:4])
    place = rng.uniform(-radius, length + radius)  # a ball has the area of the tube around it
    foot = place.clip(0, length)
    out = rng.normal(size=(n, 3))
    along = (out * axis).sum(-1)
    outward = np.sign(place - foot) * np.abs(along)  # 0 between the ends
    out += (outward - along)[:, None] * axis
    out *= (radius / np.linalg.norm(out, axis=-1))[:, None]
    return rod, start + foot[:, None] * axis + out


def _signed_distance(rods: Rods, points: NDArray) -> NDArray:
    """Distances (n, R) of points (n, 3) to each rod, negative inside."""
    offset = points[:, None] - rods.start
    foot = (offset * rods.axis).sum(-1).clip(0, rods.length)
    return np.linalg.norm(offset - foot[..., None] * rods.axis, axis=-1) - rods.radius
