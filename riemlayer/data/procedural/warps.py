"""Random placement of a shape: smooth deformations of the cube, then a rotation."""

from collections.abc import Callable

import numpy as np

from riemlayer.data.procedural.solids import Rng, chance

Warp = Callable[[np.ndarray], np.ndarray]


def placement(rng: Rng, low: np.ndarray, high: np.ndarray) -> Warp:
    """Maps points of a bounding box into the cube [-1, 1]^3, deforms and turns them (ours)."""
    centre, scale = (low + high) / 2, (high - low).max() / 2
    steps = [*random_warps(rng, (high - low) / (high - low).max())]
    turn = random_turn(rng)

    def place(x: np.ndarray) -> np.ndarray:
        x = (x - centre) / scale
        for step in steps:
            x = step(x)
        return x @ turn.T

    return place


def random_turn(rng: Rng) -> np.ndarray:
    """A rotation (3, 3): mostly one that keeps the axes in some order, else any."""
    if chance(rng, 0.2):
        q, r = np.linalg.qr(rng.normal(size=(3, 3)))
        turn = q * np.sign(np.diag(r))
    else:
        turn = np.eye(3)[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3)
    return turn * np.sign(np.linalg.det(turn))


def random_warps(rng: Rng, half: np.ndarray) -> list[Warp]:
    """None to several of: stretch, taper, twist, bend, wave, dents; all are one-to-one."""
    steps: list[Warp] = []
    if chance(rng, 0.3):
        stretch = np.exp(rng.normal(0, 0.18, 3))
        stretch /= stretch.max()
        steps.append(lambda x: x * stretch)
    if chance(rng, 0.08):
        slope, taper_axis = rng.uniform(-0.35, 0.35), int(rng.integers(3))
        steps.append(lambda x: taper(x, slope, taper_axis))
    if chance(rng, 0.07):
        rate, twist_axis = rng.uniform(-0.9, 0.9), int(rng.integers(3))
        steps.append(lambda x: twist(x, rate, twist_axis))
    if chance(rng, 0.08):
        axis = int(np.argmax(half)) if chance(rng, 0.7) else int(rng.integers(3))
        curve, across = rng.uniform(0.1, 0.8) * rng.choice([-1, 1]), (axis + rng.integers(1, 3)) % 3
        steps.append(lambda x: bend(x, curve, axis, int(across)))
    if chance(rng, 0.08):
        steps.append(ripple(rng, rng.uniform(1.5, 5), rng.uniform(0.05, 0.25)))
    if chance(rng, 0.06):
        steps.append(ripple(rng, rng.uniform(15, 50), rng.uniform(0.05, 0.2)))
    return steps


def taper(x: np.ndarray, slope: float, axis: int) -> np.ndarray:
    """Widens or narrows along an axis."""
    scale = np.repeat(1 + slope * x[:, axis : axis + 1], 3, 1)
    scale[:, axis] = 1
    return x * scale


def twist(x: np.ndarray, rate: float, axis: int) -> np.ndarray:
    """Turns about an axis by `rate` radians per unit of length."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    c, s = np.cos(rate * x[:, axis]), np.sin(rate * x[:, axis])
    y = x.copy()
    y[:, i], y[:, j] = c * x[:, i] - s * x[:, j], s * x[:, i] + c * x[:, j]
    return y


def bend(x: np.ndarray, curve: float, axis: int, across: int) -> np.ndarray:
    """Rolls an axis onto a circle of curvature `curve` in the plane of `axis` and `across`."""
    angle, radius = curve * x[:, axis], 1 / curve - x[:, across]
    y = x.copy()
    y[:, axis], y[:, across] = radius * np.sin(angle), 1 / curve - radius * np.cos(angle)
    return y


def ripple(rng: Rng, wave_number: float, strain: float) -> Warp:
    """Adds plane waves; the displacement's gradient is about `strain`, below 1, so no folds."""
    direction = rng.normal(size=(6, 3))
    direction *= wave_number / np.linalg.norm(direction, axis=1, keepdims=True)
    phase = rng.uniform(0, 2 * np.pi, 6)
    amplitude = rng.normal(size=(6, 3)) * strain / wave_number / 3
    return lambda x: x + np.sin(x @ direction.T + phase) @ amplitude
