"""Random plane outlines: stars, gears, blobs, letters, structural sections."""

import numpy as np
from manifold3d import CrossSection

from riemlayer.data.procedural.solids import (
    Rng,
    pick,
)


def star(rng: Rng) -> np.ndarray:
    """A star-shaped polygon (n, 2): gear, star, blob, regular or irregular."""
    k = int(rng.integers(3, 14))
    style = pick(rng, "regular", "star", "gear", "blob", "rough")
    if style == "gear":
        k = int(rng.integers(6, 16))
        radius = np.tile([1, 1, rng.uniform(0.65, 0.88)], k)
        radius = np.repeat(np.tile([1.0, rng.uniform(0.65, 0.88)], k), 2)
        angle = (np.repeat(np.arange(2 * k), 2) + np.tile([-0.38, 0.38], 2 * k)) * np.pi / k
    elif style == "blob":
        angle = np.arange(48) * 2 * np.pi / 48
        a, p = rng.normal(0, 0.12, 4), rng.uniform(0, 6.3, 4)
        radius = 1 + (a[:, None] * np.cos(np.arange(2, 6)[:, None] * angle + p[:, None])).sum(0)
        radius = np.maximum(radius, 0.3)
    else:
        k = 2 * k if style == "star" else k
        angle = np.arange(k) * 2 * np.pi / k
        radius = np.ones(k)
        if style == "star":
            radius[1::2] = rng.uniform(0.35, 0.8)
        elif style == "rough":
            radius = rng.uniform(0.4, 1, k)
    return 0.8 * radius[:, None] * np.c_[np.cos(angle), np.sin(angle)]


def letter(rng: Rng) -> CrossSection:
    """Strokes on a small grid of nodes, joined: letters, runes, pipes in a plane."""
    nodes = np.stack(np.meshgrid([-0.6, 0, 0.6], [-0.9, 0, 0.9]), -1).reshape(-1, 2)
    width = rng.uniform(0.1, 0.28)
    at = int(rng.integers(9))
    section = CrossSection()
    for _ in range(rng.integers(2, 8)):
        to = int(rng.integers(9))
        if to != at:
            a, b = nodes[at], nodes[to]
            side = np.array([-(b - a)[1], (b - a)[0]]) / np.linalg.norm(b - a) * width / 2
            along = (b - a) / np.linalg.norm(b - a) * width / 2
            corners = [a - along - side, b + along - side, b + along + side, a - along + side]
            section += CrossSection([np.array(corners)])
            at = to
    return section if not section.is_empty() else CrossSection.square((1, 0.3), True)


def profile(rng: Rng) -> CrossSection:
    """Structural sections: I, L, T, U, C, hollow box, hollow tube."""
    w, h, t = rng.uniform(0.5, 1.2), rng.uniform(0.5, 1.2), rng.uniform(0.06, 0.16)

    def bar(a, b, x, y):
        return CrossSection.square((a, b), True).translate((x, y))

    style = pick(rng, "I", "L", "T", "U", "box", "tube", "E")
    base, post = bar(w, t, 0, -h / 2), bar(t, h + t, 0, 0)
    if style == "tube":
        return CrossSection.circle(w / 2, 40) - CrossSection.circle(w / 2 - t, 40)
    if style == "box":
        return bar(w, h, 0, 0) - bar(w - 2 * t, h - 2 * t, 0, 0)
    if style == "T":
        return base + post
    if style == "I":
        return base + post + bar(w, t, 0, h / 2)
    left = bar(t, h + t, -(w - t) / 2, 0)
    if style == "L":
        return base + left
    if style == "U":
        return base + left + bar(t, h * rng.uniform(0.4, 1), (w - t) / 2, 0)
    return base + left + bar(w, t, 0, h / 2) + bar(w * 0.8, t, -0.1 * w, 0)
