"""Several objects as one: things standing on a tray, stacked, or side by side."""

import numpy as np
from manifold3d import Manifold

from riemlayer.data.procedural import (
    abstract,
    craft,
    fasteners,
    frames,
    furniture,
    gadgets,
    interior,
    machines,
    storage,
    structures,
    tools,
    vehicles,
    vessels,
)
from riemlayer.data.procedural.solids import Rng, any_box, chance, pick, rod, segments, union

THINGS = (
    *(furniture.chair, furniture.table, storage.shelf, interior.lamp, interior.sofa),
    *(vessels.vessel, vessels.vessel, gadgets.gadget, gadgets.appliance, gadgets.tray),
    *(tools.tool, tools.pliers, tools.stapler, tools.cutlery, fasteners.fastener),
    *(vehicles.car, vehicles.train, craft.plane, craft.boat, machines.robot, machines.hook),
    *(structures.building, structures.bridge, frames.headphones, frames.signpost),
    *(abstract.csg, abstract.bracket, abstract.extrusion, machines.instrument),
)


def assembly(rng: Rng) -> list[Manifold]:
    """Two to six objects of other kinds, sunk into a common base or stacked on each other."""
    if chance(rng, 0.3):
        return stack(rng)
    wide, deep = rng.uniform(0.8, 1.4, 2)
    base = any_box(rng, (2 * wide, 2 * deep, rng.uniform(0.06, 0.3)))
    if chance(rng, 0.3):
        base = rod(wide, rng.uniform(0.06, 0.3), sides=segments(rng))
        deep = wide
    level = base.bounding_box()[5] - 0.03
    parts = [base]
    for _ in range(rng.integers(1, 7)):
        x, y = rng.uniform(-0.65, 0.65, 2) * (wide, deep)
        parts.append(thing(rng, rng.uniform(0.25, 0.7)).translate((x, y, level)))
    return parts


def stack(rng: Rng) -> list[Manifold]:
    """Two or three objects on top of each other."""
    parts, level = [], 0.0
    for _ in range(rng.integers(2, 4)):
        part = thing(rng, rng.uniform(0.4, 1.0)).translate((*rng.normal(0, 0.1, 2), level))
        parts.append(part)
        level = part.bounding_box()[5] - rng.uniform(0.03, 0.3)
    return parts


def thing(rng: Rng, size: float) -> Manifold:
    """One object in a random pose, standing on z = 0, with its longest half side given."""
    solid = union(pick(rng, *THINGS)(rng)).rotate(
        (pick(rng, 0, 0, 90, -90), 0, rng.uniform(0, 360))
    )
    low, high = np.reshape(solid.bounding_box(), (2, 3))
    scale = 2 * size / (high - low).max()
    middle = -(low + high) / 2
    return solid.translate((*middle[:2], -low[2])).scale((scale, scale, scale))
