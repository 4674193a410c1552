"""People as smooth limbs: bodies in many builds and poses, hands, busts and skulls.

x is left to right, y backward, z up; a body is about 1.8 tall.
"""

import numpy as np

from riemlayer.data.procedural.sculpture import Sculpture
from riemlayer.data.procedural.solids import Rng, chance, pick


def unit(v) -> np.ndarray:
    """The vector scaled to length one."""
    return np.asarray(v, float) / np.linalg.norm(v)


def rotation(axis, angle: float) -> np.ndarray:
    """The rotation (3, 3) about an axis by an angle in radians (Rodrigues)."""
    x, y, z = unit(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def facing(direction, up=(0, 0, 1)) -> np.ndarray:
    """A rotation whose third column is a direction and whose second is near `up`."""
    z = unit(direction)
    x = np.cross(up, z) + 1e-6 * np.array([1, 0.3, 0.1])
    x = unit(x - (x @ z) * z)
    return np.stack([x, np.cross(z, x), z], 1)


def humanoid(rng: Rng) -> Sculpture:
    """A person, child or doll with articulated limbs: standing, running, sitting, spread."""
    clay = Sculpture(rng.uniform(0.03, 0.1), cells=1.1e6, thinnest=0.011)
    wide, fat, childish = (
        rng.uniform(0.8, 1.3),
        np.exp(rng.normal(0.05, 0.25)),
        rng.uniform(0, 1) ** 2,
    )
    bend = rotation((1, 0, 0), rng.normal(0, 0.2)) @ rotation((0, 1, 0), rng.normal(0, 0.1))
    robotic = chance(rng, 0.2)
    torso(rng, clay, wide, fat, bend, robotic)
    neck = bend @ np.array([0, 0, 0.56])
    head(rng, clay, neck + bend @ (0, -0.02, 0.16), 0.1 + 0.07 * childish, bend)
    clay.cone(
        bend @ (0, 0, 0.45), neck + bend @ (0, -0.01, 0.08), 0.065 * fat**0.5, 0.05 * fat**0.3
    )
    pose = pick(rng, "stand", "stand", "walk", "wild", "sit", "tpose", "tpose")
    shrink = 1 - 0.3 * childish
    for side in (-1, 1):
        arm(rng, clay, side, bend, wide, fat, shrink, pose, robotic)
        leg(rng, clay, side, wide, fat, shrink, pose, robotic)
    if chance(rng, 0.15):
        clay.block(bend @ (0, 0.17, 0.3), (0.13, 0.08, 0.2), bend, 0.05)
    if chance(rng, 0.3):
        clay.roughen(rng, rng.uniform(0.003, 0.008), rng.uniform(0.06, 0.25))
    return clay


def torso(rng: Rng, clay: Sculpture, wide: float, fat: float, bend, robotic: bool) -> None:
    """Pelvis, belly and chest; boxes for robots."""
    chest = bend @ np.array([0, 0, 0.36])
    if robotic:
        clay.block((0, 0, 0.0), np.array([0.15, 0.1, 0.08]) * wide, round_=0.03)
        clay.block(chest, np.array([0.2, 0.12, 0.16]) * wide, bend, round_=rng.uniform(0.02, 0.06))
        clay.cone((0, 0, 0), chest, 0.08, 0.08)
        clay.block(chest + bend @ (0, -0.12, 0.02), (0.1, 0.04, 0.06), bend, 0.01, blend=0.01)
        return
    clay.ball((0, 0, 0.0), np.array([0.155 * wide, 0.105, 0.12]) * fat**0.6)
    clay.ball(bend @ (0, -0.02 * fat, 0.17), np.array([0.125 * wide, 0.09, 0.15]) * fat)
    clay.ball(chest, np.array([0.165 * wide, 0.1, 0.16]) * fat**0.4, bend)
    clay.cone(bend @ (-0.15 * wide, 0, 0.46), bend @ (0.15 * wide, 0, 0.46), 0.06, 0.06)
    if chance(rng, 0.4):
        size = rng.uniform(0.04, 0.075)
        for s in (-1, 1):
            clay.ball(bend @ (s * 0.075 * wide, -0.085, 0.38), size, blend=0.03)
    if chance(rng, 0.2):
        clay.cone((0, 0, 0.05), (0, 0, -rng.uniform(0.2, 0.5)), 0.13, rng.uniform(0.2, 0.35))


def head(rng: Rng, clay: Sculpture, centre, size: float, frame: np.ndarray) -> None:
    """Skull, jaw, nose, ears, and sometimes hair or a hat."""
    nod = frame @ rotation((1, 0, 0), rng.normal(0, 0.2)) @ rotation((0, 0, 1), rng.normal(0, 0.4))
    shape = size * np.array([rng.uniform(0.75, 0.9), rng.uniform(0.9, 1.05), 1.15])
    clay.ball(centre, shape, nod)
    clay.ball(centre + nod @ (0, -0.35 * size, -0.55 * size), size * 0.55, blend=0.3 * size)
    clay.cone(
        centre + nod @ (0, -0.9 * size, 0),
        centre + nod @ (0, -1.1 * size, -0.3 * size),
        0.1 * size,
        0.16 * size,
        blend=0.1 * size,
    )
    for s in (-1, 1):
        at = centre + nod @ (s * shape[0], 0.05 * size, -0.05 * size)
        clay.ball(at, size * np.array([0.1, 0.18, 0.3]) * rng.uniform(0.8, 1.6), nod, blend=0.02)
    if chance(rng, 0.5):
        top = rng.uniform(0.95, 1.15)
        clay.ball(centre + nod @ (0, 0.15 * size, 0.25 * size), shape * top, nod, blend=0.02)
        if chance(rng, 0.4):
            clay.ball(centre + nod @ (0, 1.1 * size, 0.2 * size), size * rng.uniform(0.2, 0.6))
    if chance(rng, 0.12):
        hat = centre + nod @ (0, 0, 0.8 * size)
        clay.ball(hat, size * np.array([1.7, 1.7, 0.16]), nod, blend=0.02)
        clay.cone(hat, hat + nod @ (0, 0, size), size * 0.9, size * 0.7, blend=0.02)


def arm(rng, clay, side, bend, wide, fat, shrink, pose, robotic) -> None:
    """Upper arm, forearm and hand, hanging, spread or in any direction."""
    lift = {"stand": rng.uniform(0.15, 0.9), "tpose": rng.uniform(1.3, 1.7)}.get(
        pose, rng.uniform(0.1, 2.6)
    )
    swing = rng.normal(0, 0.15 if pose in ("stand", "tpose") else 0.9)
    down = np.array([side * np.sin(lift), np.sin(swing) * np.cos(lift), -np.cos(lift)])
    elbow_bend = abs(rng.normal(0, 0.25 if pose in ("stand", "tpose") else 0.9))
    shoulder = bend @ np.array([side * 0.19 * wide, 0, 0.46])
    elbow = shoulder + 0.3 * shrink * unit(bend @ down)
    fore = rotation(np.cross(down, (0, -1, 0.3 * rng.normal())), elbow_bend) @ (bend @ unit(down))
    wrist = elbow + 0.27 * shrink * unit(fore)
    r = 0.05 * fat**0.6
    clay.chain([shoulder, elbow, wrist], [r * 1.1, r * 0.85, r * 0.62])
    if robotic:
        clay.ball(shoulder, rng.uniform(0.07, 0.11))
        clay.ball(elbow, 0.06)
    small_hand(rng, clay, wrist, unit(fore), side, shrink)


def small_hand(rng: Rng, clay: Sculpture, wrist, along, side: int, shrink: float) -> None:
    """A fist, a mitten, or a palm with a few spread fingers thick enough to be resolved."""
    frame = facing(along, (0.2, 1, 0.3))
    palm = wrist + 0.06 * shrink * along
    style = pick(rng, "fist", "mitten", "fingers", "fingers", "fine", "fine")
    if style == "fist":
        clay.ball(palm, 0.06 * shrink)
        return
    clay.block(palm, np.array([0.045, 0.02, 0.055]) * shrink, frame, 0.018, blend=0.03)
    thumb = palm + frame @ (-side * 0.085, -0.02, 0.02)
    clay.cone(palm + frame @ (-side * 0.03, 0, -0.02), thumb, 0.02, 0.016, blend=0.01)
    if style == "mitten":
        clay.block(
            palm + 0.09 * shrink * along, np.array([0.04, 0.016, 0.05]) * shrink, frame, 0.015
        )
        return
    if style == "fine":
        for x in np.linspace(-0.036, 0.036, 4):
            root = palm + frame @ (x, 0, 0.045) * shrink
            tip = (
                root + frame @ (x * rng.uniform(0.4, 1.2), rng.uniform(-0.03, 0.01), 0.085) * shrink
            )
            clay.cone(root, tip, 0.011, 0.009, blend=0.003)
        return
    for spread in np.linspace(-1, 1, int(rng.integers(3, 5))):
        root = palm + frame @ (spread * 0.04, 0, 0.04) * shrink
        tip = (
            root
            + frame @ (spread * rng.uniform(0.02, 0.06), rng.uniform(-0.03, 0.02), 0.1) * shrink
        )
        clay.cone(root, tip, 0.017, 0.014, blend=0.006)


def leg(rng, clay, side, wide, fat, shrink, pose, robotic) -> None:
    """Thigh, shin and foot."""
    forward = {"stand": rng.normal(0, 0.08), "tpose": 0.0, "sit": rng.uniform(1.2, 1.7)}.get(
        pose, rng.normal(0.2, 0.6)
    )
    out = abs(rng.normal(0.1, 0.12)) + (0.25 if pose == "wild" else 0)
    hip = np.array([side * 0.09 * wide, 0, -0.05])
    thigh = unit((side * np.sin(out), -np.sin(forward), -np.cos(forward)))
    knee_bend = {"stand": 0.05, "tpose": 0.0, "sit": rng.uniform(1.2, 1.7)}.get(
        pose, float(abs(rng.normal(0, 0.7)))
    )
    knee = hip + 0.43 * shrink * thigh
    shin = rotation((1, 0, 0), knee_bend) @ thigh
    ankle = knee + 0.42 * shrink * shin
    r = 0.08 * fat**0.7
    clay.chain([hip, knee, ankle], [r, r * 0.72, r * 0.5])
    clay.cone(
        knee + 0.08 * shin + (0, 0.02, 0), knee + 0.2 * shin + (0, 0.02, 0), r * 0.65, r * 0.5
    )
    toe = rotation((1, 0, 0), -np.pi / 2 + rng.normal(0, 0.2)) @ shin
    toe = unit(np.add(toe, (side * rng.uniform(0, 0.5), 0, 0)))
    size = rng.uniform(0.9, 1.6) if robotic else rng.uniform(0.8, 1.15)
    heel = ankle + 0.035 * shin
    clay.cone(
        heel - 0.03 * toe, heel + 0.15 * size * toe + 0.015 * shin, 0.042 * size, 0.034 * size
    )
    if robotic:
        clay.ball(knee, 0.08)


def hand(rng: Rng) -> Sculpture:
    """A large hand with curled or spread fingers on a forearm, or a three-fingered claw."""
    clay = Sculpture(rng.uniform(0.04, 0.12))
    slim, count = rng.uniform(0.8, 1.25), int(pick(rng, 4, 4, 4, 3, 5))
    clay.block((0, 0, 0), (0.42, 0.13 * slim, 0.45), round_=0.12)
    clay.ball((-0.22, -0.08, -0.2), (0.2, 0.16, 0.3))
    clay.cone((0, 0.02, -0.35), (0, 0.05, -rng.uniform(0.6, 1.6)), 0.25 * slim, 0.24 * slim)
    curl, spread = rng.uniform(-0.15, 0.9), rng.uniform(0.02, 0.3)
    for i, x in enumerate(np.linspace(-0.33, 0.33, count)):
        length = rng.uniform(0.85, 1.1) * (0.36 - 0.5 * (x - 0.05) ** 2)
        aim = rotation((0, 1, 0), spread * x * 3 + rng.normal(0, 0.05)) @ np.array([0, 0, 1.0])
        bend = max(curl + rng.normal(0, 0.2), -0.2)
        if chance(rng, 0.15):
            bend = rng.uniform(-0.1, 1.4)
        finger(
            clay,
            (x, 0, 0.38 - 0.3 * x**2),
            aim,
            length,
            bend,
            0.105 * slim * (0.85 + 0.06 * (i == 1)),
        )
    thumb = rotation((0, 1, 0), -rng.uniform(0.4, 1.1)) @ np.array([0, rng.uniform(-0.6, 0.1), 1.0])
    finger(clay, (-0.3, -0.05, -0.2), unit(thumb), 0.36, rng.uniform(0, 0.5), 0.12 * slim)
    if chance(rng, 0.3):
        clay.roughen(rng, 0.008, rng.uniform(0.15, 0.4))
    return clay


def finger(clay: Sculpture, root, aim, length: float, bend: float, radius: float) -> None:
    """Three phalanges, each turned by the bend toward the palm (-y)."""
    axis = unit(np.cross(aim, (0, -1, 0)))
    path, direction = [np.asarray(root, float)], unit(aim)
    for share in (1.0, 0.75, 0.6):
        direction = rotation(axis, bend) @ direction
        path.append(path[-1] + share * length * direction)
    clay.chain(path, radius * np.array([1.0, 0.92, 0.85, 0.75]), blend=0.03)


def bust(rng: Rng) -> Sculpture:
    """A head, bust or skull with sockets, nose, mouth, ears, horns, on a neck, base or nothing."""
    clay = Sculpture(rng.uniform(0.05, 0.15))
    wide, deep, skull = rng.uniform(0.7, 0.95), rng.uniform(0.85, 1.1), chance(rng, 0.4)
    clay.ball((0, 0.1, 0.2), (wide, deep, rng.uniform(0.8, 1.0)))
    jaw = rng.uniform(0.35, 0.6)
    clay.block((0, -0.35, -0.65), (jaw, 0.4, rng.uniform(0.25, 0.4)), round_=0.22, blend=0.25)
    eye, eye_z = rng.uniform(0.14, 0.24), rng.uniform(-0.05, 0.15)
    for s in (-1, 1):
        at = np.array([s * rng.uniform(0.3, 0.36), -0.82 * deep, eye_z])
        clay.ball(at, eye, removes=True, blend=0.08)
        if skull:
            clay.cone((s * 0.7, -0.5, -0.1), (s * 0.75, 0.1, -0.15), 0.1, 0.08, blend=0.05)
        else:
            clay.ball(np.add(at, (0, 0.12, 0)), eye * 0.9, blend=0.02)
            ear = np.array([0.08, 0.2, 0.28]) * rng.uniform(0.8, 1.8)
            clay.ball(
                (s * (wide + 0.02), 0.1, -0.05), ear, rotation((0, 0, 1), s * 0.5), blend=0.05
            )
    if skull:
        clay.cone((0, -1.0, -0.25), (0, -0.7, -0.3), 0.12, 0.1, removes=True, blend=0.05)
        clay.block(
            (0, -0.55, -0.62), (jaw * 1.2, 0.4, 0.035), round_=0.02, removes=True, blend=0.03
        )
        clay.ball((0, 0, -1.0), (0.35, 0.55, 0.45), removes=True, blend=0.08)
    else:
        clay.cone((0, -0.95, 0.05), (0, -1.15, -0.25), 0.07, rng.uniform(0.1, 0.2), blend=0.1)
        clay.block((0, -0.8, -0.6), (0.2, 0.2, 0.03), round_=0.02, removes=True, blend=0.05)
    if chance(rng, 0.3):
        for s in (-1, 1):
            tip = np.array([s * rng.uniform(0.5, 1.4), rng.uniform(-0.5, 0.8), rng.uniform(1, 2)])
            middle = np.array([s * 0.9, 0.2, 0.9])
            clay.chain([(s * 0.4, 0, 0.8), middle, tip], [0.18, 0.13, 0.06])
    if not skull and chance(rng, 0.8):
        clay.cone((0, 0.1, -0.6), (0, 0.2, -1.5), 0.4, 0.42)
        if chance(rng, 0.6):
            clay.ball((0, 0.2, -1.75), (rng.uniform(0.8, 1.5), 0.5, 0.45))
    if chance(rng, 0.5):
        clay.roughen(rng, rng.uniform(0.005, 0.02), rng.uniform(0.15, 0.6))
    return clay
