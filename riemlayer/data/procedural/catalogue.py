"""The kinds of procedural shapes, and the one function that draws one."""

import zlib

import numpy as np

from riemlayer.data.procedural import (
    abstract,
    animals,
    figures,
    furniture,
    gadgets,
    structures,
    tools,
    vehicles,
    vessels,
)
from riemlayer.data.procedural.finish import Shape, finish
from riemlayer.data.procedural.solids import chance

BUILDERS = {
    "chair": furniture.chair,
    "table": furniture.table,
    "shelf": furniture.shelf,
    "lamp": furniture.lamp,
    "sofa": furniture.sofa,
    "furniture_soup": furniture.furniture_soup,
    "vessel": vessels.vessel,
    "car": vehicles.car,
    "train": vehicles.train,
    "plane": vehicles.plane,
    "boat": vehicles.boat,
    "two_wheeler": vehicles.two_wheeler,
    "gadget": gadgets.gadget,
    "appliance": gadgets.appliance,
    "shoe": gadgets.shoe,
    "tray": gadgets.tray,
    "tool": tools.tool,
    "pliers": tools.pliers,
    "stapler": tools.stapler,
    "cutlery": tools.cutlery,
    "fastener": tools.fastener,
    "building": structures.building,
    "bridge": structures.bridge,
    "headphones": structures.headphones,
    "spectacles": structures.spectacles,
    "rack": structures.rack,
    "signpost": structures.signpost,
    "csg": abstract.csg,
    "bracket": abstract.bracket,
    "extrusion": abstract.extrusion,
    "terrain": abstract.terrain,
    "sheet": abstract.sheet,
    "knot": abstract.knot,
    "wireframe": abstract.wireframe,
    "blob": abstract.blob,
    "branches": abstract.branches,
    "humanoid": figures.humanoid,
    "hand": figures.hand,
    "bust": figures.bust,
    "quadruped": animals.quadruped,
    "bird": animals.bird,
    "fish": animals.fish,
    "insect": animals.insect,
    "tentacles": animals.tentacles,
}
KINDS: tuple[str, ...] = tuple(BUILDERS)
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
        kind = KINDS[int(np.random.default_rng([seed, len(KINDS)]).integers(len(KINDS)))]
    if kind not in BUILDERS:
        raise ValueError(f"kind must be one of {', '.join(KINDS)}, got {kind!r}")
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([seed, zlib.crc32(kind.encode()), attempt])
        soup = kind == "furniture_soup" or chance(rng, 0.4)
        shape = finish(rng, BUILDERS[kind](rng), kind, soup)
        if shape is not None:
            return shape
    raise RuntimeError(f"no valid {kind!r} from seed {seed} in {ATTEMPTS} attempts")
