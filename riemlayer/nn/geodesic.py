"""Geodesic convolution: a polar kernel, and the maximum over its turns."""

from __future__ import annotations

from torch import Tensor

from riemlayer.nn.polar import PolarConv, angular_max
from riemlayer.ops import LocalGeometry


class GeodesicConv(PolarConv):
    """Geodesic convolution with angular max pooling (Masci et al. 2015).

        y_i = b + K(0) x_i + max_s sum_j w_ij K(turn_s Log_i(j) / R_i) x_j

    over the turns by s 2 pi / angles, s = 0 ... angles - 1, for each output channel on its own. K,
    w and R as in `TangentConv`. A receiver without valid edges gets b + K(0) x_i.

    **Frames**: outputs and gradients stay the same, to rounding, when each frame is turned by a
    multiple of 2 pi / angles of its own. By other angles they stay the same approximately: the
    maximum is taken over a finite set of turns, and what lies between them is missed. For a kernel
    that is smooth the departure falls with the square of 2 pi / angles.

    Args:
        inputs, outputs: channels.
        rings, angles: nodes of the kernel.

    Shapes: x (N, inputs) -> (N, outputs).

    Raises:
        TypeError, ValueError: a size is below 1, or `x` has another shape or is not real.

    >>> import torch
    >>> from riemlayer import ExpLogField
    >>> from riemlayer.ops import local_geometry
    >>> points = torch.nn.functional.normalize(torch.randn(300, 3), dim=-1)
    >>> geometry = local_geometry(ExpLogField.from_preset("tiny").encode(points), k=8)
    >>> GeodesicConv(3, 16, rings=2, angles=6)(points, geometry).shape
    torch.Size([300, 16])
    """

    def forward(self, x: Tensor, geometry: LocalGeometry) -> Tensor:
        centre, patch = self.gather(x, geometry)
        return self.centre(centre) + angular_max(patch, self.kernel)
