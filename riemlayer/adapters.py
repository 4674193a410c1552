"""An encoded surface as the manifold object of other libraries."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from riemlayer.calculus import Calculus

if TYPE_CHECKING:
    import geoopt


class FlowManifold(nn.Module):
    """The four methods that Riemannian flow-matching libraries ask of a manifold (ours).

    Points and vectors (..., 3), user's units. It has no parameters: those of the field are not
    trained through it unless the surface still has its graph.

    Args:
        surface: an encoded surface of one shape.
    """

    def __init__(self, surface: Calculus) -> None:
        super().__init__()
        self._surface = surface

    def expmap(self, x: Tensor, u: Tensor) -> Tensor:
        """Exp_x(u), dropped onto the surface."""
        return self._surface.snap(self._surface.decode_exp(x, u)[0])

    def logmap(self, x: Tensor, y: Tensor) -> Tensor:
        """Log_x(y)."""
        return self._surface.decode_log(x, y)[0]

    def projx(self, x: Tensor) -> Tensor:
        """The surface's point near x."""
        return self._surface.snap(x)

    def proju(self, x: Tensor, u: Tensor) -> Tensor:
        """Part of u in the tangent plane at x."""
        return self._surface.project(x, u)


def geoopt_manifold(surface: Calculus) -> geoopt.Manifold:
    """The surface as a `geoopt.Manifold` of points (..., 3), for its optimisers (ours).

    Args:
        surface: an encoded surface of one shape.

    Raises:
        ImportError: geoopt is not installed.
    """
    try:
        from geoopt.manifolds.base import Manifold
    except ImportError as error:
        raise ImportError("geoopt_manifold needs geoopt: pip install geoopt") from error

    class Surface(Manifold):
        ndim = 1
        name = "EncodedSurface"
        reversible = False

        def expmap(self, x: Tensor, u: Tensor) -> Tensor:
            return surface.snap(surface.decode_exp(x, u)[0])

        def retr(self, x: Tensor, u: Tensor) -> Tensor:
            return surface.snap(x + u)

        def logmap(self, x: Tensor, y: Tensor) -> Tensor:
            return surface.decode_log(x, y)[0]

        def transp(self, x: Tensor, y: Tensor, v: Tensor) -> Tensor:
            return surface.transport(x, y, v)

        def inner(
            self, x: Tensor, u: Tensor, v: Tensor | None = None, *, keepdim: bool = False
        ) -> Tensor:
            product = surface.inner(x, u, v)
            return product[..., None] if keepdim else product

        def dist(self, x: Tensor, y: Tensor, *, keepdim: bool = False) -> Tensor:
            distance = surface.dist(x, y)
            return distance[..., None] if keepdim else distance

        def projx(self, x: Tensor) -> Tensor:
            return surface.snap(x)

        def proju(self, x: Tensor, u: Tensor) -> Tensor:
            return surface.project(x, u)

        def egrad2rgrad(self, x: Tensor, u: Tensor) -> Tensor:
            return surface.project(x, u)

        def _check_point_on_manifold(
            self, x: Tensor, *, atol: float = 1e-5, rtol: float = 1e-5
        ) -> tuple[bool, str | None]:
            on = torch.allclose(surface.snap(x), x, atol=atol, rtol=rtol)
            return on, None if on else "the point is not on the surface; call projx first"

        def _check_vector_on_tangent(
            self, x: Tensor, u: Tensor, *, atol: float = 1e-5, rtol: float = 1e-5
        ) -> tuple[bool, str | None]:
            tangent = torch.allclose(surface.project(x, u), u, atol=atol, rtol=rtol)
            return tangent, None if tangent else "the vector is not tangent; call proju first"

    return Surface()
