"""What the public calls accept: types, shapes, finiteness. The only place that words errors.

Every check returns nothing, or the sizes it worked out; none of them changes its input. A message
names the argument, what was expected, what came, and a mend.
"""

from riemlayer.checks.clouds import (
    MIN_POINTS,
    check_batch,
    check_normals,
    check_points,
)
from riemlayer.checks.tensors import (
    check_broadcast,
    check_finite,
    check_index,
    check_same_device,
    check_same_kind,
    check_shapes,
    check_tensor,
    check_vectors,
)

__all__ = [
    "MIN_POINTS",
    "check_batch",
    "check_broadcast",
    "check_finite",
    "check_index",
    "check_normals",
    "check_points",
    "check_same_device",
    "check_same_kind",
    "check_shapes",
    "check_tensor",
    "check_vectors",
]
