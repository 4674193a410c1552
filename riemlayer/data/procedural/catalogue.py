"""The kinds of procedural shapes, and the one function that draws one."""

import zlib

import numpy as np

from riemlayer.data.procedural import (
    abstract,
    animals,
    composites,
    craft,
    critters,
    fasteners,
    figures,
    frames,
    furniture,
    gadgets,
    interior,
    machines,
    modelled,
    organic,
    sheets,
    storage,
    structures,
    tools,
    vehicles,
    vessels,
)
from riemlayer.data.procedural.finish import Shape, finish
from riemlayer.data.procedural.solids import chance

BUILDERS = {
    "car": vehicles.car,
    "train": vehicles.train,
    "two_wheeler": vehicles.two_wheeler,
    "plane": craft.plane,
    "boat": craft.boat,
    "gadget": gadgets.gadget,
    "appliance": gadgets.appliance,
    "shoe": gadgets.shoe,
    "tray": gadgets.tray,
    "tool": tools.tool,
    "pliers": tools.pliers,
    "stapler": tools.stapler,
    "cutlery": tools.cutlery,
    "fastener": fasteners.fastener,
    "building": structures.building,
    "bridge": structures.bridge,
    "headphones": frames.headphones,
    "spectacles": frames.spectacles,
    "rack": frames.rack,
    "signpost": frames.signpost,
    "csg": abstract.csg,
    "bracket": abstract.bracket,
    "extrusion": abstract.extrusion,
    "wireframe": abstract.wireframe,
    "terrain": sheets.terrain,
    "sheet": sheets.sheet,
    "knot": sheets.knot,
    "blob": organic.blob,
    "branches": organic.branches,
    "plant": organic.plant,
    "fruit": organic.fruit,
    "toy": modelled.toy,
    "garment": modelled.garment,
    "relief": modelled.relief,
    "robot": machines.robot,
    "pipes": machines.pipes,
    "board": machines.board,
    "instrument": machines.instrument,
    "hook": machines.hook,
    "assembly": composites.assembly,
    "humanoid": figures.humanoid,
    "hand": figures.hand,
    "bust": figures.bust,
    "quadruped": animals.quadruped,
    "bird": animals.bird,
    "fish": animals.fish,
    "insect": critters.insect,
    "tentacles": critters.tentacles,
    "chair": furniture.chair,
    "table": furniture.table,
    "shelf": storage.shelf,
    "furniture_soup": storage.furniture_soup,
    "lamp": interior.lamp,
    "sofa": interior.sofa,
    "vessel": vessels.vessel,
}
KINDS: tuple[str, ...] = tuple(BUILDERS)
COMMON = {"humanoid": 4, "assembly": 3, "hand": 2, "quadruped": 2, "insect": 2, "bust": 2}
COMMON |= {"chair": 2, "table": 2, "shelf": 2, "vessel": 2, "furniture_soup": 2, "two_wheeler": 2}
"""How many times as often as the others a kind is drawn: what varies more, or is harder."""
ATTEMPTS = 30


def random_shape(seed: int, kind: str | None = None) -> Shape:
    """A random closed surface of a kind, the same for the same seed and kind (ours).

    The frame is arbitrary (about the cube [-1, 1]); the mesh is not yet remeshed.

    Args:
        seed: A number of at least 0.
        kind: One of `KINDS`; drawn from the seed when None.

    Raises:
        ValueError: For a negative seed or an unknown kind.

    Example:
        >>> shape = random_shape(0, "table")
        >>> shape.kind, shape.vertices.shape[1], shape.faces.shape[1]
        ('table', 3, 3)
    """
    if seed < 0:
        raise ValueError(f"seed must be at least 0, got {seed}; pass a non-negative integer")
    if kind is None:
        weight = np.array([COMMON.get(name, 1) for name in KINDS], float)
        kind = str(np.random.default_rng(seed).choice(KINDS, p=weight / weight.sum()))
    if kind not in BUILDERS:
        raise ValueError(f"kind must be one of {', '.join(KINDS)}, got {kind!r}")
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([seed, zlib.crc32(kind.encode()), attempt])
        soup = kind == "furniture_soup" or chance(rng, 0.4)
        shape = finish(rng, BUILDERS[kind](rng), kind, soup)
        if shape is not None:
            return shape
    raise RuntimeError(f"no valid {kind!r} from seed {seed} in {ATTEMPTS} attempts")
