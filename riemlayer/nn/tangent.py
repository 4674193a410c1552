"""Convolution in the tangent plane."""

from __future__ import annotations

from torch import Tensor

from riemlayer.nn.polar import PolarConv
from riemlayer.ops import LocalGeometry


class TangentConv(PolarConv):
    """Convolution with a kernel on the tangent plane (after Tatarchenko et al. 2018).

        y_i = b + K(0) x_i + sum_j w_ij K(Log_i(j) / R_i) x_j

    with the weights w of Eq. (9), R_i the distance of the farthest neighbour, and a kernel K given
    at `rings` circles of `angles` directions, linear between them. Tatarchenko et al. convolve an
    image of square pixels, drawn on planes fitted to the points; here Log_i lays the neighbours
    out, and no image is drawn. A receiver without valid edges gets b + K(0) x_i.

    **Depends on the frames**: turning the frame at i turns the kernel there. That suits frames
    that mean something (principal directions, gravity). Frames that are a function of the normal
    alone, as those of `local_geometry`, turn with the pose of the cloud; `GeodesicConv` and
    `HarmonicConv` do not care.

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
    >>> TangentConv(3, 16)(points, geometry).shape
    torch.Size([300, 16])
    """

    def forward(self, x: Tensor, geometry: LocalGeometry) -> Tensor:
        centre, patch = self.gather(x, geometry)
        return self.centre(centre) + patch @ self.kernel.flatten(0, 2)
